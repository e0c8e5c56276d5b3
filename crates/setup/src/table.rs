//! Tables of a configuration: one row for each key states its type in a file, its parameter, its unit and its allowed values. From these
//! rows follow the structure that is read, the check and its messages, and the ranges of `pb3dp config explain` and of the reference.
//!
//! The built-in setup with the key states its value and, in a comment, its meaning: see [`crate::explain`].

use std::ops::RangeInclusive;
use std::time::Duration;

use crate::load::{Checker, whole};
use crate::units::{in_deg, in_millis, in_mm};

/// Declares a table, with rows `KEY: TYPE => PARAMETER = UNIT(ALLOWED);`. The unit is a function of this module: it checks the value, with the
/// allowed values of the parameter in its own unit, and converts it.
///
/// * `struct Section builds Config` makes a `Config` ([`Builds`]): there is a row for each of its fields.
/// * `struct Section sets Config` changes a `Config` with a method `set`: parameters are paths of fields.
macro_rules! table {
    (
        $(#[$about:meta])*
        $public:vis struct $section:ident builds $config:ident {
            $($(#[$attribute:meta])* $key:ident: $type:ty => $field:ident = $unit:ident($($allowed:expr)?);)*
        }
    ) => {
        table!(@keys $(#[$about])* $public $section { $($(#[$attribute])* $key: $type;)* });
        impl $crate::table::Builds for $section {
            type Config = $config;
            fn build(&self, table: &str, check: &mut $crate::load::Checker) -> $config {
                $config { $($field: table!(@read self, $key, $unit($($allowed)?), table, check)),* }
            }
        }
    };
    (
        $(#[$about:meta])*
        $public:vis struct $section:ident sets $config:ident {
            $($(#[$attribute:meta])* $key:ident: $type:ty => $($field:ident).+ = $unit:ident($($allowed:expr)?);)*
        }
    ) => {
        table!(@keys $(#[$about])* $public $section { $($(#[$attribute])* $key: $type;)* });
        impl $section {
            $public fn set(&self, config: &mut $config, table: &str, check: &mut $crate::load::Checker) {
                $(config.$($field).+ = table!(@read self, $key, $unit($($allowed)?), table, check);)*
            }
        }
    };
    (@keys $(#[$about:meta])* $public:vis $section:ident { $($(#[$attribute:meta])* $key:ident: $type:ty;)* }) => {
        $(#[$about])*
        #[derive(Clone, Debug, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        $public struct $section {
            $($(#[$attribute])* $key: $type,)*
        }
    };
    (@read $self:ident, $key:ident, $unit:ident($($allowed:expr)?), $table:ident, $check:ident) => {
        $crate::table::$unit(&$self.$key, &format!("{}.{}", $table, stringify!($key)), $check $(, $allowed)?)
    };
}
pub(crate) use table;

/// A table that is converted to parameters.
pub(crate) trait Builds {
    /// The parameters.
    type Config;

    /// The parameters; values out of range are reported under their keys in the table with the path `table`.
    fn build(&self, table: &str, check: &mut Checker) -> Self::Config;
}

/// A table that may be left out.
impl<Section: Builds> Builds for Option<Section> {
    type Config = Option<Section::Config>;

    fn build(&self, table: &str, check: &mut Checker) -> Self::Config {
        self.as_ref().map(|section| section.build(table, check))
    }
}

/// A table in this one.
pub(crate) fn inner<Section: Builds>(section: &Section, key: &str, check: &mut Checker) -> Section::Config {
    section.build(key, check)
}

/// A word or switch: not checked, as its type has the allowed values only.
pub(crate) fn plain<T: Copy + Into<Value>, Value>(word: &T, _: &str, _: &mut Checker) -> Value {
    (*word).into()
}

type Allowed = RangeInclusive<f64>;

/// A number in the unit of its parameter.
pub(crate) fn number(number: &f64, key: &str, check: &mut Checker, allowed: Allowed) -> f64 {
    check.number(key, *number, allowed);
    *number
}

/// Numbers with one range.
pub(crate) fn numbers<const N: usize>(
    numbers: &[f64; N],
    key: &str,
    check: &mut Checker,
    allowed: Allowed,
) -> [f64; N] {
    check.numbers(key, numbers, allowed);
    *numbers
}

/// A whole number. Its type in a file is `i64`, so that a refusal states the range and not a type.
pub(crate) fn count<T: TryInto<i64>, Value: TryFrom<i64> + Default>(
    number: &i64,
    key: &str,
    check: &mut Checker,
    allowed: RangeInclusive<T>,
) -> Value {
    check.count(key, *number, allowed);
    whole(*number)
}

/// Millimetres, also per second, for a parameter in metres.
pub(crate) fn mm(mm: &f64, key: &str, check: &mut Checker, allowed_m: Allowed) -> f64 {
    number(mm, key, check, in_mm(allowed_m)) * 1e-3
}

/// Degrees, also per second, for a parameter in radians.
pub(crate) fn deg(degrees: &f64, key: &str, check: &mut Checker, allowed_rad: Allowed) -> f64 {
    number(degrees, key, check, in_deg(allowed_rad)).to_radians()
}

/// Milliseconds for a parameter in seconds.
pub(crate) fn millis(millis: &f64, key: &str, check: &mut Checker, allowed_s: Allowed) -> f64 {
    number(millis, key, check, in_millis(allowed_s)) * 1e-3
}

/// Milliseconds for a duration.
pub(crate) fn duration_millis(millis: &f64, key: &str, check: &mut Checker, allowed_s: Allowed) -> Duration {
    Duration::try_from_secs_f64(self::millis(millis, key, check, allowed_s)).unwrap_or_default()
}

/// Seconds for a duration.
pub(crate) fn duration_s(seconds: &f64, key: &str, check: &mut Checker, allowed: Allowed) -> Duration {
    Duration::try_from_secs_f64(number(seconds, key, check, allowed)).unwrap_or_default()
}
