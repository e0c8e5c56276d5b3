//! `pb3dp cameras record`: records camera pairs as a file or a sequence folder, at their full rate.

mod file;
mod recorder;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use pb3dp_camera_settings::SkewCost;
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_camera_v4l2::{Side, StereoCounters, V4l2StereoCamera};
use pb3dp_cell::terminal::{parse_seconds, print_line};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraError, Clock, FollowedTarget, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_record::calibration_files::{CAMERAS_FILE, CameraIdentity, save_cameras};
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter};
use pb3dp_record::images::StoredFormat;
use pb3dp_recording::pairs::is_file;
use pb3dp_setup::region_spec::RegionSpec;
use pb3dp_wiring::CalibrationOptions;
use pb3dp_wiring::calibration::identity;
use pb3dp_wiring::camera_controls::log_exposure;
use serde::Serialize;

use self::recorder::{Failure, Missing, Outcome, Plan, record};
use super::choice::{CameraChoice, Chosen, ChosenTarget, check_size};
use super::stop_requested;
use crate::arguments::{ZRange, parse_tilt, parse_z_range};
use crate::commands::doctor::free_bytes;
use crate::commands::output_file::check_recording_name;

/// Meaning of exit code and `--json`.
const RECORD_JSON: &str =
    "Ctrl-C ends the recording in order. Exit code: 0 if every pair was kept, 1 if any is missing or something failed; what was written
before that stays a whole sequence.
Object of --json:
  file             the file, or the sequence.json of the folder; null if nothing was kept
  pairs            pairs that were kept
  seconds          from the first to the last pair
  missing_queue    pairs left out because they could not be written fast enough
  missing_cameras  pairs that the cameras did not deliver, or that were damaged or too far apart
  skew_max_ms      largest time between the two exposures of a pair that was delivered
  skew_refused     pairs whose exposures were farther apart than the limit; they are missing
  skew_cost        the position error of this time, in words: speed and distance of the target, millimetres
  failure          why it ended before its time, or null";

/// Default search range of a recording: depths in metres, and the largest tilt.
const Z_RANGE_M: [f64; 2] = [0.3, 0.8];
const TILT_MAX_DEG: f64 = 60.0;

/// Arguments of `pb3dp cameras record`.
#[derive(Debug, Args)]
#[command(after_long_help = RECORD_JSON)]
pub(super) struct RecordArgs {
    #[command(flatten)]
    cameras: CameraChoice,
    #[command(flatten)]
    calibration: CalibrationOptions,
    /// Where to record: a FILE.mcap, which needs no calibration and no target, or a folder, which becomes a sequence. An earlier recording
    /// is not overwritten.
    #[arg(long, value_name = "FILE.mcap|DIR")]
    out: PathBuf,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds, conflicts_with = "pairs", allow_hyphen_values = true)]
    seconds: Option<f64>,
    /// End after this many pairs.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pairs: Option<u64>,
    /// The target in the left image of the first pair, for `pb3dp track`: rect:X,Y,WIDTH,HEIGHT or poly:X1,Y1;X2,Y2;X3,Y3; default:
    /// that of the setup, or the middle of the image.
    #[arg(long, value_name = "REGION")]
    region: Option<RegionSpec>,
    /// Depths to search, millimetres; default: those of the setup, or 300,800.
    #[arg(long, value_name = "MIN,MAX", value_parser = parse_z_range, allow_hyphen_values = true)]
    z_range: Option<ZRange>,
    /// Largest tilt to search, degrees; default: that of the setup, or 60.
    #[arg(long, value_name = "DEGREES", value_parser = parse_tilt, allow_hyphen_values = true)]
    tilt_max: Option<f64>,
    /// Store images as JPEG with this quality, which is lossy; default: PNG.
    #[arg(long, value_name = "1..100", value_parser = clap::value_parser!(u8).range(1..=100))]
    jpeg: Option<u8>,
    /// Number of pairs that may wait in memory.
    #[arg(long, value_name = "N", default_value_t = 90, value_parser = clap::value_parser!(u16).range(2..=2000))]
    queue: u16,
    /// Threads that compress and write; default: one less than the number of processors.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=64))]
    writers: Option<u8>,
    /// One JSON object on standard output instead of text.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If the cameras or the folder cannot be used.
pub(super) fn run(system: Arc<dyn VideoSystem>, clock: Arc<dyn Clock>, args: &RecordArgs) -> Result<ExitCode> {
    // Before any other thread starts.
    let mut signals = StopSignals::take_over().context("signals cannot be taken over")?;
    let mut is_over = || stop_requested(&mut signals, "the recording ends");
    let line = recorded(system, clock, args, &mut is_over)?;
    print_line(&if args.json { serde_json::to_string(&line)? } else { line.text() })?;
    match line.wrong() {
        None => Ok(ExitCode::SUCCESS),
        Some(wrong) => Err(anyhow!(wrong)),
    }
}

