//! `cargo xtask ci`: everything that must hold before a change is taken.

use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use crate::workspace::{Workspace, run_visibly};
use crate::{check_deps, licences, test, tidy};

/// Runs every check, the cheapest first, and stops at the first that fails.
///
/// fmt, tidy, check-deps, licences, clippy, rustdoc, tests, a quick run of the accuracy benchmark: warnings of clippy and rustdoc are errors here. At the end stands
/// a table with the time of each; after a failure, the command that repeats it alone. Needs the rustup components rustfmt and
/// clippy (the failure says what to type), and nothing else beside rustc, cargo and cc.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Run one check only.
    #[arg(long, value_parser = STEPS.map(|step| step.name))]
    only: Option<String>,
}

struct Step {
    name: &'static str,
    run: fn(&Workspace) -> anyhow::Result<()>,
}

const STEPS: [Step; 8] = [
    Step { name: "fmt", run: fmt },
    Step { name: "tidy", run: |workspace| tidy::run(workspace, &tidy::Args {}) },
    Step { name: "check-deps", run: |workspace| check_deps::run(workspace, &check_deps::Args {}) },
    Step { name: "licences", run: licences::run },
    Step { name: "clippy", run: clippy },
    Step { name: "doc", run: doc },
    Step { name: "test", run: |workspace| run_visibly(&mut test::all_tests(workspace)) },
    Step { name: "accuracy", run: accuracy },
];

/// # Errors
/// If a check fails.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let wanted = |step: &&Step| args.only.as_deref().is_none_or(|only| only == step.name);
    let mut times: Vec<(&str, Duration)> = Vec::new();
    for step in STEPS.iter().filter(wanted) {
        println!("== {}", step.name);
        let start = Instant::now();
        let outcome = (step.run)(workspace);
        times.push((step.name, start.elapsed()));
        if let Err(error) = outcome {
            print!("{}", summary(&times, true));
            return Err(
                error.context(format!("`{}` failed; to repeat it: cargo xtask ci --only {}", step.name, step.name))
            );
        }
    }
    print!("{}", summary(&times, false));
    Ok(())
}

/// The table of the checks that ran, of which the last may have failed.
fn summary(times: &[(&str, Duration)], last_failed: bool) -> String {
    let mut table = String::from("\ncheck        time, s  result\n");
    for (index, (name, time)) in times.iter().enumerate() {
        let failed = last_failed && index + 1 == times.len();
        let result = if failed { "FAILED" } else { "ok" };
        table.push_str(&format!("{name:<10} {:>9.1}  {result}\n", time.as_secs_f64()));
    }
    table
}

/// Fails with what to type if a component of the toolchain is missing.
fn require(workspace: &Workspace, command: &str, component: &str) -> anyhow::Result<()> {
    let status = workspace.cargo().args([command, "--version"]).output().context("cannot run cargo")?.status;
    if !status.success() {
        bail!("`cargo {command}` is missing: type `rustup component add {component}`");
    }
    Ok(())
}

fn fmt(workspace: &Workspace) -> anyhow::Result<()> {
    require(workspace, "fmt", "rustfmt")?;
    run_visibly(workspace.cargo().args(["fmt", "--all", "--check"]))
}

fn clippy(workspace: &Workspace) -> anyhow::Result<()> {
    require(workspace, "clippy", "clippy")?;
    let args = ["clippy", "--workspace", "--all-targets", "--locked", "--", "-D", "warnings"];
    run_visibly(workspace.cargo().args(args))
}

fn doc(workspace: &Workspace) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.args(["doc", "--workspace", "--no-deps", "--locked"]).env("RUSTDOCFLAGS", "-D warnings");
    run_visibly(&mut command)
}

/// The accuracy benchmark with few poses, with optimisation: fails if a limit is not kept.
fn accuracy(workspace: &Workspace) -> anyhow::Result<()> {
    let package = ["run", "--release", "--locked", "--package", "pb3dp-benchmarks"];
    run_visibly(workspace.cargo().args(package).args(["--bin", "pb3dp-bench", "--", "accuracy", "--quick"]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_shows_each_check_and_the_failure() {
        let times = [("fmt", Duration::from_millis(1500)), ("clippy", Duration::from_secs(61))];
        let expected = "\ncheck        time, s  result\nfmt              1.5  ok\nclippy          61.0  FAILED\n";
        assert_eq!(summary(&times, true), expected);
        assert!(!summary(&times, false).contains("FAILED"));
    }
}
