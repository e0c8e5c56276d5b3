//! `pb3dp cameras`: checks of the cameras of a rig before anything moves (docs/rig.md).

mod check;
pub(super) mod choice;
#[cfg(test)]
pub(super) mod emulated_rig;
mod list;
mod record;

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;

/// Arguments of `pb3dp cameras`.
#[derive(Debug, Args)]
pub struct CamerasArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// List the cameras of this computer: names, formats, sizes, rates and controls.
    List(list::ListArgs),
    /// Moved: `pb3dp panel --cameras`.
    #[command(hide = true, disable_help_flag = true)]
    View {
        /// Not read.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        options: Vec<OsString>,
    },
    /// Record pairs as a sequence folder for `pb3dp track`, at the full rate of the cameras.
    Record(Box<record::RecordArgs>),
    /// Measure rate, jitter, skew, losses, exposure, sharpness and vertical alignment, each against a limit.
    Check(Box<check::CheckArgs>),
}

/// Runs the command.
///
/// # Errors
/// If there is no camera, or standard output cannot be written.
pub fn run(args: &CamerasArgs) -> Result<ExitCode> {
    match &args.what {
        What::List(args) => list::run(&Linux, args),
        What::Check(args) => check::run(Arc::new(Linux), Arc::new(SystemClock::new()), args),
        What::View { .. } => bail!(
            "the page of `cameras view` is part of the operator panel now: use `pb3dp panel --cameras` with the same --left, --right, --calib \
             or --config, and --address in place of --port and --bind"
        ),
        What::Record(args) => record::run(Arc::new(Linux), Arc::new(SystemClock::new()), args),
    }
}

/// Whether a signal requests the end; logs what follows.
pub(super) fn stop_requested(signals: &mut StopSignals, follows: &str) -> bool {
    match signals.try_take() {
        Ok(Some(signal)) => {
            tracing::info!("{signal}: {follows}");
            true
        }
        _ => false,
    }
}
