//! Error for a refused configuration.

/// A parameter out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("servo setting {key} is {value}: allowed is {allowed}")]
pub struct ConfigError {
    /// Name of the setting as a path of field names.
    pub key: &'static str,
    /// Its value.
    pub value: f64,
    /// The allowed values.
    pub allowed: &'static str,
}

pub(crate) fn check(
    key: &'static str,
    value: f64,
    min: f64,
    max: f64,
    allowed: &'static str,
) -> Result<(), ConfigError> {
    if value >= min && value <= max { Ok(()) } else { Err(ConfigError { key, value, allowed }) }
}
