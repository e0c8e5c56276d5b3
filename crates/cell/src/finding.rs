//! Result of a check: what was found or measured, whether that is good, and the remedy if it is not.

use serde::{Serialize, Serializer};

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Not checked.
    NotChecked,
    /// Passed.
    Pass,
    /// Works, but not well or not always.
    Warning,
    /// Does not work.
    Fail,
}

impl Verdict {
    fn command(self) -> &'static str {
        match self {
            Self::NotChecked => "-",
            Self::Pass => "pass",
            Self::Warning => "warning",
            Self::Fail => "FAIL",
        }
    }
}

/// One finding. It is serialised as a measurement, with `passed`; null if it was not checked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Checked item, or measured quantity.
    pub check: String,
    /// Severity.
    #[serde(rename = "passed", serialize_with = "passed")]
    pub verdict: Verdict,
    /// The value; `None`: there is none, or it could not be measured.
    pub value: Option<f64>,
    /// Unit of value and limits.
    pub unit: &'static str,
    /// Limits of the value.
    #[serde(flatten)]
    pub limits: Limits,
    /// Result, or further details of a value.
    pub found: String,
    /// Remedy, unless the check passes.
    pub advice: Option<String>,
}

/// Limits of a value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Limits {
    /// Smallest good value.
    #[serde(rename = "limit_min")]
    pub min: Option<f64>,
    /// Largest good value.
    #[serde(rename = "limit_max")]
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
    /// A check that passes.
    pub fn pass(check: impl Into<String>, found: impl Into<String>) -> Self {
        let (check, found, limits) = (check.into(), found.into(), Limits::default());
        Self { check, verdict: Verdict::Pass, value: None, unit: "", limits, found, advice: None }
    }

    /// Something that works, but not well or not always.
    pub fn warning(check: impl Into<String>, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { verdict: Verdict::Warning, advice: Some(advice.into()), ..Self::pass(check, found) }
    }

    /// Something that does not work, or a quantity that has to be measured and could not.
    pub fn fail(check: impl Into<String>, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { verdict: Verdict::Fail, advice: Some(advice.into()), ..Self::pass(check, found) }
    }

    /// Something that was not checked, with the reason.
    pub fn not_checked(check: impl Into<String>, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { verdict: Verdict::NotChecked, advice: Some(advice.into()), ..Self::pass(check, found) }
    }

    /// A warning, or a failure if the item is needed.
    pub fn missing(
        is_needed: bool,
        check: impl Into<String>,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        if is_needed { Self::fail(check, found, advice) } else { Self::warning(check, found, advice) }
    }

    /// A value with its limits.
    pub fn judged(
        check: impl Into<String>,
        (value, unit): (f64, &'static str),
        limits: Limits,
        found: impl Into<String>,
        advice: &str,
    ) -> Self {
        let finding = if limits.holds(value) { Self::pass(check, found) } else { Self::fail(check, found, advice) };
        Self { value: Some(value).filter(|value| value.is_finite()), unit, limits, ..finding }
    }

    /// As text, with verdicts of this width; the remedy has its own line.
    pub fn text(&self, width: usize) -> String {
        let Self { check, verdict, value, unit, limits, found, advice } = self;
        let mut text = format!("{:<width$} {check}: ", verdict.command());
        if let Some(value) = value {
            text += &format!("{value:.2} {unit} ({}){}", limits.text(), if found.is_empty() { "" } else { "; " });
        }
        text += &format!("{found}\n");
        if let Some(advice) = advice {
            text += &format!("{:width$} -> {advice}\n", "");
        }
        text
    }
}

fn passed<S: Serializer>(verdict: &Verdict, serializer: S) -> Result<S::Ok, S::Error> {
    (*verdict != Verdict::NotChecked).then_some(*verdict == Verdict::Pass).serialize(serializer)
}

/// Number of findings with a verdict.
pub fn count(findings: &[Finding], verdict: Verdict) -> usize {
    findings.iter().filter(|finding| finding.verdict == verdict).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_fails() {
        let judged = |value| Finding::judged("x", (value, "px"), Limits::between(1.0, 2.0), "", "do it").verdict;
        let (pass, fail) = (Verdict::Pass, Verdict::Fail);
        assert_eq!([0.9, 1.0, 2.0, 2.1, f64::NAN].map(judged), [fail, pass, pass, fail, fail]);
        let finding = Finding::judged("x", (f64::INFINITY, "px"), Limits::at_most(3.0), "", "do it");
        assert_eq!((finding.value, finding.advice.as_deref()), (None, Some("do it")));
    }
}
