//! A parsed YAML, JSON or TOML file; access errors name the file and the key.

use std::fmt::Display;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use nalgebra::SMatrix;
use pb3dp_geometry::ImageSize;
use serde_json::{Map, Value};

use super::error::{CalibrationFileError, one_line};
use crate::regular_file::read_regular;
use crate::unique_json;

/// Maximum size of a calibration file, bytes.
const BYTES_MAX: u64 = 1 << 20;

/// A file's contents as a tree.
pub(super) struct Document {
    file: PathBuf,
    value: Value,
}

/// A value in a [`Document`], with its file and key for error messages.
#[derive(Clone, Debug)]
pub(super) struct Node<'a> {
    file: &'a Path,
    key: String,
    value: &'a Value,
}

impl Document {
    /// Reads and parses a file: JSON or TOML by its extension, otherwise YAML.
    pub(super) fn read(file: &Path) -> Result<Self, CalibrationFileError> {
        let refuse = |reason: String| CalibrationFileError::Read { file: file.to_path_buf(), reason };
        let bytes = read_regular(file, BYTES_MAX).map_err(|error| match error.kind() {
            ErrorKind::NotFound => refuse(
                "no such file; give the path of a calibration, or write one with `pb3dp calibrate stereo`".to_owned(),
            ),
            _ => refuse(one_line(&error)),
        })?;
        let text =
            std::str::from_utf8(&bytes).map_err(|_| CalibrationFileError::NoText { file: file.to_path_buf() })?;
        Self::parse(file, text)
    }

    /// Parses the text of a file.
    pub(super) fn parse(file: &Path, text: &str) -> Result<Self, CalibrationFileError> {
        let is = |name: &str| file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(name));
        let syntax =
            |line, language, reason| CalibrationFileError::Syntax { file: file.to_path_buf(), line, language, reason };
        let value: Value = if is("json") {
            unique_json::from_str(text)
                .map_err(|error| syntax(u64::try_from(error.line()).unwrap_or(0), "JSON", error.to_string()))?
        } else if is("toml") {
            toml::from_str(text).map_err(|error| {
                let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
                syntax(before.lines().count().max(1) as u64, "TOML", error.message().to_owned())
            })?
        } else {
            // Numbers that are not finite are accepted here, so that a later error can name their key.
            let options = serde_saphyr::options! {
                non_finite_float_policy: serde_saphyr::options::NonFiniteFloatPolicy::AsString
            };
            serde_saphyr::from_str_with_options(text, options).map_err(|error| {
                let line = error.location().map_or(0, |location| location.line());
                syntax(line, "YAML", error.without_snippet().to_string())
            })?
        };
        Ok(Self { file: file.to_path_buf(), value })
    }

    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    pub(super) fn root(&self) -> Node<'_> {
        Node { file: &self.file, key: String::new(), value: &self.value }
    }

    /// The top-level keys, for the message that none of them is known.
    pub(super) fn keys(&self) -> String {
        match &self.value {
            Value::Object(map) if !map.is_empty() => map.keys().take(12).cloned().collect::<Vec<_>>().join(", "),
            _ => "none".to_owned(),
        }
    }
}

impl<'a> Node<'a> {
    /// The refusal of `key` below this node.
    pub(super) fn error(&self, key: &str, reason: impl Display) -> CalibrationFileError {
        CalibrationFileError::Key { file: self.file.to_path_buf(), key: self.path(key), reason: reason.to_string() }
    }

    /// The refusal of this node itself.
    pub(super) fn refuse(&self, reason: impl Display) -> CalibrationFileError {
        CalibrationFileError::Key { file: self.file.to_path_buf(), key: self.key.clone(), reason: reason.to_string() }
    }

