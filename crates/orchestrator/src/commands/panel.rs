//! `pb3dp panel`: the operator's page on recorded images or bare cameras, without arms.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result};
use clap::{ArgGroup, Args};
use nalgebra::Vector3;
use pb3dp_cell::calibration_facts::CalibrationFacts;
use pb3dp_cell::calibration_share::term_or_warning;
use pb3dp_cell::camera_controls::ControlDesk;
use pb3dp_cell::follower::Follower;
use pb3dp_cell::images_only::ImagesOnly;
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_estimation::estimator::{EstimatorConfig, Method, Tracker};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_panel::{About, Panel, PanelAddress, PanelConfig};
use pb3dp_wiring::{Recording, RecordingOptions};
use pb3dp_wiring::{open_cameras, video_system, wire_endless_replay};

use crate::arguments::{ZRange, parse_z_range};
use crate::commands::cameras::choice::{CameraChoice, Chosen};
use crate::commands::cameras::stop_requested;
use crate::logging::show_in_panel;
use crate::panel_access::{PANEL_ADDRESS, PanelAccess, announce, parse_address};

/// Search range of bare cameras, millimetres and degrees.
const RANGE_MM: ZRange = ZRange { min_mm: 300.0, max_mm: 1500.0 };
const TILT_MAX_DEG: f64 = 60.0;

/// Arguments of `pb3dp panel`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true).args(["file", "sequence", "cameras"])))]
pub struct PanelArgs {
    /// The recording; the same as --sequence.
    #[arg(value_name = "PATH")]
    file: Option<PathBuf>,
    /// A recording as for `pb3dp track`; it is repeated at its own pace, and pairs that this computer is too slow for are left out.
    #[arg(long, value_name = "PATH")]
    sequence: Option<PathBuf>,
    #[command(flatten)]
    recording: RecordingOptions,
    /// Two real cameras: with --config FILE, or with --left, --right and --calib. Without a calibration the page shows images and
    /// controls, and no target can be chosen.
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
    /// The calibration; `None` without one.
    rig: Option<StereoRig>,
    calibration: Option<CalibrationFacts>,
    /// Its errors, if they are known.
    calibration_term: Option<CalibrationTerm>,
    /// Controls of real cameras.
    controls: Option<ControlDesk>,
    range: SearchRange,
    /// Whether the time between the exposures of a pair is known.
    states_skew: bool,
}

/// Serves the page until a signal ends the command.
///
/// # Errors
/// Images that cannot be used, or an address that is in use.
pub fn run(args: &PanelArgs) -> Result<ExitCode> {
    // Before any other thread starts.
    let mut signals = StopSignals::take_over().context("signals cannot be taken over")?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut source = match args.file.as_ref().or(args.sequence.as_ref()) {
        Some(path) => recorded((path, &args.choice.calib), &args.recording, &clock)?,
        None => cameras((&args.choice, &args.recording), &clock)?,
    };
    if let Some(ZRange { min_mm, max_mm }) = args.z_range {
        (source.range.z_min_m, source.range.z_max_m) = (min_mm * 1e-3, max_mm * 1e-3);
    }
    let config = PanelConfig { log_lines: show_in_panel(Arc::clone(&clock)), ..args.access.config(args.address)? };
    let mut opened = |panel: &Panel| announce(panel, "shows the images: mark a target with the mouse; Ctrl-C ends it");
    serve(source, (config, clock), &mut opened, &mut || stop_requested(&mut signals, "the page closes"))?;
    Ok(ExitCode::SUCCESS)
}

