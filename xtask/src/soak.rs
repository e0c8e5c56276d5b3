//! `cargo xtask soak`: two emulated arms over pseudo-terminals for minutes, with faults at random.

use crate::bench::origin;
use crate::workspace::{Workspace, run_visibly};

const PAGE: &str = "docs/benchmarks/arm.md";

/// Moves two emulated arms over pseudo-terminals, lets them fail at random, and counts what becomes of it.
///
/// Both arms are those of configs/hil.toml with all that stands before a real arm; one reply of each controller in a hundred is
/// lost all the time. Ten minutes take every kind of fault some eight times. It fails if a fault is not noticed, an arm comes to
/// rest too late, or one stops without a reason.
/// With --page both runs are made, with faults and with losses only, and the tables go to docs/benchmarks/arm.md, with commit and
/// machine; commit first, and leave the machine alone.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// How long.
    #[arg(long, default_value_t = 10.0)]
    minutes: f64,
    /// No faults but the lost replies: the arms move all the time, and nothing may stop them.
    #[arg(long, conflicts_with = "page")]
    losses_only: bool,
    /// Of faults and losses.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Also write the page of the documentation.
    #[arg(long)]
    page: bool,
}

/// # Errors
/// If a number is out of range, the program does not build, or something went unnoticed.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let (minutes, seed) = (args.minutes.to_string(), args.seed.to_string());
    let mut command = workspace.cargo();
    command.args(["run", "--release", "--locked", "--package", "system-tests", "--example", "soak", "--"]);
    command.args(["--minutes", &minutes, "--seed", &seed]);
    if args.losses_only {
        command.args(["--what", "losses"]);
    }
    if args.page {
        command.args(["--page", PAGE, "--origin", &origin(workspace)]);
    }
    run_visibly(&mut command)
}
