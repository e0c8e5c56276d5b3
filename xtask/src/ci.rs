//! `cargo xtask ci`: all checks before a change is merged.

mod changes;
mod space;
mod steps;

use std::time::{Duration, Instant};

use crate::not_possible::NotPossible;
use crate::workspace::Workspace;
use changes::Changes;
use steps::{Progress, STEPS, Step};

/// Runs all checks, the fastest first, and stops at the first failure.
///
/// Free disk space, fmt, tidy, check-deps, licences, advisories, clippy, rustdoc, tests; then, if the change touches what they check: calibration of
/// a bare rig by the commands of its documentation, a quick run of the accuracy benchmark, drivers in emulated computers, the
/// fuzz targets, Miri, the oldest compiler. The change is the difference from the merge base with the main branch (or from the
/// commit in PB3DP_CI_BASE), with all packages that depend on it, and the tests that use these; without a known base all checks
/// run. Tests of other packages do not run. At the end the command prints what it left out.
///
/// Warnings of clippy and rustdoc are errors. Needs the rustup components rustfmt and clippy (the error message gives the command
/// to install them), and otherwise only rustc, cargo and cc. Steps with further needs (QEMU and a kernel, a nightly compiler)
/// install them if permitted, and are skipped otherwise.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Run this check only, even if the change does not touch it.
    #[arg(long, value_parser = STEPS.map(|step| step.name))]
    only: Option<String>,
    /// Run all checks, even if the change does not touch them.
    #[arg(long)]
    all: bool,
    /// Also print the 20 slowest test programs by run time.
    #[arg(long)]
    timings: bool,
}

/// Result of a step.
enum Outcome {
    Passed,
    /// Built; it runs beside the later steps, and a later line has its result.
    Started,
    Failed,
    /// This machine lacks a requirement.
    Skipped(String),
    /// The change does not touch what the step checks.
    LeftOut,
}

/// A step with its result.
struct Done {
    name: &'static str,
    time: Duration,
    outcome: Outcome,
}

/// # Errors
/// If a check fails.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let changes = match args.all || args.only.is_some() {
        true => Changes::Everything("--all or --only is given".to_owned()),
        false => changes::find(workspace)?,
    };
    println!("{}", changes.text());
    let is_alone = args.only.is_some();
    let mut progress = Progress { workspace, changes, is_alone, tested: None, ahead: None, beside: None };
    let mut done = Vec::new();
    let mut failure = None;
    for step in STEPS.iter().filter(|step| args.only.as_deref().is_none_or(|only| only == step.name)) {
        let (ended, error) = take(step, &mut progress);
        done.push(ended);
        if let Some(error) = error {
            failure = Some(error);
            break;
        }
    }
    if failure.is_none()
        && let Some(beside) = progress.beside.take()
    {
        let name = beside.name;
        let (time, result) = beside.end();
        let (outcome, error) = judged(name, result);
        done.push(Done { name, time, outcome });
        failure = error;
    }
    if args.timings
        && let Some(tested) = &progress.tested
    {
        print!("{}", tested.report.slowest());
    }
    print!("{}", summary(&done, &progress));
    if let Some(tested) = &progress.tested {
        tested.report.tell();
    }
    failure.map_or(Ok(()), Err)
}

fn take(step: &Step, progress: &mut Progress<'_>) -> (Done, Option<anyhow::Error>) {
    if !step.due.after(&progress.changes) {
        return (Done { name: step.name, time: Duration::ZERO, outcome: Outcome::LeftOut }, None);
    }
    println!("== {}", step.name);
    let start = Instant::now();
    let result = (step.run)(progress);
    let (outcome, error) = match result {
        Ok(()) if progress.beside.as_ref().is_some_and(|beside| beside.name == step.name) => (Outcome::Started, None),
        result => judged(step.name, result),
    };
    (Done { name: step.name, time: start.elapsed(), outcome }, error)
}

/// Outcome of a check, and its failure.
fn judged(name: &'static str, result: anyhow::Result<()>) -> (Outcome, Option<anyhow::Error>) {
    match result {
        Ok(()) => (Outcome::Passed, None),
        Err(error) => match error.downcast_ref::<NotPossible>() {
            Some(why) => (Outcome::Skipped(why.to_string()), None),
            None => {
                let repeat = format!("`{name}` failed; repeat it by: cargo xtask ci --only {name}");
                (Outcome::Failed, Some(error.context(repeat)))
            }
        },
    }
}

/// The table of the checks, and the checks that did not run.
fn summary(done: &[Done], progress: &Progress<'_>) -> String {
    let mut text = table(done);
    if let Changes::Packages { .. } = progress.changes {
        text.push_str(&format!("\nleft out: tests of packages that are not touched; {}\n", progress.changes.text()));
    }
    text
}

fn table(done: &[Done]) -> String {
    let mut table = String::from("\ncheck        time, s  result\n");
    let mut skipped = String::new();
    for Done { name, time, outcome } in done {
        let result = match outcome {
            Outcome::Passed => "ok",
            Outcome::Started => "built; its run is below",
            Outcome::Failed => "FAILED",
            Outcome::LeftOut => "left out: not touched",
            Outcome::Skipped(why) => {
                skipped.push_str(&format!("\nNOT CHECKED: {name}: {why}\n"));
                "SKIPPED"
            }
        };
        table.push_str(&format!("{name:<13} {:>6.1}  {result}\n", time.as_secs_f64()));
    }
    table.push_str(&format!("all           {:>6.1}\n", done.iter().map(|done| done.time.as_secs_f64()).sum::<f64>()));
    table + &skipped
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
            step("miri", 0, Outcome::LeftOut),
            step("clippy", 61_000, Outcome::Failed),
        ];
        let expected = "\ncheck        time, s  result\nfmt              1.5  ok\nvm               0.2  SKIPPED\n\
                        miri             0.0  left out: not touched\nclippy          61.0  FAILED\nall             62.7\n\n\
                        NOT CHECKED: vm: qemu is missing\n";
        assert_eq!(table(&done), expected);
        assert!(!table(&done[..1]).contains("FAILED"));
    }
}
