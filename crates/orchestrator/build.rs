//! Records the commit that the program is built from, for reports.

use std::process::Command;

fn main() {
    // Written by commits and checkouts only; the index is rewritten by every look at the tree.
    println!("cargo::rerun-if-changed=../../.git/logs/HEAD");
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else { return };
    println!("cargo::rustc-env=PB3DP_COMMIT={commit}");
}