/// Result of a recording in the form of `--json`.
#[derive(Debug, Default, Serialize)]
struct Recorded {
    file: Option<PathBuf>,
    pairs: u64,
    seconds: f64,
    missing_queue: u64,
    missing_cameras: u64,
    skew_max_ms: f64,
    skew_refused: u64,
    skew_cost: String,
    failure: Option<String>,
    #[serde(skip)]
    complaint: Option<String>,
}

/// Opens the cameras and records.
fn recorded(
    system: Arc<dyn VideoSystem>,
    clock: Arc<dyn Clock>,
    args: &RecordArgs,
    is_over: &mut dyn FnMut() -> bool,
) -> Result<Recorded> {
    check_recording_name("--out", &args.out)?;
    let Chosen { config, rig, target, .. } = args.cameras.chosen(&args.calibration.stated())?;
    if is_file(&args.out) {
        file::check_options(args)?;
        let mut camera =
            V4l2StereoCamera::open(system, Arc::clone(&clock), &config).context("the cameras cannot be used")?;
        if let Some(rig) = &rig {
            check_size(rig, camera.info().size)?;
        }
        tracing::info!("{}: recording into {}", camera.info().name, args.out.display());
        let until = file::Until { pairs: args.pairs, time: args.seconds.map(Duration::from_secs_f64) };
        let identities = identities(&mut camera)?;
        let mut camera = LoggedCamera::settled(camera)?;
        let destination = (args.out.as_path(), rig.as_ref(), &identities);
        let recorded = file::record(&mut camera, clock.as_ref(), destination, &until, is_over)?;
        return Ok(recorded.with_skew(&camera.camera.counters(), &config.skew_cost));
    }
    let Some(rig) = rig else {
        bail!(
            "a sequence needs a calibration: give --calib FILE; for images of which one is to be made, any one of their size will do, \
             as configs/calibration/nominal.json (docs/calibration.md)"
        );
    };
    let plan = Plan {
        pairs_max: args.pairs,
        time_max: args.seconds.map(Duration::from_secs_f64),
        queue: usize::from(args.queue),
        writers: usize::from(args.writers.unwrap_or_else(writers)),
    };
    let draft = draft(args, &target, rig.left().size())?;
    let mut camera =
        V4l2StereoCamera::open(system, Arc::clone(&clock), &config).context("the cameras cannot be used")?;
    check_size(&rig, camera.info().size)?;
    let identities = identities(&mut camera)?;
    let mut camera = LoggedCamera::settled(camera)?;
    let writer = SequenceWriter::create(&args.out, &rig, draft).context("--out")?;
    save_cameras(&identities, &args.out.join(CAMERAS_FILE)).context("--out")?;
    tracing::info!("{}: recording into {}", camera.info().name, args.out.display());
    let outcome =
        record(&mut camera, clock.as_ref(), writer, &plan, &|files, pair| files.save(&pair.left, &pair.right), is_over);
    Ok(Recorded::of(outcome, &args.out).with_skew(&camera.camera.counters(), &config.skew_cost))
}

/// Cameras whose exposure is settled. A recording is for `pb3dp track`, so a shared exposure then changes only slowly; changes are logged.
struct LoggedCamera {
    camera: V4l2StereoCamera,
}

impl LoggedCamera {
    fn settled(mut camera: V4l2StereoCamera) -> Result<Self> {
        camera.settle_exposure().context("the cameras cannot be used")?;
        camera.set_following(FollowedTarget::Confident);
        Ok(Self { camera })
    }
}

impl StereoCamera for LoggedCamera {
    fn info(&self) -> &StereoCameraInfo {
        self.camera.info()
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        let outcome = self.camera.next_pair_into(pair, timeout);
        log_exposure(|| self.camera.take_exposure_event());
        outcome
    }
}

/// A calibration with the recorded images states the cameras that it belongs to.
fn identities(camera: &mut V4l2StereoCamera) -> Result<[CameraIdentity; 2]> {
    let mut of = |side| camera.identity(side).map(identity);
    Ok([of(Side::Left)?, of(Side::Right)?])
}

/// One thread per processor, except the one that captures.
fn writers() -> u8 {
    let processors = std::thread::available_parallelism().map_or(2, usize::from);
    u8::try_from(processors.saturating_sub(1).clamp(1, 8)).unwrap_or(1)
}

