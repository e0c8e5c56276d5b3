//! Every key of the built-in setups.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use super::{Layers, built_in};

/// Values of one key: name of the setup and value.
pub(crate) type Values = Vec<(&'static str, String)>;

/// All built-in texts: name, text.
pub(crate) fn texts() -> impl Iterator<Item = (&'static str, &'static str)> {
    built_in::SETUPS.iter().map(|setup| (setup.name, setup.text)).chain([("rig example", built_in::RIG_EXAMPLE)])
}

/// Every key of the built-in setups with its values.
pub(crate) fn all_keys() -> &'static BTreeMap<String, Values> {
    static FOUND: OnceLock<BTreeMap<String, Values>> = OnceLock::new();
    FOUND.get_or_init(|| {
        let mut found: BTreeMap<String, Values> = BTreeMap::new();
        for (name, text) in texts() {
            let layers = Layers::of_text(name, text).unwrap_or_default();
            for setting in layers.effective() {
                found.entry(setting.key).or_default().push((name, setting.value));
            }
        }
        found
    })
}
