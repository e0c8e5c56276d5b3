//! Tests that a machine cannot run.

use std::io::Write;

/// What such a report begins with. `cargo xtask test` looks for this at the start of a line.
const MARK: &str = "NOT CHECKED";

/// Letters of a reason that are shown.
const LENGTH: usize = 300;

/// Reports that a test, or a part of one, was not checked on this machine: rights, tools or processor features are missing, or the
/// machine did not keep time.
///
/// The line goes to standard error directly, past the capture of the test harness, so that every way of running the test shows it.
/// The test passes for its harness; `cargo xtask test` counts it as skipped.
pub fn not_checked(name: &str, reason: &str) {
    let reason: String = reason.replace('\n', " ").chars().take(LENGTH).collect();
    // A closed standard error is no reason to fail.
    let _ = writeln!(std::io::stderr(), "{MARK}: {name}: {reason}");
}
