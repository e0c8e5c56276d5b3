//! Limits of measured figures.

use serde_json::{Value, json};

use crate::table::Column;

/// Columns of a table of limits.
pub const COLUMNS: [Column<'static>; 4] =
    [("figure", "{what}"), ("measured", "{found:3} {unit}"), ("limit", "{most} {unit}"), ("met", "{kept}")];

/// One limit and the measured figure.
#[derive(Clone, Debug)]
pub struct Check {
    /// The limited figure.
    pub what: String,
    /// What was measured; `None`, a miss, where there is no figure.
    pub found: Option<f64>,
    /// The largest allowed value.
    pub most: f64,
    /// Unit of both.
    pub unit: &'static str,
}

impl Check {
    /// Whether the limit is met. NaN meets no limit.
    pub fn is_kept(&self) -> bool {
        self.found.is_some_and(|found| found <= self.most)
    }

    /// As a row.
    pub fn to_json(&self) -> Value {
        json!({ "what": self.what, "found": self.found, "most": self.most, "unit": self.unit, "kept": self.is_kept() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_keeps_no_limit() {
        let check = |found| Check { what: "it".to_owned(), found, most: 1.0, unit: "mm" };
        assert!(check(Some(1.0)).is_kept() && !check(Some(1.001)).is_kept());
        assert!(!check(None).is_kept() && !check(Some(f64::NAN)).is_kept());
    }
}
