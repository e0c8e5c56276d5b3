//! Variables of the environment that set keys: `PB3DP_RUN__SEED=5` sets `run.seed`.

use super::{Layer, Origin};
use crate::error::ConfigError;

const PREFIX: &str = "PB3DP_";
/// Between a table and its key. A name without it is no setting.
const SEPARATOR: &str = "__";

/// One layer for each variable that sets a key, by name.
///
/// # Errors
/// A value that is not TOML text.
pub(super) fn layers() -> Result<Vec<Layer>, ConfigError> {
    let mut found: Vec<(String, String)> = std::env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
        .filter(|(name, _)| name.strip_prefix(PREFIX).is_some_and(|rest| rest.contains(SEPARATOR)))
        .collect();
    found.sort();
    found.iter().map(|(name, value)| layer(name, value)).collect()
}

fn layer(name: &str, value: &str) -> Result<Layer, ConfigError> {
    let key = name.trim_start_matches(PREFIX).to_lowercase().replace(SEPARATOR, ".");
    Layer::of_words(Origin::Variable(name.to_owned()), &key, value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variable_names_table_and_key() {
        let layer = layer("PB3DP_ARMS__VS__START_DEG", "[1.0, 2]").unwrap();
        let start = figment::Figment::from(&layer).find_value("arms.vs.start_deg").unwrap();
        assert_eq!(start.as_array().map(<[_]>::len), Some(2));
        assert_eq!(layer.origin.to_string(), "variable PB3DP_ARMS__VS__START_DEG");
    }
}
