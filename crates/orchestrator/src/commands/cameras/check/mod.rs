//! `pb3dp cameras check`: measures cameras against limits, with a remedy for each excess.

mod report;
#[cfg(test)]
mod tests;
mod times;

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_camera_v4l2::{StereoCounters, V4l2StereoCamera};
use pb3dp_cell::camera_findings::ImageChecks;
use pb3dp_cell::finding::Finding;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::{CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_wiring::CalibrationOptions;

use self::report::Report;
use self::times::Moment;
use super::choice::{CameraChoice, Chosen, check_size};

/// Number of evaluated pairs, spread over the measurement.
const SAMPLES: usize = 6;

/// Time without images after which the cameras count as failed.
const CAMERA_TIMEOUT: Duration = Duration::from_secs(3);

/// Meaning of exit code and `--json`.
const CHECK_JSON: &str = "Show both cameras a scene with texture and sharp edges at the distance at which they work, and let it rest.
Exit code: 0 if nothing fails, 1 else.
Object of --json:
  passed    whether nothing failed
  cameras   their names
  pairs     how many were measured
  findings  check, passed (null: not checked), value and unit, limit_min, limit_max, found (what else there is to say), advice (what
            to do, or null) of each";

/// Arguments of `pb3dp cameras check`.
#[derive(Debug, Args)]
#[command(after_long_help = CHECK_JSON)]
pub(super) struct CheckArgs {
    #[command(flatten)]
    cameras: CameraChoice,
    #[command(flatten)]
    calibration: CalibrationOptions,
    /// Pairs to measure.
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(30..=100_000))]
    pairs: u32,
    /// One JSON object on standard output instead of text.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If the cameras cannot be used, or standard output cannot be written.
pub(super) fn run(system: Arc<dyn VideoSystem>, clock: Arc<dyn Clock>, args: &CheckArgs) -> Result<ExitCode> {
    let report = checked(system, clock, args)?;
    print_line(&if args.json { serde_json::to_string(&report)? } else { report.text() })?;
    Ok(if report.passed { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Data from the cameras.
struct CapturedPairs {
    moments: Vec<Moment>,
    samples: Vec<FramePair>,
    counters: StereoCounters,
    /// Why the measurement ended early.
    failure: Option<String>,
}

fn checked(system: Arc<dyn VideoSystem>, clock: Arc<dyn Clock>, args: &CheckArgs) -> Result<Report> {
    let Chosen { mut config, rig, .. } = args.cameras.chosen(&args.calibration.stated())?;
    let skew_max = config.skew_max;
    // All pairs are accepted here: their skew is measured, and checked at the end.
    if let Some(period_s) = config.left.mode.interval.seconds() {
        config.skew_max = skew_max.max(Duration::from_secs_f64(period_s / 2.0));
    }
    let mut camera =
        V4l2StereoCamera::open(system, Arc::clone(&clock), &config).context("the cameras cannot be used")?;
    let name = camera.info().name.clone();
    let period = camera.info().period.context("the cameras tell no rate")?;
    if let Some(rig) = &rig {
        check_size(rig, camera.info().size)?;
    }
    camera.settle_exposure().context("the cameras cannot be used")?;
    let taken = take(&mut camera, clock.as_ref(), args.pairs as usize);
    if taken.moments.len() < 2 {
        bail!("{name}: no pairs come: {}", taken.failure.as_deref().unwrap_or("the driver reports no reason"));
    }
    let mut findings = times::findings(&taken.moments, period, (skew_max, &config.skew_cost), &taken.counters);
    findings.extend(ImageChecks::new(rig.as_ref()).findings(&taken.samples.iter().collect::<Vec<_>>()));
    if let Some(failure) = taken.failure {
        let found = format!("{} of {} pairs came: {failure}", taken.moments.len(), args.pairs);
        findings.insert(0, Finding::fail("stream", found, "look at plug, cable and hub, then check again"));
    }
    Ok(Report::of(name, taken.moments.len() as u64, findings))
}

/// Captures pairs and keeps the images of some.
fn take(camera: &mut V4l2StereoCamera, clock: &dyn Clock, pairs: usize) -> CapturedPairs {
    let size = camera.info().size;
    let mut pair = FramePair::black(size);
    // Allocated in advance: an allocation between two pairs would disturb the measurement.
    let mut free: Vec<FramePair> = (0..SAMPLES).map(|_| FramePair::black(size)).collect();
    let mut taken = CapturedPairs {
        moments: Vec::with_capacity(pairs),
        samples: Vec::with_capacity(SAMPLES),
        counters: StereoCounters::default(),
        failure: None,
    };
    let every = (pairs / SAMPLES).max(1);
    let mut heartbeat_at = clock.now();
    while taken.moments.len() < pairs {
        match camera.next_pair_into(&mut pair, Duration::from_secs(1)) {
            Ok(()) => {
                heartbeat_at = clock.now();
                let number = taken.moments.len();
                taken.moments.push(Moment {
                    sequence: pair.sequence,
                    exposed_at_s: pair.exposed_at.as_secs_f64(),
                    skew_s: pair.skew_s(),
                });
                // Not the first one: some cameras start with a dark image.
                if number % every == every / 2
                    && let Some(next) = free.pop()
                {
                    taken.samples.push(std::mem::replace(&mut pair, next));
                }
            }
            Err(error) => {
                let goes_on = matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair);
                if !goes_on || clock.now().saturating_since(heartbeat_at) >= CAMERA_TIMEOUT {
                    taken.failure = Some(format!("{:#}", anyhow::Error::new(error)));
                    break;
                }
            }
        }
    }
    taken.counters = camera.counters();
    taken
}