    /// The value of `key`, if present and not null.
    pub(super) fn find(&self, key: &str) -> Option<Node<'a>> {
        let value = self.map()?.get(key).filter(|value| !value.is_null())?;
        Some(Node { file: self.file, key: self.path(key), value })
    }

    /// The value of `key`.
    pub(super) fn get(&self, key: &str) -> Result<Node<'a>, CalibrationFileError> {
        self.find(key).ok_or_else(|| self.error(key, "is missing"))
    }

    /// A string.
    pub(super) fn text(&self) -> Result<&'a str, CalibrationFileError> {
        self.value.as_str().ok_or_else(|| self.refuse("must be a string"))
    }

    /// The elements of a list.
    pub(super) fn items(&self) -> Result<Vec<Node<'a>>, CalibrationFileError> {
        self.elements().ok_or_else(|| self.refuse("must be a list"))
    }

    /// The keys of a table with their values, by name.
    pub(super) fn entries(&self) -> Result<Vec<(String, Node<'a>)>, CalibrationFileError> {
        let map = self.map().ok_or_else(|| self.refuse("must be a table"))?;
        let node = |key: &str, value: &'a Value| Node { file: self.file, key: self.path(key), value };
        Ok(map.iter().map(|(key, value)| (key.clone(), node(key, value))).collect())
    }

    /// A Boolean.
    pub(super) fn truth(&self) -> Result<bool, CalibrationFileError> {
        self.value.as_bool().ok_or_else(|| self.refuse("must be true or false"))
    }

    /// A finite number.
    pub(super) fn number(&self) -> Result<f64, CalibrationFileError> {
        match self.value.as_f64() {
            Some(number) if number.is_finite() => Ok(number),
            _ => Err(self.refuse(format!("{} is not a finite number", self.value))),
        }
    }

    /// Width and height in pixels, from two nodes.
    pub(super) fn size(width: &Node<'_>, height: &Node<'_>) -> Result<ImageSize, CalibrationFileError> {
        let side = |node: &Node<'_>| {
            let number = node.number()?;
            if number.fract() != 0.0 || !(1.0..=65_535.0).contains(&number) {
                return Err(node.refuse(format!("{number} is not a number of pixels")));
            }
            Ok(number as u32)
        };
        Ok(ImageSize { width: side(width)?, height: side(height)? })
    }

    /// Width and height from a list of two.
    pub(super) fn size_pair(&self) -> Result<ImageSize, CalibrationFileError> {
        match self.elements().as_deref() {
            Some([width, height]) => Self::size(width, height),
            _ => Err(self.refuse("must be [width, height]")),
        }
    }

    /// All numbers of a list, of nested lists, or of a matrix written as `rows`, `cols`, `data`, row by row.
    pub(super) fn numbers(&self) -> Result<Vec<f64>, CalibrationFileError> {
        Ok(self.table()?.2)
    }

    /// A matrix of `R` rows and `C` columns; a vector (`C` = 1) may also be written as a row or as a plain list.
    pub(super) fn matrix<const R: usize, const C: usize>(&self) -> Result<SMatrix<f64, R, C>, CalibrationFileError> {
        let (rows, columns, numbers) = self.table()?;
        let fits = (rows, columns) == (R, C) || (C == 1 && rows.min(columns) == 1 && rows.max(columns) == R);
        if !fits {
            return Err(self.refuse(format!("has {rows} x {columns} elements, {R} x {C} are needed")));
        }
        Ok(SMatrix::from_row_slice(&numbers))
    }

    /// Rows, columns and elements row by row.
    fn table(&self) -> Result<(usize, usize, Vec<f64>), CalibrationFileError> {
        if self.map().is_some() {
            return self.tagged_table();
        }
        let elements = self.elements().ok_or_else(|| self.refuse("must be a list of numbers"))?;
        if !elements.iter().any(|element| element.value.is_array()) {
            let numbers = elements.iter().map(Node::number).collect::<Result<Vec<_>, _>>()?;
            return Ok((1, numbers.len(), numbers));
        }
        let mut numbers = Vec::new();
        let mut columns = None;
        for row in &elements {
            let cells = row.elements().ok_or_else(|| row.refuse("must be a row of numbers, like the other rows"))?;
            if *columns.get_or_insert(cells.len()) != cells.len() {
                return Err(row.refuse(format!("has {} elements, unlike the rows before", cells.len())));
            }
            for cell in &cells {
                numbers.push(cell.number()?);
            }
        }
        Ok((elements.len(), columns.unwrap_or(0), numbers))
    }

    /// A matrix written as `rows`, `cols`, `data`.
    fn tagged_table(&self) -> Result<(usize, usize, Vec<f64>), CalibrationFileError> {
        let count = |key: &str| {
            let node = self.get(key)?;
            let number = node.number()?;
            if number.fract() != 0.0 || !(0.0..=64.0).contains(&number) {
                return Err(node.refuse(format!("{number} is not a number of rows or columns")));
            }
            Ok(number as usize)
        };
        let (rows, columns) = (count("rows")?, count("cols")?);
        let data = self.get("data")?;
        let elements = data.elements().ok_or_else(|| data.refuse("must be a list of numbers"))?;
        if elements.len() != rows * columns {
            return Err(data.refuse(format!("has {} elements, but rows x cols is {rows} x {columns}", elements.len())));
        }
        Ok((rows, columns, elements.iter().map(Node::number).collect::<Result<_, _>>()?))
    }

    fn elements(&self) -> Option<Vec<Node<'a>>> {
        let list = self.value.as_array()?;
        let node = |(i, value)| Node { file: self.file, key: format!("{}[{i}]", self.key), value };
        Some(list.iter().enumerate().map(node).collect())
    }

    fn map(&self) -> Option<&'a Map<String, Value>> {
        self.value.as_object()
    }

    fn path(&self, key: &str) -> String {
        if self.key.is_empty() { key.to_owned() } else { format!("{}.{key}", self.key) }
    }
}
