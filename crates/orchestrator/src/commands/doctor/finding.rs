//! Result of a check, with its remedy.

use std::fmt::Write as _;

use serde::Serialize;

/// Severity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Verdict {
    /// Passed.
    Pass,
    /// Works, but not well or not always.
    Warning,
    /// Does not work.
    Fail,
}

impl Verdict {
    fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Warning => "warning",
            Self::Fail => "FAIL",
        }
    }

    /// Name in the output.
    pub(super) fn exit_code(self) -> u8 {
        match self {
            Self::Pass => 0,
            Self::Warning => 1,
            Self::Fail => 2,
        }
    }
}

/// One finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Finding {
    /// Checked item.
    pub(super) check: &'static str,
    pub(super) verdict: Verdict,
    /// Result.
    pub(super) found: String,
    /// Remedy, unless the check passes.
    pub(super) advice: Option<String>,
}

impl Finding {
    pub(super) fn pass(check: &'static str, found: impl Into<String>) -> Self {
        Self { check, verdict: Verdict::Pass, found: found.into(), advice: None }
    }

    pub(super) fn warning(check: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { check, verdict: Verdict::Warning, found: found.into(), advice: Some(advice.into()) }
    }

    pub(super) fn fail(check: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { check, verdict: Verdict::Fail, found: found.into(), advice: Some(advice.into()) }
    }

    /// A warning, or a failure if a setup needs the item.
    pub(super) fn missing(
        is_needed: bool,
        check: &'static str,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        if is_needed { Self::fail(check, found, advice) } else { Self::warning(check, found, advice) }
    }
}

/// All findings.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) worst: Verdict,
    pub(super) findings: Vec<Finding>,
}

impl Report {
    pub(super) fn of(findings: Vec<Finding>) -> Self {
        let worst = findings.iter().map(|finding| finding.verdict).max().unwrap_or(Verdict::Pass);
        Self { worst, findings }
    }

    /// As text.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for Finding { check, verdict, found, advice } in &self.findings {
            let _ = writeln!(text, "{:<8} {check}: {found}", verdict.word());
            if let Some(advice) = advice {
                let _ = writeln!(text, "         -> {advice}");
            }
        }
        let count = |verdict: Verdict| self.findings.iter().filter(|finding| finding.verdict == verdict).count();
        let _ = write!(
            text,
            "\n{} passed, {} warnings, {} failed",
            count(Verdict::Pass),
            count(Verdict::Warning),
            count(Verdict::Fail)
        );
        text
    }
}
