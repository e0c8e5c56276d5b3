//! `cargo xtask hil`: the experiment through serial lines to emulated arms, compared with simulated time.

use anyhow::bail;

use crate::bench::origin;
use crate::workspace::{Workspace, run_visibly};

const PAGE: &str = "docs/benchmarks/hil.md";

/// Runs the experiment of configs/hil.toml in simulated time, in real time, and through serial lines and TCP to emulated arms.
///
/// Prints the tracking error of the hand and the timing of the cycles, and fails if the error behind gateways is more than 1.2 times
/// that in simulated time. Takes four minutes. With --page the tables go to docs/benchmarks/hil.md, with commit and machine;
/// commit first, and keep the machine idle.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// End each run after this many seconds of the experiment.
    #[arg(long, value_name = "SECONDS")]
    stop_after: Option<f64>,
    /// Also write the documentation page.
    #[arg(long)]
    page: bool,
}

/// # Errors
/// If a number is out of range, the program does not build, or the error through serial lines is too large.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let mut command = workspace.example("system-tests", "hil");
    if let Some(seconds) = args.stop_after {
        if !(seconds > 0.0 && seconds <= 3600.0) {
            bail!("--stop-after {seconds} is out of range: give more than 0 and at most 3600");
        }
        command.args(["--stop-after", &seconds.to_string()]);
    }
    if args.page {
        command.args(["--page", PAGE, "--origin", &origin(workspace)]);
    }
    run_visibly(&mut command)
}
