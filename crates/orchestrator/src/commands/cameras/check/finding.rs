//! A measurement of a check, with its limit.

use std::fmt::Write as _;

use serde::Serialize;

/// One measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Finding {
    /// Measured quantity.
    pub(super) check: String,
    /// The value; `None`: it could not be measured.
    pub(super) passed: Option<bool>,
    pub(super) value: Option<f64>,
    pub(super) unit: &'static str,
    pub(super) limit_min: Option<f64>,
    pub(super) limit_max: Option<f64>,
    /// Further details.
    pub(super) found: String,
    /// Remedy, unless the check passes.
    pub(super) advice: Option<String>,
}

/// The limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Limits {
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
}

impl Limits {
    pub(super) fn at_most(max: f64) -> Self {
        Self { min: None, max: Some(max) }
    }

    pub(super) fn between(min: f64, max: f64) -> Self {
        Self { min: Some(min), max: Some(max) }
    }

    /// NaN is outside every limit.
    fn holds(self, value: f64) -> bool {
        value.is_finite() && self.min.is_none_or(|min| value >= min) && self.max.is_none_or(|max| value <= max)
    }

    fn text(self) -> String {
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
    pub(super) fn judged(
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
    pub(super) fn missing(
        check: impl Into<String>,
        passed: Option<bool>,
        found: impl Into<String>,
        advice: &str,
    ) -> Self {
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

/// All measurements.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    /// Whether nothing failed.
    pub(super) passed: bool,
    pub(super) cameras: String,
    pub(super) pairs: u64,
    pub(super) findings: Vec<Finding>,
}

impl Report {
    pub(super) fn of(cameras: String, pairs: u64, findings: Vec<Finding>) -> Self {
        let passed = findings.iter().all(|finding| finding.passed != Some(false));
        Self { passed, cameras, pairs, findings }
    }

    /// As text.
    pub(super) fn text(&self) -> String {
        let mut text = format!("{}: {} pairs\n", self.cameras, self.pairs);
        for finding in &self.findings {
            let Finding { check, passed, value, unit, limit_min, limit_max, found, advice } = finding;
            let word = match passed {
                Some(true) => "pass",
                Some(false) => "FAIL",
                None => "-",
            };
            let _ = write!(text, "{word:<5} {check}: ");
            if let Some(value) = value {
                let limits = Limits { min: *limit_min, max: *limit_max };
                let _ =
                    write!(text, "{value:.2} {unit} ({}){}", limits.text(), if found.is_empty() { "" } else { "; " });
            }
            let _ = writeln!(text, "{found}");
            if let Some(advice) = advice {
                let _ = writeln!(text, "      -> {advice}");
            }
        }
        let count = |wanted: Option<bool>| self.findings.iter().filter(|finding| finding.passed == wanted).count();
        let _ =
            write!(text, "{} passed, {} failed, {} not checked", count(Some(true)), count(Some(false)), count(None));
        text
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

    #[test]
    fn one_failure_decides_and_what_is_not_checked_does_not() {
        let pass = Finding::judged("a", (1.0, "px"), Limits::at_most(2.0), "", "");
        let not_checked = Finding::missing("b", None, "no calibration", "give --calib FILE");
        let fail = Finding::missing("c", Some(false), "nothing to see", "light");
        assert!(Report::of("x".into(), 3, vec![pass.clone(), not_checked.clone()]).passed);
        let report = Report::of("x".into(), 3, vec![pass, not_checked, fail]);
        let text = report.text();
        assert!(!report.passed && text.ends_with("1 passed, 1 failed, 1 not checked"), "{text}");
        assert!(
            text.contains("pass  a: 1.00 px (at most 2.00)\n")
                && text.contains("FAIL  c: nothing to see\n      -> light")
        );
    }
}
