//! Allowed values of parameters: declared once, as constants of the type that has the parameters. Its check, and the files of a setup, refer
//! to them.

use std::fmt::Display;
use std::ops::RangeInclusive;

/// A parameter out of its range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name} is {value}: must be between {min} and {max}")]
pub struct OutOfRange {
    /// Name of the parameter.
    pub name: &'static str,
    /// Its value.
    pub value: String,
    /// Smallest allowed value.
    pub min: String,
    /// Largest allowed value.
    pub max: String,
}

/// Rejects a parameter out of range, or NaN.
///
/// # Errors
/// The parameter with its value and range.
pub fn check_range<T: PartialOrd + Display>(
    name: &'static str,
    value: T,
    allowed: RangeInclusive<T>,
) -> Result<(), OutOfRange> {
    if allowed.contains(&value) {
        return Ok(());
    }
    let [value, min, max] = [&value, allowed.start(), allowed.end()].map(T::to_string);
    Err(OutOfRange { name, value, min, max })
}

/// Declares the allowed values of the fields of a type in rows `field, NAME: type = RANGE;`, and a method that checks all of them. The first
/// line names the method and the text before a field in its error: `pub fn validate "part.";`. Without that line and the fields, only the
/// constants are declared.
#[macro_export]
macro_rules! ranges {
    ($public:vis fn $method:ident $part:literal; $($field:ident, $name:ident: $number:ty = $range:expr;)*) => {
        $(
            #[doc = concat!("Allowed values of `", stringify!($field), "`.")]
            pub const $name: std::ops::RangeInclusive<$number> = $range;
        )*

        /// Checks the ranges of the parameters.
        ///
        /// # Errors
        /// The parameter that is out of its range.
        $public fn $method(&self) -> Result<(), $crate::ranges::OutOfRange> {
            $($crate::ranges::check_range(concat!($part, stringify!($field)), self.$field, Self::$name)?;)*
            Ok(())
        }
    };
    ($($name:ident: $number:ty = $range:expr;)*) => {$(
        #[doc = concat!("Allowed values of the parameter `", stringify!($name), "`.")]
        pub const $name: std::ops::RangeInclusive<$number> = $range;
    )*};
}
