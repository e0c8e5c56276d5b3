//! `cargo xtask demo`: the simulated experiment, from source to report.

use std::time::Instant;

use anyhow::bail;

use crate::workspace::{PROGRAM, Workspace, run_visibly};

const CONFIG: &str = "configs/sim.toml";
const OUT: &str = "out/demo";

/// Builds the program and runs the experiment in simulation: a hand with two cameras follows an unknown object.
///
/// The first build takes some minutes; the program shows its progress while it runs. Afterwards out/demo/report.html contains
/// the plots and images in one file for any browser. configs/sim.toml defines the experiment: copy that file, change it, and
/// pass it with --config.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// The setup to run.
    #[arg(long, default_value = CONFIG)]
    config: String,
    /// Folder of the report.
    #[arg(long, default_value = OUT)]
    out: String,
}

/// # Errors
/// If the program does not build, the run fails, or the report is missing.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    println!("Building pb3dp with optimisation (3 to 7 minutes the first time).");
    let start = Instant::now();
    let program = workspace.build(true, &PROGRAM)?.join("pb3dp");
    println!("Built in {:.0} s. Now the experiment.", start.elapsed().as_secs_f64());

    let start = Instant::now();
    run_visibly(workspace.command(program).args(["run", "--config", &args.config, "--out", &args.out]))?;

    let report = workspace.root().join(&args.out).join("report.html");
    if !report.is_file() {
        bail!("the run ended without an error, but {} is missing", report.display());
    }
    println!("Ran in {:.0} s. Open the report in a browser: {}", start.elapsed().as_secs_f64(), report.display());
    println!("Next, push a target about with the mouse: target/release/pb3dp run --config playground --panel");
    Ok(())
}
