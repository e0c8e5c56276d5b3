//! Checked access to JSON values: every error names the file, the key, the value and the allowed values.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::DatasetError;
use crate::text_file::read_text;
use crate::unique_json;

/// A whole JSON file.
pub(super) struct JsonFile {
    path: PathBuf,
    root: Value,
}

impl JsonFile {
    pub(super) fn read(path: &Path) -> Result<Self, DatasetError> {
        let text =
            read_text(path).map_err(|source| DatasetError::Io { file: path.to_owned(), action: "read", source })?;
        let root =
            unique_json::from_str(&text).map_err(|source| DatasetError::Syntax { file: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), root })
    }

    /// A document assembled from another file.
    pub(super) fn of(path: PathBuf, root: Value) -> Self {
        Self { path, root }
    }

    pub(super) fn root(&self) -> Node<'_> {
        Node { file: &self.path, key: String::new(), value: &self.root }
    }
}

/// One value inside a JSON file, with its key path.
pub(super) struct Node<'a> {
    file: &'a Path,
    key: String,
    value: &'a Value,
}

impl<'a> Node<'a> {
    /// The error for an unexpected value.
    pub(super) fn refuse(&self, expected: impl Into<String>) -> DatasetError {
        DatasetError::Value {
            file: self.file.to_owned(),
            key: if self.key.is_empty() { "(whole file)".into() } else { self.key.clone() },
            value: shortened(self.value),
            expected: expected.into(),
        }
    }

    fn step(&self, key: &str, value: &'a Value) -> Self {
        let key = if self.key.is_empty() { key.to_owned() } else { format!("{}.{key}", self.key) };
        Self { file: self.file, key, value }
    }

    /// A required key.
    pub(super) fn get(&self, key: &str) -> Result<Self, DatasetError> {
        if !self.value.is_object() {
            return Err(self.refuse("must be an object { .. }"));
        }
        match self.value.get(key) {
            Some(value) => Ok(self.step(key, value)),
            None => Err(DatasetError::MissingKey { file: self.file.to_owned(), key: self.step(key, &Value::Null).key }),
        }
    }

    /// An optional key, which may be absent or null.
    pub(super) fn optional(&self, key: &str) -> Option<Self> {
        self.value.get(key).filter(|value| !value.is_null()).map(|value| self.step(key, value))
    }

    /// Keys of this object that are not in `known`.
    pub(super) fn other_keys(&self, known: &[&str]) -> Vec<String> {
        let keys = self.value.as_object().into_iter().flat_map(|map| map.keys());
        keys.filter(|key| !known.contains(&key.as_str())).cloned().collect()
    }

    pub(super) fn text(&self) -> Result<&'a str, DatasetError> {
        self.value.as_str().filter(|text| !text.is_empty()).ok_or_else(|| self.refuse("must be a string"))
    }

    pub(super) fn boolean(&self) -> Result<bool, DatasetError> {
        self.value.as_bool().ok_or_else(|| self.refuse("must be true or false"))
    }

    pub(super) fn count(&self) -> Result<u64, DatasetError> {
        self.value.as_u64().filter(|n| *n > 0).ok_or_else(|| self.refuse("must be an integer of at least 1"))
    }

    pub(super) fn number(&self) -> Result<f64, DatasetError> {
        self.value.as_f64().filter(|x| x.is_finite()).ok_or_else(|| self.refuse("must be a number"))
    }

    pub(super) fn positive(&self) -> Result<f64, DatasetError> {
        self.number().ok().filter(|x| *x > 0.0).ok_or_else(|| self.refuse("must be a number greater than 0"))
    }

    pub(super) fn not_negative(&self) -> Result<f64, DatasetError> {
        self.number().ok().filter(|x| *x >= 0.0).ok_or_else(|| self.refuse("must be a number of at least 0"))
    }

    pub(super) fn items(&self) -> Result<Vec<Self>, DatasetError> {
        let items = self.value.as_array().ok_or_else(|| self.refuse("must be a list [ .. ]"))?;
        Ok(items
            .iter()
            .enumerate()
            .map(|(i, value)| Self { file: self.file, key: format!("{}[{i}]", self.key), value })
            .collect())
    }

    /// A list of exactly `N` numbers.
    pub(super) fn numbers<const N: usize>(&self) -> Result<[f64; N], DatasetError> {
        let items = self.items()?;
        if items.len() != N {
            return Err(self.refuse(format!("must be a list of {N} numbers, not {}", items.len())));
        }
        let mut numbers = [0.0; N];
        for (number, item) in numbers.iter_mut().zip(&items) {
            *number = item.number()?;
        }
        Ok(numbers)
    }

    /// A file name, relative to the folder of this JSON file unless absolute.
    pub(super) fn path(&self) -> Result<PathBuf, DatasetError> {
        let folder = self.file.parent().unwrap_or(Path::new(""));
        Ok(folder.join(self.text()?))
    }
}

fn shortened(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= 60 { text } else { text.chars().take(57).chain("...".chars()).collect() }
}
