//! Tests that a machine cannot run.

use std::io::Write;

/// Start of such a report. `cargo xtask test` searches for it at the start of a line.
const MARK: &str = "NOT CHECKED";

/// Maximum number of characters of a reason that are shown.
const LENGTH: usize = 300;

/// Reports that a test, or a part of one, was not checked on this machine: permissions, tools or processor features are missing,
/// or the machine did not meet its deadlines.
///
/// The line goes directly to standard error, bypassing the capture of the test harness, so that every test runner shows it. The
/// test passes for its harness; `cargo xtask test` counts it as skipped.
pub fn not_checked(name: &str, reason: &str) {
    let reason: String = reason.replace('\n', " ").chars().take(LENGTH).collect();
    // A closed standard error is not a failure.
    let _ = writeln!(std::io::stderr(), "{MARK}: {name}: {reason}");
}
