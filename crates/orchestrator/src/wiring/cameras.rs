//! Cameras of this machine: opened, looked at once before an arm is switched on, and watched while they run.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_camera_v4l2::{ReopeningCamera, StereoConfig};
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera, StereoCameraInfo};

use crate::commands::pair::check_pictures;
use crate::config::setup::{RealCameras, Synchronisation};

/// Some cameras take a second or two to begin; none takes longer.
const FIRST_PAIR_WITHIN: Duration = Duration::from_secs(10);

/// Pairs from one look at the drift to the next one: 9 s at 30 per second.
const DRIFT_EVERY: u64 = 256;
/// Cameras with one trigger do not drift; estimates of a drift do by so much, seconds per second.
const DRIFT_MAX: f64 = 20e-6;
/// The same, as a share of the scatter of single pairs: five standard deviations of a line through 512 of them, in 17 s.
const DRIFT_PER_SCATTER: f64 = 0.05;
/// A limit of the skew that is so near is warned of, seconds.
const LIMIT_NEAR_S: f64 = 30.0;

/// Opens both cameras, and takes a first pair.
///
/// # Errors
/// As [`ReopeningCamera::open`]; no pair; left and right exchanged.
pub(super) fn wire_real(
    real: &RealCameras,
    rig: &StereoRig,
    (system, clock): (Arc<dyn VideoSystem>, Arc<dyn Clock>),
) -> Result<Box<dyn StereoCamera>> {
    let camera = ReopeningCamera::open(system, Arc::clone(&clock), real.stereo.clone(), real.reopen_for);
    let camera = camera.context("table [camera]")?;
    let mut camera = WatchedCamera { camera, cameras: real.clone(), pairs: 0, is_drift_told: false };
    let first = first_pair(&mut camera, &*clock)?;
    check_pictures("cameras", rig, &first.left, &first.right)
        .context("table [camera]: exchange left.device and right.device if they are the wrong way round")?;
    Ok(Box::new(camera))
}

/// What an arm waits for before it is switched on: that there are pairs at all.
fn first_pair(camera: &mut WatchedCamera, clock: &dyn Clock) -> Result<FramePair> {
    let deadline = clock.now() + FIRST_PAIR_WITHIN;
    loop {
        match camera.next_pair(Duration::from_secs(1)) {
            Ok(pair) => return Ok(pair),
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                if clock.now() >= deadline {
                    bail!("cameras: no first pair within {FIRST_PAIR_WITHIN:?}: {error}");
                }
            }
            Err(error) => return Err(error).context("cameras: no first pair"),
        }
    }
}

/// Cameras of this machine that tell when they run apart, and at their end what was left out.
struct WatchedCamera {
    camera: ReopeningCamera,
    cameras: RealCameras,
    pairs: u64,
    is_drift_told: bool,
}

impl WatchedCamera {
    fn look_at_drift(&mut self) {
        let Some(drift) = self.camera.counters().drift else { return };
        let StereoConfig { skew_max, .. } = self.cameras.stereo;
        let (skew_millis, ppm) = (drift.skew_s * 1e3, drift.rate * 1e6);
        let what = match self.cameras.synchronisation {
            Synchronisation::HardwareTrigger if drift.rate.abs() > DRIFT_MAX + DRIFT_PER_SCATTER * drift.scatter_s => {
                Some(format!(
                    "their skew of {skew_millis:.2} ms drifts by {ppm:.0} us per second: they are not triggered by one signal, as \
                     camera.synchronisation says; look at the wiring, and at the cameras' trigger mode"
                ))
            }
            Synchronisation::FreeRunning => drift.seconds_until(skew_max).filter(|s| *s < LIMIT_NEAR_S).map(|seconds| {
                format!(
                    "their skew of {skew_millis:.2} ms drifts by {ppm:.0} us per second and passes camera.skew_max_millis in {seconds:.0} s: \
                     pairs are refused then, for as long as it takes to come round"
                )
            }),
            Synchronisation::HardwareTrigger => None,
        };
        if let (Some(what), false) = (&what, self.is_drift_told) {
            tracing::warn!("cameras: {what}");
        }
        self.is_drift_told = what.is_some();
    }
}

impl StereoCamera for WatchedCamera {
    fn info(&self) -> &StereoCameraInfo {
        self.camera.info()
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        self.camera.next_pair_into(pair, timeout)?;
        self.pairs += 1;
        if self.pairs.is_multiple_of(DRIFT_EVERY) {
            self.look_at_drift();
        }
        Ok(())
    }
}

impl Drop for WatchedCamera {
    fn drop(&mut self) {
        let counters = self.camera.counters();
        tracing::info!(
            "cameras: {} pairs, opened anew {} times; since then at most {:.2} ms of skew, {} pairs refused for it, left {:?}, right {:?}",
            self.pairs,
            self.camera.reopened(),
            counters.skew_max_nanos as f64 * 1e-6,
            counters.skew_refused,
            counters.left,
            counters.right
        );
    }
}
