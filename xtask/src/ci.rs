//! `cargo xtask ci`: everything that must hold before a change is taken.

use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use crate::workspace::{Workspace, run_visibly};
use crate::{check_deps, commissioning, licences, test, tidy, vm};

/// Runs every check, the cheapest first, and stops at the first that fails.
///
/// fmt, tidy, check-deps, licences, clippy, rustdoc, tests, safeguards switched off one by one, a bare rig calibrated by the commands of its documentation, drivers in an emulated computer, a quick run of the accuracy benchmark:
/// warnings of clippy and rustdoc are errors here. At the end stands a table with the time of each; after a failure, the command that
/// repeats it alone. Needs the rustup components rustfmt and clippy (the failure says what to type), and nothing else beside rustc,
/// cargo and cc. The step vm wants QEMU and a kernel, which it fetches by apt-get where that is permitted; elsewhere it is skipped,
/// and the last lines say so.
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

const STEPS: [Step; 11] = [
    Step { name: "fmt", run: fmt },
    Step { name: "tidy", run: |workspace| tidy::run(workspace, &tidy::Args {}) },
    Step { name: "check-deps", run: |workspace| check_deps::run(workspace, &check_deps::Args {}) },
    Step { name: "licences", run: licences::run },
    Step { name: "clippy", run: clippy },
    Step { name: "doc", run: doc },
    Step { name: "test", run: |workspace| run_visibly(&mut test::all_tests(workspace)) },
    Step { name: "safeguards", run: safeguards },
    Step { name: "commissioning", run: commissioning::calibrate },
    Step { name: "vm", run: vm::run_all },
    Step { name: "accuracy", run: accuracy },
];

/// What became of a step.
enum Outcome {
    Passed,
    Failed,
    /// This machine lacks what it needs.
    Skipped(String),
}

/// A step that ran, or not.
struct Done {
    name: &'static str,
    time: Duration,
    outcome: Outcome,
}

/// # Errors
/// If a check fails.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let wanted = |step: &&Step| args.only.as_deref().is_none_or(|only| only == step.name);
    let mut done: Vec<Done> = Vec::new();
    for step in STEPS.iter().filter(wanted) {
        println!("== {}", step.name);
        let start = Instant::now();
        let result = (step.run)(workspace);
        let time = start.elapsed();
        let (outcome, error) = match result {
            Ok(()) => (Outcome::Passed, None),
            Err(error) => match error.downcast_ref::<vm::NotPossible>() {
                Some(why) => (Outcome::Skipped(why.to_string()), None),
                None => (Outcome::Failed, Some(error)),
            },
        };
        done.push(Done { name: step.name, time, outcome });
        if let Some(error) = error {
            print!("{}", summary(&done));
            return Err(
                error.context(format!("`{}` failed; to repeat it: cargo xtask ci --only {}", step.name, step.name))
            );
        }
    }
    print!("{}", summary(&done));
    Ok(())
}

/// The table of the checks that ran, and what was not checked.
fn summary(done: &[Done]) -> String {
    let mut table = String::from("\ncheck        time, s  result\n");
    let mut skipped = String::new();
    for Done { name, time, outcome } in done {
        let result = match outcome {
            Outcome::Passed => "ok",
            Outcome::Failed => "FAILED",
            Outcome::Skipped(why) => {
                skipped.push_str(&format!("\nNOT CHECKED on this machine: {name}, as {why}\n"));
                "SKIPPED"
            }
        };
        table.push_str(&format!("{name:<13} {:>6.1}  {result}\n", time.as_secs_f64()));
    }
    table + &skipped
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

/// The feature that lets tests switch safeguards off.
const SWITCHES: &str = "disabled-guards";

/// Each safeguard, switched off in a test build, has to be missed; and no program for real arms comes of such a build.
fn safeguards(workspace: &Workspace) -> anyhow::Result<()> {
    let mut tests = workspace.cargo();
    tests.args(["test", "--locked", "--package", "pb3dp-safeguards", "--package", "system-tests", "--lib"]);
    run_visibly(tests.args(["--example", "safety", "--features", SWITCHES]))?;
    let mut program = workspace.cargo();
    program.args(["build", "--locked", "--package", "pb3dp-orchestrator", "--bin", "pb3dp"]);
    let built =
        program.args(["--features", "pb3dp-safeguards/disabled-guards"]).output().context("cannot run cargo")?;
    let said = String::from_utf8_lossy(&built.stderr);
    if built.status.success() || !said.contains("pb3dp is not built with the feature disabled-guards") {
        bail!("pb3dp was built with the feature {SWITCHES}, or failed for another reason:\n{said}");
    }
    Ok(())
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
        let step = |name, millis, outcome| Done { name, time: Duration::from_millis(millis), outcome };
        let why = "qemu is missing".to_owned();
        let done = [
            step("fmt", 1500, Outcome::Passed),
            step("vm", 200, Outcome::Skipped(why)),
            step("clippy", 61_000, Outcome::Failed),
        ];
        let expected = "\ncheck        time, s  result\nfmt              1.5  ok\nvm               0.2  SKIPPED\n\
                        clippy          61.0  FAILED\n\nNOT CHECKED on this machine: vm, as qemu is missing\n";
        assert_eq!(summary(&done), expected);
        assert!(!summary(&done[..1]).contains("FAILED"));
    }
}
