//! `cargo xtask soak`: two emulated arms on pseudo-terminals for minutes, with random faults.

use crate::bench::origin;
use crate::workspace::{PROGRAM, Workspace, run_visibly};

const PAGE: &str = "docs/benchmarks/arm.md";

/// Moves two emulated arms on pseudo-terminals, injects random faults, and counts the reactions.
///
/// Both arms are those of configs/hil.toml with the full software chain of a real arm; one of a hundred replies of each controller is
/// lost throughout. Ten minutes include every kind of fault about eight times. Fails if a fault is not detected, an arm is
/// stationary too late, or an arm stops without a reason.
/// With --page both runs are made, with faults and with losses only, and the tables go to docs/benchmarks/arm.md, with commit and
/// machine; commit first, and keep the machine idle.
///
/// With --kills N live runs are made instead: `pb3dp run` and two `pb3dp gateway` as processes, and one of the three is killed by
/// SIGKILL while both arms move. Fails if an arm is stationary later than 0.5 s after it, a joint moves by more than 10 degrees, or
/// a program that is started anew moves an arm. 50 take eight minutes.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Duration, minutes.
    #[arg(long, default_value_t = 10.0)]
    minutes: f64,
    /// Only lost replies, no other faults: the arms move throughout, and no loss may stop them.
    #[arg(long, conflicts_with = "page")]
    losses_only: bool,
    /// Seed of faults and losses.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Also write the documentation page.
    #[arg(long)]
    page: bool,
    /// Instead: so many live runs in which a process is killed.
    #[arg(long, value_name = "N", conflicts_with_all = ["minutes", "losses_only", "page"])]
    kills: Option<u32>,
}

/// # Errors
/// If a number is out of range, the program does not build, or a fault is not detected.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let (minutes, seed) = (args.minutes.to_string(), args.seed.to_string());
    if let Some(runs) = args.kills {
        return kills(workspace, runs, &seed);
    }
    let mut command = workspace.example("system-tests", "soak");
    command.args(["--minutes", &minutes, "--seed", &seed]);
    if args.losses_only {
        command.args(["--what", "losses"]);
    }
    if args.page {
        command.args(["--page", PAGE, "--origin", &origin(workspace)]);
    }
    run_visibly(&mut command)
}

/// Builds the program and runs the example `kills` with it.
fn kills(workspace: &Workspace, runs: u32, seed: &str) -> anyhow::Result<()> {
    let program = workspace.build(true, &PROGRAM)?.join("pb3dp");
    let mut command = workspace.example("system-tests", "kills");
    command.args(["--runs", &runs.to_string(), "--seed", seed, "--program"]).arg(program);
    run_visibly(&mut command)
}
