//! `pb3dp report`: the page and the tables of a recorded run.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_cell::report::{self, Made};
use pb3dp_cell::terminal::print_line;
use pb3dp_record::parquet_table::write_parquet;
use pb3dp_recording::replay::{Estimates, Opened, ReplayOptions};

use crate::commands::result_folder::ResultFolder;

/// Arguments of `pb3dp report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// The recording of a run.
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// Folder of the results.
    #[arg(long, value_name = "FOLDER", default_value = "out/report")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A file that is no recording of a run, or results that cannot be written.
pub fn run(args: &ReportArgs) -> Result<ExitCode> {
    let options = ReplayOptions { set: Vec::new(), estimates: Estimates::RecordedWithImages };
    let mut opened = Opened::new(&args.file, &options)?;
    let _results = ResultFolder::take(&args.out)?;
    let replayed = opened.replay(None, true)?;
    let outcome = replayed.outcome.context("the replay kept no record: this is a bug, please report it")?;
    let failure = match (&replayed.end, replayed.begins_s) {
        // The newest seconds at a fault end with it.
        (None, None) => Some("the recording was broken off".to_owned()),
        (None, Some(_)) => None,
        (Some(end), _) => end.failure.clone(),
    };
    if let Some(begins_s) = replayed.begins_s {
        print_line(&format!(
            "the recording begins {begins_s:.1} s after the begin of its run; its control is shown as recorded"
        ))?;
    }
    let made = Made {
        configuration: format!("recording {}, by {}", args.file.display(), replayed.version),
        commit: crate::COMMIT,
        wall_s: replayed.duration_s,
    };
    let following =
        report::write_report_of_recording(&args.out, &opened.setup, &made, (&outcome, failure), print_line)?;
    write_parquet_tables(&args.out)?;
    if !replayed.is_led_by_person {
        following.warn();
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the tables of the report as Parquet files, too.
fn write_parquet_tables(folder: &Path) -> Result<()> {
    for name in ["estimates", "timeseries"] {
        let csv = folder.join(name).with_extension("csv");
        let text = std::fs::read_to_string(&csv).with_context(|| format!("{} cannot be read", csv.display()))?;
        write_parquet(&folder.join(name).with_extension("parquet"), &text)?;
    }
    Ok(())
}