/// Description of the sequence: the command line overrides the setup.
fn draft(args: &RecordArgs, target: &ChosenTarget, size: ImageSize) -> Result<SequenceDraft> {
    let [width, height] = [f64::from(size.width), f64::from(size.height)];
    let middle = RegionSpec::Rectangle([0.375 * width, 0.375 * height, 0.25 * width, 0.25 * height]);
    let (key, region) = match (&args.region, &target.region) {
        (Some(region), _) => ("--region", region),
        (None, Some(RegionSpec::Mask(_) | RegionSpec::Click(_))) => {
            tracing::warn!(
                "camera.region: a sequence has a polygon, so it gets the middle of the image; give --region to have another one"
            );
            ("", &middle)
        }
        (None, Some(region)) => ("camera.region", region),
        (None, None) => ("", &middle),
    };
    let region_polygon_left_px = match region {
        RegionSpec::Rectangle([x, y, w, h]) => vec![[*x, *y], [x + w, *y], [x + w, y + h], [*x, y + h]],
        RegionSpec::Polygon(corners) => corners.clone(),
        RegionSpec::Mask(_) | RegionSpec::Click(_) => {
            bail!("{key}: a sequence has a polygon: write rect:X,Y,WIDTH,HEIGHT or poly:X1,Y1;X2,Y2;X3,Y3")
        }
    };
    region.check_inside(size).map_err(|why| anyhow!("{key}: {why}"))?;
    let typed = args.z_range.map(|typed| [typed.min_mm * 1e-3, typed.max_mm * 1e-3]);
    let [z_min_m, z_max_m] = typed.or(target.range.map(|range| [range.z_min_m, range.z_max_m])).unwrap_or(Z_RANGE_M);
    let tilt_max_rad = args.tilt_max.map(f64::to_radians).or(target.range.map(|range| range.tilt_max_rad));
    Ok(SequenceDraft {
        region_polygon_left_px,
        search: SearchRange { z_min_m, z_max_m, tilt_max_rad: tilt_max_rad.unwrap_or(TILT_MAX_DEG.to_radians()) },
        images: args.jpeg.map_or(StoredFormat::Png, |quality| StoredFormat::Jpeg { quality }),
    })
}

impl Recorded {
    fn of(outcome: Outcome, folder: &Path) -> Self {
        let Outcome { summary, seconds, missing: Missing { queue, cameras }, complaint, failure } = outcome;
        let pairs = summary.as_ref().map_or(0, |summary| summary.frames);
        Self {
            file: summary.map(|summary| summary.file),
            pairs,
            seconds,
            missing_queue: queue,
            missing_cameras: cameras,
            failure: failure.map(|failure| failure_text(failure, folder, pairs)),
            complaint,
            ..Self::default()
        }
    }

    /// The same with the skew of the pairs, and its cost.
    fn with_skew(self, counters: &StereoCounters, cost: &SkewCost) -> Self {
        let skew = Duration::from_nanos(counters.skew_max_nanos);
        Self {
            skew_max_ms: skew.as_secs_f64() * 1e3,
            skew_refused: counters.skew_refused,
            skew_cost: cost.text(skew),
            ..self
        }
    }

    fn text(&self) -> String {
        let Self { pairs, seconds, missing_queue, missing_cameras, .. } = self;
        let place = self.file.as_ref().map_or_else(|| "nothing was kept".to_owned(), |file| file.display().to_string());
        let rate = if *seconds > 0.0 { (pairs + missing_queue).saturating_sub(1) as f64 / seconds } else { 0.0 };
        let skew = if self.skew_max_ms > 0.0 {
            format!(
                "\nskew at most {:.2} ms: {}; {} pairs refused for it",
                self.skew_max_ms, self.skew_cost, self.skew_refused
            )
        } else {
            String::new()
        };
        format!(
            "{pairs} pairs in {seconds:.2} s ({rate:.2} per second), {} missing: {place}{skew}",
            missing_queue + missing_cameras
        )
    }

    /// Why the command fails.
    fn wrong(&self) -> Option<String> {
        if self.failure.is_some() {
            return self.failure.clone();
        }
        let mut parts = Vec::new();
        if self.missing_queue > 0 {
            parts.push(format!(
                "{} pairs were left out because they could not be written fast enough: more --writers or --queue for a busy processor, another disk or --jpeg 90 for a slow one",
                self.missing_queue
            ));
        }
        if self.missing_cameras > 0 {
            let last = self
                .complaint
                .as_ref()
                .map_or_else(String::new, |complaint| format!(" (the last complaint: {complaint})"));
            parts.push(format!(
                "{} pairs did not come from the cameras, or not as pairs{last}: `pb3dp cameras check` says what to do",
                self.missing_cameras
            ));
        }
        if parts.is_empty() && self.file.is_none() {
            parts.push("not one pair came before the end: nothing was kept".to_owned());
        }
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}

fn failure_text(failure: Failure, folder: &Path, pairs: u64) -> String {
    let kept = format!("{pairs} pairs before it are kept in {}", folder.display());
    match failure {
        Failure::Disk(error) if error.is_disk_full() => {
            let free = free_bytes(folder).map_or_else(|_| "unknown how many".to_owned(), |bytes| bytes.to_string());
            let error = anyhow::Error::new(error);
            format!("the disk is full, {free} bytes are free: {error:#}; make room, or record elsewhere; {kept}")
        }
        Failure::Disk(error) => format!("{:#}; {kept}", anyhow::Error::new(error)),
        Failure::Camera(error) => format!("{:#}; {kept}", anyhow::Error::new(error)),
        Failure::Thread(error) => format!("the system gives no thread to write with: {error}; {kept}"),
    }
}
