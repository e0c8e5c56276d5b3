//! `pb3dp recover`: a whole MCAP file from a recording that was broken off.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
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
    if args.file.is_dir() {
        bail!("{}: this is a folder; name one of its files", args.file.display());
    }
    let out = args.out.clone().unwrap_or_else(|| args.file.with_extension("recovered.mcap"));
    let recovered = recover(&args.file, &out).context("recover")?;
    let state = match (&recovered.damage, recovered.was_unfinished) {
        (Some(why), _) => format!("damaged: {why}; what followed is lost"),
        (None, true) => "broken off".to_owned(),
        (None, false) => "whole already".to_owned(),
    };
    print_line(&format!(
        "{}: {} messages over {:.1} s; the recording was {state}",
        out.display(),
        recovered.messages,
        recovered.duration_nanos as f64 * 1e-9
    ))?;
    Ok(if recovered.damage.is_some() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
