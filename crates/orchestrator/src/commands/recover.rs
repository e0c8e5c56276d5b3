//! `pb3dp recover`: a whole MCAP file from a recording that was broken off.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_bag::recover::recover;
use pb3dp_cell::terminal::print_line;

/// Arguments of `pb3dp recover`.
#[derive(Debug, Args)]
pub struct RecoverArgs {
    /// The recording; it stays as it is.
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// The whole file; FILE.recovered.mcap beside the recording by default.
    #[arg(long, value_name = "FILE.mcap")]
    out: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// A file that is no recording, or a new file that exists or cannot be written.
pub fn run(args: &RecoverArgs) -> Result<ExitCode> {
    let out = args.out.clone().unwrap_or_else(|| args.file.with_extension("recovered.mcap"));
    let recovered = recover(&args.file, &out).context("recover")?;
    let state = if recovered.was_unfinished { "broken off" } else { "whole already" };
    print_line(&format!(
        "{}: {} messages over {:.1} s; the recording was {state}",
        out.display(),
        recovered.messages,
        recovered.duration_nanos as f64 * 1e-9
    ))?;
    Ok(ExitCode::SUCCESS)
}