/// Serves the page until `is_over` returns true; calls `opened` once it can be reached.
fn serve(
    source: Source,
    (config, clock): (PanelConfig, Arc<dyn Clock>),
    opened: &mut dyn FnMut(&Panel) -> Result<()>,
    is_over: &mut dyn FnMut() -> bool,
) -> Result<()> {
    let Source { mut camera, name, rig, calibration, calibration_term, controls, range, states_skew } = source;
    let stereo = match rig {
        Some(rig) => rig,
        None => stand_in(camera.info().size)?,
    };
    let about = About {
        is_calibrated: rig.is_some(),
        calibration: match (&calibration, rig) {
            (Some(facts), _) => facts.source.clone(),
            (None, Some(_)) => "that of the recording".to_owned(),
            (None, None) => "none: images and controls only".to_owned(),
        },
        calibrations: calibration.into_iter().collect(),
        calibration_term: calibration_term.clone(),
        ..About::of_cameras(stereo, &name, env!("CARGO_PKG_VERSION"), range)
    };
    let tracker = Tracker::new(Method::Direct, &stereo, &EstimatorConfig::default())?;
    let tracker = tracker.with_calibration(calibration_term);
    let config = PanelConfig { cameras: controls, ..config };
    let (panel, _, spectator) = Panel::start(config, Arc::clone(&clock), about)?;
    opened(&panel)?;
    let mut follower = Follower::new(tracker, range);
    follower.watch_skew(!states_skew)?;
    let images = ImagesOnly { follower, selections: panel.selections(), spectator: Box::new(spectator), clock };
    images.run(&mut *camera, is_over)
}

fn recorded(
    (path, calibration): (&Path, &[PathBuf]),
    asked: &RecordingOptions,
    clock: &Arc<dyn Clock>,
) -> Result<Source> {
    let Recording { camera, search, notes, warnings, states_skew, .. } =
        wire_endless_replay(path, calibration, asked, Arc::clone(clock)).context("--sequence")?;
    let calibration = camera.calibration().clone();
    for note in notes.iter().chain(&calibration.notes) {
        tracing::info!("{note}");
    }
    for warning in &warnings {
        tracing::warn!("{warning}");
    }
    let of_recording = |search: pb3dp_record::dataset::SearchRange| SearchRange {
        z_min_m: search.z_min_m,
        z_max_m: search.z_max_m,
        tilt_max_rad: search.tilt_max_rad,
    };
    Ok(Source {
        camera: Box::new(camera),
        name: path.display().to_string(),
        rig: Some(calibration.rig),
        calibration: Some(CalibrationFacts::of("camera", &calibration.source, calibration.judgement.as_ref())),
        calibration_term: term_or_warning(&calibration),
        controls: None,
        range: search.map_or_else(default_range, of_recording),
        states_skew,
    })
}

fn cameras((choice, asked): (&CameraChoice, &RecordingOptions), clock: &Arc<dyn Clock>) -> Result<Source> {
    let chosen = choice.to_show(&asked.calibration.stated())?;
    let opened = open_cameras(&chosen.config, (video_system(), Arc::clone(clock)));
    let (camera, desk) = opened.context("the cameras cannot be used")?;
    if chosen.rig.is_none() {
        tracing::warn!("without a calibration no target can be chosen; --calib FILE, or a setup, states one");
    }
    Ok(of_cameras(chosen, camera, desk))
}

fn of_cameras(chosen: Chosen, camera: Box<dyn StereoCamera>, desk: ControlDesk) -> Source {
    let Chosen { rig, calibration, calibration_term, target, .. } = chosen;
    let (name, range) = (camera.info().name.clone(), target.range.unwrap_or_else(default_range));
    Source { camera, name, rig, calibration, calibration_term, controls: Some(desk), range, states_skew: true }
}

fn default_range() -> SearchRange {
    SearchRange {
        z_min_m: RANGE_MM.min_mm * 1e-3,
        z_max_m: RANGE_MM.max_mm * 1e-3,
        tilt_max_rad: TILT_MAX_DEG.to_radians(),
    }
}

/// Stands in for a calibration where only images are shown: a usual lens, cameras side by side. Nothing is measured with it.
fn stand_in(size: ImageSize) -> Result<StereoRig> {
    let middle = |pixels: u32| (f64::from(pixels) - 1.0) / 2.0;
    let focal_px = f64::from(size.width.max(size.height));
    let pinhole = Pinhole { fx: focal_px, fy: focal_px, cx: middle(size.width), cy: middle(size.height) };
    let camera = Camera::new(size, pinhole, Distortion::None)?;
    Ok(StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0)))?)
}

#[cfg(test)]
mod tests;
