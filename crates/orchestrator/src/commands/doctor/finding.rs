//! What a check has found, and what to do.

use std::fmt::Write as _;

use serde::Serialize;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Verdict {
    /// As it should be.
    Pass,
    /// It works, but not well, or not always.
    Warning,
    /// It does not work.
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

    /// Of the program.
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
    /// What was looked at.
    pub(super) check: &'static str,
    pub(super) verdict: Verdict,
    /// What was found.
    pub(super) found: String,
    /// What to do, unless it passes.
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

    /// A warning, or a failure where a setup needs it.
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

    /// For people.
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
