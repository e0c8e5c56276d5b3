//! `pb3dp cameras`: checks of the cameras of a rig before anything moves (docs/rig.md).

mod check;
pub(super) mod choice;
#[cfg(test)]
mod emulated_rig;
mod list;
mod record;
mod view;

use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Result;
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
    /// Show both images, rate, skew, losses and controls on a live web page of this computer, where the controls can be changed.
    View(Box<view::ViewArgs>),
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
        What::View(args) => view::run(Arc::new(Linux), Arc::new(SystemClock::new()), args),
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
