//! `pb3dp panel`: the operator's page on recorded images or bare cameras, without arms.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use clap::{ArgGroup, Args};
use pb3dp_cell::follower::Follower;
use pb3dp_cell::images_only::ImagesOnly;
use pb3dp_estimation::estimator::{EstimatorConfig, Method, Tracker};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_panel::{About, Panel, PanelAddress, PanelConfig};
use pb3dp_record::dataset::load_sequence;
use pb3dp_wiring::{open_cameras, wire_endless_replay};

use crate::arguments::{ZRange, parse_z_range};
use crate::commands::cameras::choice::CameraChoice;
use crate::commands::cameras::stop_requested;
use crate::logging::show_in_panel;
use crate::panel_access::{PANEL_ADDRESS, PanelAccess, announce, parse_address};

/// Search range of bare cameras, millimetres and degrees.
const RANGE_MM: ZRange = ZRange { min_mm: 300.0, max_mm: 1500.0 };
const TILT_MAX_DEG: f64 = 60.0;

/// Arguments of `pb3dp panel`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true).args(["sequence", "cameras"])))]
pub struct PanelArgs {
    /// A folder with a recorded sequence (docs/dataset-format.md); it is repeated at its own pace, and pairs that this computer is too slow for are left out.
    #[arg(long, value_name = "DIR")]
    sequence: Option<PathBuf>,
    /// Two real cameras: with --config FILE, or with --left, --right and --calib.
    #[arg(long)]
    cameras: bool,
    #[command(flatten)]
    choice: CameraChoice,
    /// Depths to search, millimetres; default: those of the sequence or of the setup, else 300,1500.
    #[arg(long, value_name = "MIN,MAX", value_parser = parse_z_range, allow_hyphen_values = true)]
    z_range: Option<ZRange>,
    /// Address of the page on this computer; port 0 takes any free one.
    #[arg(long, value_name = "ADDRESS", default_value = PANEL_ADDRESS, value_parser = parse_address)]
    address: PanelAddress,
    #[command(flatten)]
    access: PanelAccess,
}

/// The images, and what is known about them.
struct Source {
    camera: Box<dyn StereoCamera>,
    name: String,
    rig: StereoRig,
    range: SearchRange,
}

/// Serves the page until a signal ends the command.
///
/// # Errors
/// Images that cannot be used, or an address that is in use.
pub fn run(args: &PanelArgs) -> Result<ExitCode> {
    // Before any other thread starts.
    let mut signals = StopSignals::take_over().context("signals cannot be taken over")?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut source = match &args.sequence {
        Some(folder) => recorded(folder, &clock)?,
        None => cameras(&args.choice, &clock)?,
    };
    if let Some(ZRange { min_mm, max_mm }) = args.z_range {
        (source.range.z_min_m, source.range.z_max_m) = (min_mm * 1e-3, max_mm * 1e-3);
    }
    let about = About::of_cameras(source.rig, &source.name, env!("CARGO_PKG_VERSION"), source.range);
    let config = PanelConfig { log_lines: show_in_panel(Arc::clone(&clock)), ..args.access.config(args.address)? };
    let tracker = Tracker::new(Method::Direct, &source.rig, &EstimatorConfig::default())?;
    let (panel, _, spectator) = Panel::start(config, Arc::clone(&clock), about)?;
    announce(&panel, "shows the images: mark a target with the mouse; Ctrl-C ends it")?;
    let images = ImagesOnly {
        follower: Follower::new(tracker, source.range),
        selections: panel.selections(),
        spectator: Box::new(spectator),
        clock,
    };
    images.run(&mut *source.camera, &mut || stop_requested(&mut signals, "the page closes"))?;
    Ok(ExitCode::SUCCESS)
}

fn recorded(folder: &Path, clock: &Arc<dyn Clock>) -> Result<Source> {
    let sequence = load_sequence(folder).with_context(|| {
        format!("--sequence {}: a folder as docs/dataset-format.md describes is needed", folder.display())
    })?;
    let (camera, calibration) = wire_endless_replay(&sequence, Arc::clone(clock))?;
    for note in &calibration.notes {
        tracing::info!("{note}");
    }
    let pb3dp_record::dataset::SearchRange { z_min_m, z_max_m, tilt_max_rad } = sequence.search;
    let range = SearchRange { z_min_m, z_max_m, tilt_max_rad };
    Ok(Source { camera, name: folder.display().to_string(), rig: calibration.rig, range })
}

fn cameras(choice: &CameraChoice, clock: &Arc<dyn Clock>) -> Result<Source> {
    let chosen = choice.chosen()?;
    let Some(rig) = chosen.rig else {
        bail!(
            "--cameras: poses need a calibration; give --calib FILE, or --config with a calibrated setup (`pb3dp cameras view` shows bare images)"
        );
    };
    let camera = open_cameras(&chosen.config, Arc::clone(clock)).context("the cameras cannot be used")?;
    let of_default = SearchRange {
        z_min_m: RANGE_MM.min_mm * 1e-3,
        z_max_m: RANGE_MM.max_mm * 1e-3,
        tilt_max_rad: TILT_MAX_DEG.to_radians(),
    };
    let name = camera.info().name.clone();
    Ok(Source { camera, name, rig, range: chosen.target.range.unwrap_or(of_default) })
}
