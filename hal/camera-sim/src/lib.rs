//! Stereo camera backend that renders the simulated workcell.
//!
//! [`SimStereoCamera`] exposes at fixed times of an injected clock, queries the poses at these times from a `PoseSource`, and
//! renders the pair. It does not depend on arms: the arm simulation implements `PoseSource`. [`GeometricCamera`] exposes at the
//! same times and renders nothing: it combines camera and tracker, for runs that do not study image processing. Both support
//! [`CameraFaults`](pb3dp_sim::camera_faults::CameraFaults): [`FaultyCamera`] applies them to images.

mod faults;
mod geometric;
mod schedule;

use std::sync::Arc;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{PoseSource, ScenePoses};
use pb3dp_sim::sensor::BLUR_MOMENTS;

pub use faults::FaultyCamera;
pub use geometric::GeometricCamera;
use schedule::ExposureSchedule;

/// Timing of the simulated camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimCameraConfig {
    /// Time between exposures.
    pub period: Duration,
    /// Length of an exposure, at most `period`. Without motion blur it only sets the time at which a pair is ready.
    pub exposure: Duration,
    /// Number of times during an exposure that are rendered and averaged: 1 for sharp images, more for motion blur (each costs a
    /// rendering), at most 64.
    pub blur_moments: u32,
    /// Pairs until the end of the stream; `None` never ends.
    pub pairs: Option<u64>,
}

impl Default for SimCameraConfig {
    /// 30 pairs per second, 4 ms of exposure, sharp, endless.
    fn default() -> Self {
        Self {
            period: Duration::from_nanos(33_333_333),
            exposure: Duration::from_millis(4),
            blur_moments: 1,
            pairs: None,
        }
    }
}

impl SimCameraConfig {
    fn validate(&self) -> Result<(), CameraError> {
        let refuse = |message: String| Err(CameraError::new(CameraErrorKind::Unusable, message));
        if self.period.is_zero() {
            return refuse("the period of the simulated camera is 0; it must be positive".to_owned());
        }
        if self.exposure > self.period {
            return refuse(format!(
                "the exposure of the simulated camera is {:?}; it must not exceed the period, {:?}",
                self.exposure, self.period
            ));
        }
        if !BLUR_MOMENTS.contains(&self.blur_moments) {
            return refuse(format!(
                "blur_moments of the simulated camera is {}; set {} to {}",
                self.blur_moments,
                BLUR_MOMENTS.start(),
                BLUR_MOMENTS.end()
            ));
        }
        Ok(())
    }
}

/// A simulated stereo camera with a global shutter and no skew.
///
/// Exposure `k` begins `k` periods after the camera was created. A call delivers the newest complete exposure that was not yet
/// delivered, otherwise it waits for the next one. A late caller therefore loses pairs (a gap in `sequence`) instead of falling
/// behind, as with a real camera. Poses are requested for times up to one period and one exposure in the past of the clock, and
/// these times never decrease from pair to pair.
///
/// Rendering uses processor time within the call. With a clock that only advances when a thread sleeps, images and times depend
/// only on configuration, seed and poses.
pub struct SimStereoCamera {
    renderer: StereoRenderer,
    poses: Box<dyn PoseSource>,
    config: SimCameraConfig,
    info: StereoCameraInfo,
    schedule: ExposureSchedule,
    delivered: u64,
    /// What the cameras show during the next exposure.
    moments: Vec<ScenePoses>,
    /// Number and begin of the next exposure, or why there is none, if it was taken beforehand.
    exposed: Option<Result<(u64, MonotonicTime), CameraError>>,
}

impl SimStereoCamera {
    /// A camera whose first exposure begins now.
    ///
    /// # Errors
    /// `Unusable` for a configuration out of its range, with the value.
    pub fn new(
        renderer: StereoRenderer,
        poses: Box<dyn PoseSource>,
        clock: Arc<dyn Clock>,
        config: SimCameraConfig,
    ) -> Result<Self, CameraError> {
        config.validate()?;
        let info = StereoCameraInfo {
            name: format!("simulation of {}", renderer.scene().target().name),
            size: renderer.size(),
            period: Some(config.period),
        };
        let schedule = ExposureSchedule::from_now(clock, &config);
        let moments = Vec::with_capacity(config.blur_moments as usize);
        Ok(Self { renderer, poses, config, info, schedule, delivered: 0, moments, exposed: None })
    }

    /// The renderer, for access to its scene and ground truth.
    pub fn renderer_mut(&mut self) -> &mut StereoRenderer {
        &mut self.renderer
    }

    /// Waits for the next exposure and takes what the cameras show during it; returns its number and begin.
    fn take_exposure(&mut self, timeout: Duration) -> Result<(u64, MonotonicTime), CameraError> {
        if self.config.pairs.is_some_and(|pairs| self.delivered >= pairs) {
            return Err(self.end_of_stream());
        }
        let (sequence, start) = self.schedule.wait_for_next(&self.info.name, timeout)?;
        self.gather_poses(start)?;
        Ok((sequence, start))
    }

    /// Requests the poses during the exposure that begins at `start`.
    fn gather_poses(&mut self, start: MonotonicTime) -> Result<(), CameraError> {
        let (exposure, count) = (self.config.exposure, self.config.blur_moments);
        self.moments.clear();
        for moment in 0..count {
            // Centres of equal time slices, so that a single pose is at mid-exposure.
            let at = start + exposure * (2 * moment + 1) / (2 * count);
            let poses = self.poses.poses_at(at);
            if !(poses.world_from_cam_left.is_finite() && poses.world_from_target.is_finite()) {
                let message =
                    format!("{}: the poses at {} s are not finite: {poses:?}", self.info.name, at.as_secs_f64());
                return Err(CameraError::new(CameraErrorKind::BadPair, message));
            }
            self.moments.push(poses);
        }
        Ok(())
    }

    fn end_of_stream(&self) -> CameraError {
        let message = format!("{}: all {} pairs have been delivered", self.info.name, self.delivered);
        CameraError::new(CameraErrorKind::EndOfStream, message)
    }
}

impl StereoCamera for SimStereoCamera {
    fn info(&self) -> &StereoCameraInfo {
        &self.info
    }

    fn expose(&mut self, timeout: Duration) -> Option<MonotonicTime> {
        let taken = self.take_exposure(timeout);
        let exposed_at = taken.as_ref().ok().map(|(_, start)| *start + self.config.exposure / 2);
        self.exposed = Some(taken);
        exposed_at
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        let exposed = self.exposed.take();
        let (sequence, start) = exposed.unwrap_or_else(|| self.take_exposure(timeout))?;
        self.renderer
            .render_exposure(&self.moments, sequence, &mut pair.left, &mut pair.right)
            .map_err(|error| CameraError::caused_by(CameraErrorKind::BadPair, "the pair cannot be rendered", error))?;
        pair.sequence = sequence;
        pair.exposed_at = start + self.config.exposure / 2;
        pair.skew_nanos = 0;
        pair.clear_delivered();
        self.delivered += 1;
        Ok(())
    }
}
