//! `cargo xtask hil`: the experiment through serial lines to emulated arms, beside the same one in simulated time.

use anyhow::bail;

use crate::bench::origin;
use crate::workspace::{Workspace, run_visibly};

const PAGE: &str = "docs/benchmarks/hil.md";

/// Runs the experiment of configs/hil.toml in simulated time, in the machine's time, and through serial lines to emulated arms.
///
/// It prints how well the hand followed and how punctual the cycles were, and fails if the hand is off by more than 1.2 times
/// what it is in simulated time. Three minutes. With --page the tables go to docs/benchmarks/hil.md, with commit and machine;
/// commit first, and leave the machine alone.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// End each run after this many seconds of the experiment.
    #[arg(long, value_name = "SECONDS")]
    stop_after: Option<f64>,
    /// Also write the page of the documentation.
    #[arg(long)]
    page: bool,
}

/// # Errors
/// If a number is out of range, the program does not build, or the hand follows worse through the lines.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.args(["run", "--release", "--locked", "--package", "system-tests", "--example", "hil", "--"]);
    if let Some(seconds) = args.stop_after {
        if !(seconds > 0.0 && seconds <= 3600.0) {
            bail!("--stop-after {seconds}: give more than 0 and at most 3600");
        }
        command.args(["--stop-after", &seconds.to_string()]);
    }
    if args.page {
        command.args(["--page", PAGE, "--origin", &origin(workspace)]);
    }
    run_visibly(&mut command)
}
