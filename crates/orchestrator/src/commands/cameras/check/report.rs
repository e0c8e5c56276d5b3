//! The report of a check: all measurements, with the verdict.

use std::fmt::Write as _;

use pb3dp_cell::camera_findings::{Finding, Limits};
use serde::Serialize;

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
