//! Error for a refused configuration.

use std::ops::RangeInclusive;

use pb3dp_geometry::ranges::OutOfRange;

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

impl From<OutOfRange> for ConfigError {
    fn from(OutOfRange { name, value, min, max }: OutOfRange) -> Self {
        Self { key: name, value, allowed: format!("{min} to {max}") }
    }
}

/// The part of a range that is not below `least`; at least the end of the range.
pub(crate) fn not_below(least: f64, range: &RangeInclusive<f64>) -> RangeInclusive<f64> {
    // Of NaN and a number, `max` and `min` give the number.
    least.max(*range.start()).min(*range.end())..=*range.end()
}
