//! The report of a check: all measurements, with the verdict.

use pb3dp_cell::finding::{Finding, Verdict, count};
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
        let passed = findings.iter().all(|finding| finding.verdict != Verdict::Fail);
        Self { passed, cameras, pairs, findings }
    }

    /// As text.
    pub(super) fn text(&self) -> String {
        let of = |verdict| count(&self.findings, verdict);
        let lines: String = self.findings.iter().map(|finding| finding.text(5)).collect();
        format!(
            "{}: {} pairs\n{lines}{} passed, {} failed, {} not checked",
            self.cameras,
            self.pairs,
            of(Verdict::Pass),
            of(Verdict::Fail),
            of(Verdict::NotChecked)
        )
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_cell::finding::Limits;

    use super::*;

    #[test]
    fn one_failure_decides_and_what_is_not_checked_does_not() {
        let pass = Finding::judged("a", (1.0, "px"), Limits::at_most(2.0), "", "");
        let not_checked = Finding::not_checked("b", "no calibration", "give --calib FILE");
        let fail = Finding::fail("c", "nothing to see", "light");
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
