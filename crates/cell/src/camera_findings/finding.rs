//! A measurement of a check, with its limit.

use serde::Serialize;

/// One measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Measured quantity.
    pub check: String,
    /// Whether the value is within its limits; `None`: not checked.
    pub passed: Option<bool>,
    /// The value; `None`: it could not be measured.
    pub value: Option<f64>,
    /// Unit of value and limits.
    pub unit: &'static str,
    /// Smallest good value.
    pub limit_min: Option<f64>,
    /// Largest good value.
    pub limit_max: Option<f64>,
    /// Further details.
    pub found: String,
    /// Remedy, unless the check passes.
    pub advice: Option<String>,
}

/// The limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Smallest good value.
    pub min: Option<f64>,
    /// Largest good value.
    pub max: Option<f64>,
}

impl Limits {
    /// An upper limit.
    pub fn at_most(max: f64) -> Self {
        Self { min: None, max: Some(max) }
    }

    /// Both limits.
    pub fn between(min: f64, max: f64) -> Self {
        Self { min: Some(min), max: Some(max) }
    }

    /// NaN is outside every limit.
    fn holds(self, value: f64) -> bool {
        value.is_finite() && self.min.is_none_or(|min| value >= min) && self.max.is_none_or(|max| value <= max)
    }

    /// As text.
    pub fn text(self) -> String {
        match (self.min, self.max) {
            (Some(min), Some(max)) => format!("{min:.2} to {max:.2}"),
            (Some(min), None) => format!("at least {min:.2}"),
            (None, Some(max)) => format!("at most {max:.2}"),
            (None, None) => "any".to_owned(),
        }
    }
}

impl Finding {
    /// A value with its limits.
    pub fn judged(
        check: impl Into<String>,
        (value, unit): (f64, &'static str),
        limits: Limits,
        found: impl Into<String>,
        advice: &str,
    ) -> Self {
        let passed = limits.holds(value);
        Self {
            check: check.into(),
            passed: Some(passed),
            value: Some(value).filter(|value| value.is_finite()),
            unit,
            limit_min: limits.min,
            limit_max: limits.max,
            found: found.into(),
            advice: (!passed).then(|| advice.to_owned()),
        }
    }

    /// A quantity that could not be measured; `passed` says whether that is acceptable.
    pub fn missing(check: impl Into<String>, passed: Option<bool>, found: impl Into<String>, advice: &str) -> Self {
        Self {
            check: check.into(),
            passed,
            value: None,
            unit: "",
            limit_min: None,
            limit_max: None,
            found: found.into(),
            advice: Some(advice.to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_fails() {
        let judged = |value| Finding::judged("x", (value, "px"), Limits::between(1.0, 2.0), "", "do it").passed;
        assert_eq!([0.9, 1.0, 2.0, 2.1, f64::NAN].map(judged), [false, true, true, false, false].map(Some));
        let finding = Finding::judged("x", (f64::INFINITY, "px"), Limits::at_most(3.0), "", "do it");
        assert_eq!((finding.value, finding.advice.as_deref()), (None, Some("do it")));
    }
}
