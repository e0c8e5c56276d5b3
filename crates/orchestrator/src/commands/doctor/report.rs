//! The report of all checks.

use pb3dp_cell::finding::{Finding, Verdict, count};
use serde::Serialize;

/// All findings.
#[derive(Debug)]
pub(super) struct Report {
    pub(super) worst: Verdict,
    pub(super) findings: Vec<Finding>,
}

/// The report in the form of `--json`.
#[derive(Serialize)]
struct Json<'a> {
    worst: Verdict,
    findings: Vec<JsonFinding<'a>>,
}

#[derive(Serialize)]
struct JsonFinding<'a> {
    check: &'a str,
    verdict: Verdict,
    found: &'a str,
    advice: Option<&'a str>,
}

impl Report {
    pub(super) fn of(findings: Vec<Finding>) -> Self {
        let worst = findings.iter().map(|finding| finding.verdict).max().unwrap_or(Verdict::Pass);
        Self { worst, findings }
    }

    pub(super) fn exit_code(&self) -> u8 {
        match self.worst {
            Verdict::Pass | Verdict::NotChecked => 0,
            Verdict::Warning => 1,
            Verdict::Fail => 2,
        }
    }

    pub(super) fn json(&self) -> serde_json::Result<String> {
        serde_json::to_string(&Json {
            worst: self.worst,
            findings: self.findings.iter().map(JsonFinding::of).collect(),
        })
    }

    /// As text.
    pub(super) fn text(&self) -> String {
        let of = |verdict| count(&self.findings, verdict);
        let lines: String = self.findings.iter().map(|finding| finding.text(8)).collect();
        format!(
            "{lines}\n{} passed, {} warnings, {} failed",
            of(Verdict::Pass),
            of(Verdict::Warning),
            of(Verdict::Fail)
        )
    }
}

impl<'a> JsonFinding<'a> {
    fn of(finding: &'a Finding) -> Self {
        let Finding { check, verdict, found, advice, .. } = finding;
        Self { check, verdict: *verdict, found, advice: advice.as_deref() }
    }
}
