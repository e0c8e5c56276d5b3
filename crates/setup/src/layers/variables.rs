//! Environment variables that set keys: `PB3DP_RUN__SEED=5` sets `run.seed`.

use std::ffi::OsString;
use std::path::PathBuf;

use super::built_in_keys::all_keys;
use super::{Layer, Origin};
use crate::error::ConfigError;

const PREFIX: &str = "PB3DP_";
/// Between a table and its key. A name without it sets no key.
const SEPARATOR: &str = "__";

/// One layer for each variable that sets a key, by name.
///
/// # Errors
/// A value that is not text, and a name with one underscore in place of two between table and key.
pub(super) fn layers() -> Result<Vec<Layer>, ConfigError> {
    layers_of(std::env::vars_os())
}

fn layers_of(variables: impl Iterator<Item = (OsString, OsString)>) -> Result<Vec<Layer>, ConfigError> {
    let mut found = Vec::new();
    for (name, value) in variables.filter_map(|(name, value)| Some((name.into_string().ok()?, value))) {
        let Some(key) = name.strip_prefix(PREFIX) else { continue };
        if key.contains(SEPARATOR) {
            let value = value.into_string().map_err(|_| refused(&name, "the value is not UTF-8 text"))?;
            found.push((name, value));
        } else if let Some(meant) = meant_by(key) {
            let right = meant.to_uppercase().replace('.', SEPARATOR);
            return Err(refused(&name, &format!("sets no key; write {PREFIX}{right} to set {meant}, or unset it")));
        }
    }
    found.sort();
    found.iter().map(|(name, value)| layer(name, value)).collect()
}

fn refused(name: &str, why: &str) -> ConfigError {
    ConfigError::Values { file: PathBuf::from(format!("variable {name}")), lines: format!("  {why}") }
}

/// The key that a name with one underscore in place of two means.
fn meant_by(name: &str) -> Option<String> {
    let name = name.to_lowercase();
    all_keys().keys().find(|key| key.replace('.', "_") == name).cloned()
}

fn layer(name: &str, value: &str) -> Result<Layer, ConfigError> {
    let key = name.trim_start_matches(PREFIX).to_lowercase().replace(SEPARATOR, ".");
    Layer::of_words(Origin::Variable(name.to_owned()), &key, value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(name: &str, value: &str) -> Result<Vec<Layer>, ConfigError> {
        layers_of([(name.into(), value.into())].into_iter())
    }

    #[test]
    fn a_variable_names_table_and_key() {
        let layers = one("PB3DP_ARMS__VS__START_DEG", "[1.0, 2]").unwrap();
        let start = figment::Figment::from(&layers[0]).find_value("arms.vs.start_deg").unwrap();
        assert_eq!(start.as_array().map(<[_]>::len), Some(2));
        assert_eq!(layers[0].origin.to_string(), "variable PB3DP_ARMS__VS__START_DEG");
    }

    #[test]
    fn one_underscore_in_place_of_two_is_refused_with_the_right_name() {
        let refusal = one("PB3DP_ARMS_VS_START_DEG", "[1.0]").unwrap_err().to_string();
        assert!(refusal.contains("PB3DP_ARMS__VS__START_DEG"), "{refusal}");
        assert!(one("PB3DP_RUN_SEED", "5").unwrap_err().to_string().contains("PB3DP_RUN__SEED"));
        for of_others in ["PB3DP_COMMIT", "PB3DP_LONG_TESTS", "RUN_SEED"] {
            assert!(one(of_others, "5").unwrap().is_empty(), "{of_others}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_value_that_is_no_text_is_refused() {
        use std::os::unix::ffi::OsStringExt;
        let value = OsString::from_vec(vec![0xff]);
        let refusal = layers_of([("PB3DP_RUN__SEED".into(), value)].into_iter()).unwrap_err().to_string();
        assert!(refusal.contains("variable PB3DP_RUN__SEED") && refusal.contains("UTF-8"), "{refusal}");
    }
}
