//! Recorded settings of runs, and what differs between two of them: values, and the files that they name. The comments that state where a
//! value comes from do not count.

use std::collections::{BTreeMap, BTreeSet};

use toml::{Table, Value};

/// Settings of a run.
#[derive(Clone, Debug, Default)]
pub struct RecordedSettings {
    /// Value of each key, such as `servo.approach.linear_max_mm_per_s`; tables of an array have an index: `arms.vs.parts[0].radius_mm`.
    values: BTreeMap<String, Value>,
    /// Content of each file, by the path in the settings.
    files: BTreeMap<String, Vec<u8>>,
}

impl RecordedSettings {
    /// All settings of a run as TOML, and the contents of the files that they name, by their paths in the settings.
    ///
    /// # Errors
    /// A text that is no TOML.
    pub fn new(text: &str, files: BTreeMap<String, Vec<u8>>) -> Result<Self, toml::de::Error> {
        let mut values = BTreeMap::new();
        flatten("", Value::Table(text.parse::<Table>()?), &mut values);
        Ok(Self { values, files })
    }

    /// Number of values.
    pub fn count(&self) -> usize {
        self.values.len()
    }
}

/// A setting that differs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DifferentSetting {
    /// Its key.
    pub key: String,
    /// Its value in A and in B as TOML; none if it is not stated there.
    pub values: [Option<String>; 2],
}

fn flatten(key: &str, value: Value, flat: &mut BTreeMap<String, Value>) {
    match value {
        Value::Table(table) if !table.is_empty() => {
            for (name, value) in table {
                let key = if key.is_empty() { name } else { format!("{key}.{name}") };
                flatten(&key, value, flat);
            }
        }
        Value::Array(values) if values.iter().any(Value::is_table) => {
            for (index, value) in values.into_iter().enumerate() {
                flatten(&format!("{key}[{index}]"), value, flat);
            }
        }
        value => {
            flat.insert(key.to_owned(), value);
        }
    }
}

/// The settings that differ, by key. Paths of recorded files with the same content are equal: a replay has its own copies.
pub fn differing([a, b]: [&RecordedSettings; 2]) -> Vec<DifferentSetting> {
    let keys: BTreeSet<&String> = a.values.keys().chain(b.values.keys()).collect();
    let mut found = Vec::new();
    for key in keys {
        let values = [a.values.get(key), b.values.get(key)];
        if let [Some(in_a), Some(in_b)] = values
            && is_same([a, b], [in_a, in_b])
        {
            continue;
        }
        let mut texts = values.map(|value| value.map(Value::to_string));
        if texts[0] == texts[1] {
            texts = texts.map(|text| text.map(|text| format!("{text}, its content differs")));
            let [Some(in_a), Some(in_b)] = &mut texts else { continue };
            in_a.push_str(&sizes(a, values[0]));
            in_b.push_str(&sizes(b, values[1]));
        }
        found.push(DifferentSetting { key: key.clone(), values: texts });
    }
    found
}

/// Whether two values are the same; numbers by value, files by content.
fn is_same(runs: [&RecordedSettings; 2], values: [&Value; 2]) -> bool {
    match values {
        [Value::Array(a), Value::Array(b)] => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(runs, [a, b])),
        [Value::Table(a), Value::Table(b)] => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| is_same(runs, [a, b])))
        }
        [Value::Integer(whole), Value::Float(float)] | [Value::Float(float), Value::Integer(whole)] => {
            *whole as f64 == *float
        }
        [Value::String(a), Value::String(b)] => match [file(runs[0], a), file(runs[1], b)] {
            [Some(a), Some(b)] => a == b,
            _ => a == b,
        },
        // By their bits: `nan` is the same as `nan`.
        [Value::Float(a), Value::Float(b)] => a == b || a.to_bits() == b.to_bits(),
        [a, b] => a == b,
    }
}

/// The content of the file that a value names.
fn file<'a>(run: &'a RecordedSettings, text: &str) -> Option<&'a Vec<u8>> {
    run.files.get(text.strip_prefix("mask:").unwrap_or(text))
}

fn sizes(run: &RecordedSettings, value: Option<&Value>) -> String {
    let words: Vec<&str> = match value {
        Some(Value::String(word)) => vec![word],
        Some(Value::Array(values)) => values.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    let sizes = words.into_iter().filter_map(|word| file(run, word)).map(|data| format!(" ({} bytes)", data.len()));
    sizes.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str, files: &[(&str, &[u8])]) -> RecordedSettings {
        let files = files.iter().map(|(path, data)| ((*path).to_owned(), data.to_vec())).collect();
        RecordedSettings::new(text, files).unwrap()
    }

    fn check(a: &RecordedSettings, b: &RecordedSettings, expected: &[(&str, Option<&str>, Option<&str>)]) {
        let found = differing([a, b]);
        let found: Vec<_> = found
            .iter()
            .map(|setting| (setting.key.as_str(), setting.values[0].as_deref(), setting.values[1].as_deref()))
            .collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn changed_added_and_removed_keys_are_found_but_not_their_origins() {
        let a = of("pace = 1 # built-in sim:3:1\n[servo]\ngain = 2.0 # a\nold = true\nlimits = [1.0, 2.0]\n", &[]);
        let b = of("pace = 1.0 # --set\n[servo]\ngain = 2.5 # b\nlimits = [1, 2.5]\n[servo.new]\nword = \"x\"\n", &[]);
        check(
            &a,
            &b,
            &[
                ("servo.gain", Some("2.0"), Some("2.5")),
                ("servo.limits", Some("[1.0, 2.0]"), Some("[1, 2.5]")),
                ("servo.new.word", None, Some("\"x\"")),
                ("servo.old", Some("true"), None),
            ],
        );
        check(&a, &a, &[]);
    }

    #[test]
    fn tables_of_an_array_are_compared_key_by_key() {
        let a = of("parts = [{ r = 1.0, name = \"a\" }, { r = 2.0 }]", &[]);
        let b = of("parts = [{ r = 1.5, name = \"a\" }]", &[]);
        check(&a, &b, &[("parts[0].r", Some("1.0"), Some("1.5")), ("parts[1].r", Some("2.0"), None)]);
    }

    #[test]
    fn files_are_compared_by_their_content() {
        let a =
            of("calib = \"rig/calib.json\"\nregion = \"mask:m.png\"", &[("rig/calib.json", b"{}"), ("m.png", b"1")]);
        let b = of(
            "calib = \"copies/0-calib.json\"\nregion = \"mask:m.png\"",
            &[("copies/0-calib.json", b"{}"), ("m.png", b"22")],
        );
        let text = |bytes: u8| format!("\"mask:m.png\", its content differs ({bytes} bytes)");
        check(&a, &b, &[("region", Some(&text(1)), Some(&text(2)))]);
    }

    #[test]
    fn what_is_no_toml_is_refused() {
        assert!(RecordedSettings::new("servo = ", BTreeMap::new()).is_err());
    }
}
