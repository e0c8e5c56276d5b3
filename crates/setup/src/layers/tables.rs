//! Change, listing and text of nested tables.

use figment::value::{Dict, Value};

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
