//! `pb3dp cameras view`: live camera images on a web page of this computer.

mod answers;
mod server;
mod show;
#[cfg(test)]
mod tests;

use std::net::{IpAddr, SocketAddr};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_camera_v4l2::V4l2StereoCamera;
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_platform::signals::StopSignals;
use tokio::sync::watch;

use self::server::{Server, Sources};
use self::show::{ASKS_MAX, Show, State};
use super::choice::CameraChoice;
use super::stop_requested;

/// Arguments of `pb3dp cameras view`.
#[derive(Debug, Args)]
pub(super) struct ViewArgs {
    #[command(flatten)]
    cameras: CameraChoice,
    /// Port of the page; 0 for any free port.
    #[arg(long, value_name = "PORT", default_value_t = 8040)]
    port: u16,
    /// Address of the page on this computer. Any address other than 127.0.0.1 lets everybody on that network see and change the
    /// cameras.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    bind: IpAddr,
}

/// Runs until a signal ends the command.
///
/// # Errors
/// If the cameras cannot be used, or the port is in use.
pub(super) fn run(system: Arc<dyn VideoSystem>, clock: Arc<dyn Clock>, args: &ViewArgs) -> Result<ExitCode> {
    // Before any other thread starts.
    let mut signals = StopSignals::take_over().context("signals cannot be taken over")?;
    let mut is_over = || stop_requested(&mut signals, "the page closes");
    let config = args.cameras.cameras()?;
    let mut open = || V4l2StereoCamera::open(Arc::clone(&system), Arc::clone(&clock), &config);
    let camera = open().context("the cameras cannot be used")?;
    let (state, states) = watch::channel(Arc::new(State::new(camera.info())));
    let (images, newest) = watch::channel(None);
    let (ask, asks) = sync_channel(ASKS_MAX);
    let sources = Sources { states, images: newest, ask };
    // Dropping the server closes the page.
    let server = Server::start(SocketAddr::new(args.bind, args.port), sources)?;
    if !args.bind.is_loopback() {
        tracing::warn!(
            "the page is offered at {}: who reaches this computer there can see and change the cameras",
            args.bind
        );
    }
    print_line(&format!("http://{}/ shows the cameras; Ctrl-C ends it", server.address()))?;
    Show { clock: clock.as_ref(), state, images, asks }.run(camera, &mut open, &mut is_over)?;
    Ok(ExitCode::SUCCESS)
}
