//! One source of values and their positions; lookup, change and listing of nested tables.

use std::path::PathBuf;

use figment::providers::{Format, Toml};
use figment::value::{Dict, Map, Value};
use figment::{Metadata, Profile, Provider};

use super::Origin;
use super::position::{self, Positions};
use crate::error::ConfigError;

/// The values of one source.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub origin: Origin,
    /// Positions of its keys in its text, if it has one.
    pub positions: Positions,
    /// The values, as nested tables.
    pub stated: Dict,
}

impl Provider for Layer {
    fn metadata(&self) -> Metadata {
        Metadata::named(self.origin.to_string())
    }

    fn data(&self) -> Result<Map<Profile, Dict>, figment::Error> {
        Ok(Map::from([(Profile::Default, self.stated.clone())]))
    }
}

impl Layer {
    /// The layer of a TOML text.
    ///
    /// # Errors
    /// A text that is not valid TOML, with line and column.
    pub fn of_text(origin: Origin, text: String) -> Result<Self, ConfigError> {
        if let Err(error) = toml::de::DeTable::parse(&text) {
            let (line, column) = position::line_and_column(&text, error.span().map_or(0, |span| span.start));
            let place = PathBuf::from(format!("{origin}:{line}:{column}"));
            return Err(ConfigError::Syntax { place, reason: error.message().to_owned() });
        }
        let data = Toml::string(&text).data().map_err(|error| ConfigError::Syntax {
            place: PathBuf::from(origin.to_string()),
            reason: error.to_string(),
        })?;
        let stated = data.into_values().next().unwrap_or_default();
        Ok(Self { origin, positions: position::all(&text), stated })
    }

    /// The value of the option `--set KEY=VALUE`.
    ///
    /// # Errors
    /// A text without `=`, or with an invalid key.
    pub fn of_option(set: &str) -> Result<Self, ConfigError> {
        match set.split_once('=') {
            Some((key, value)) if !key.trim().is_empty() => {
                Self::of_words(Origin::Option("--set"), key.trim(), value.trim())
            }
            _ => Err(ConfigError::Values {
                file: PathBuf::from("--set"),
                lines: format!("  {set:?}: write KEY=VALUE, for instance --set scene.target=card"),
            }),
        }
    }

    /// One key with its value as TOML; a value that is not TOML is text, so that words need no quotes.
    ///
    /// # Errors
    /// An invalid key.
    pub fn of_words(origin: Origin, key: &str, value: &str) -> Result<Self, ConfigError> {
        let quoted = format!("{key} = {}", toml::Value::from(value));
        let text = [format!("{key} = {value}"), quoted].into_iter().find(|text| toml::de::DeTable::parse(text).is_ok());
        let text = text.ok_or_else(|| ConfigError::Values {
            file: PathBuf::from(origin.to_string()),
            lines: format!("  {key:?}: is no key; keys look like arms.vs.start_deg"),
        })?;
        Ok(Self { positions: Positions::new(), ..Self::of_text(origin, text)? })
    }

    /// The table `named_arm` of an arm's file, as the table of an arm in a setup.
    ///
    /// # Errors
    /// A file without that table.
    pub fn into_arm(mut self, name: &str) -> Result<Self, ConfigError> {
        let file = || PathBuf::from(self.origin.to_string());
        let Some(arm) = self.stated.remove("named_arm") else {
            let lines = "  named_arm: missing; a file of an arm has it, as configs/arms/ur5e.toml".to_owned();
            return Err(ConfigError::Values { file: file(), lines });
        };
        let arms = Dict::from([(name.to_owned(), arm)]);
        self.stated = Dict::from([("arms".to_owned(), Value::from(arms))]);
        // Its keys are below another table than in the setup.
        let in_setup = |(key, at): (String, _)| (key.replacen("named_arm", &format!("arms.{name}"), 1), at);
        self.positions = self.positions.into_iter().map(in_setup).collect();
        Ok(self)
    }
}

pub(super) fn value_at<'a>(dict: &'a Dict, path: &[&str]) -> Option<&'a Value> {
    let (first, rest) = path.split_first()?;
    rest.iter().try_fold(dict.get(*first)?, |value, part| match value {
        Value::Dict(_, inner) => inner.get(*part),
        Value::Array(_, items) => items.get(part.parse::<usize>().ok()?),
        _ => None,
    })
}

pub(super) fn remove_at(dict: &mut Dict, path: &[&str]) {
    match path {
        [] => {}
        [last] => drop(dict.remove(*last)),
        [first, rest @ ..] => {
            if let Some(Value::Dict(_, inner)) = dict.get_mut(*first) {
                remove_at(inner, rest);
            }
        }
    }
}

/// Changes the text at `path`, or each text of a list.
pub(super) fn change(dict: &mut Dict, path: &[&str], changed: &dyn Fn(&str) -> String) {
    let Some((first, rest)) = path.split_first() else { return };
    match dict.get_mut(*first) {
        Some(Value::Dict(_, inner)) => change(inner, rest, changed),
        Some(value) if rest.is_empty() => change_text(value, changed),
        _ => {}
    }
}

fn change_text(value: &mut Value, changed: &dyn Fn(&str) -> String) {
    match value {
        Value::String(_, text) => *text = changed(text),
        Value::Array(_, items) => items.iter_mut().for_each(|item| change_text(item, changed)),
        _ => {}
    }
}

/// Calls `each` with every value that is not a table, by its key.
pub(super) fn flatten(dict: &Dict, prefix: &str, each: &mut dyn FnMut(&str, &Value)) {
    for (name, value) in dict {
        let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        match value {
            Value::Dict(_, inner) => flatten(inner, &key, each),
            value => each(&key, value),
        }
    }
}

/// A value in TOML notation.
pub(super) fn toml_text(value: &Value) -> String {
    match value {
        Value::Array(_, items) => format!("[{}]", items.iter().map(toml_text).collect::<Vec<_>>().join(", ")),
        Value::Dict(_, inner) => {
            let entries: Vec<String> =
                inner.iter().map(|(name, value)| format!("{name} = {}", toml_text(value))).collect();
            format!("{{ {} }}", entries.join(", "))
        }
        value => toml::Value::try_from(value).map_or_else(|_| "?".to_owned(), |value| value.to_string()),
    }
}
