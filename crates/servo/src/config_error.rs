//! Error for a refused configuration, and the declaration of allowed values.

use std::fmt::Display;
use std::ops::RangeInclusive;

/// A parameter out of range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("servo setting {key} is {value}: allowed is {allowed}")]
pub struct ConfigError {
    /// Name of the setting as a path of field names.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// The allowed values.
    pub allowed: String,
}

/// Declares the allowed values of settings, as constants of the type that has the settings. This is the only statement of a range:
/// the check of the type and the files of a setup refer to it.
macro_rules! ranges {
    ($($name:ident: $number:ty = $range:expr;)*) => {$(
        #[doc = concat!("Allowed values of the setting `", stringify!($name), "`.")]
        pub const $name: std::ops::RangeInclusive<$number> = $range;
    )*};
}
pub(crate) use ranges;

/// Refuses a value out of range, or NaN.
pub(crate) fn check<T: PartialOrd + Display>(
    key: &'static str,
    value: T,
    allowed: RangeInclusive<T>,
) -> Result<(), ConfigError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    let allowed = format!("{} to {}", allowed.start(), allowed.end());
    Err(ConfigError { key, value: value.to_string(), allowed })
}

/// The part of a range that is not below `least`; at least the end of the range.
pub(crate) fn not_below(least: f64, range: &RangeInclusive<f64>) -> RangeInclusive<f64> {
    // Of NaN and a number, `max` and `min` give the number.
    least.max(*range.start()).min(*range.end())..=*range.end()
}
