//! A camera that renders nothing, with the tracker that would look at its pictures.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector2;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock};
use pb3dp_sim::geometric::{GeometricConfig, GeometricTracker, Sighting};
use pb3dp_sim::scene::PoseSource;

use crate::SimCameraConfig;
use crate::schedule::ExposureSchedule;

/// For messages.
const NAME: &str = "camera without pictures";

/// Exposes at the times of a [`SimStereoCamera`](crate::SimStereoCamera) and says what a tracker would: the true pose at
/// mid-exposure, with noise. Number and times of frames are those that the camera with pictures would give.
pub struct GeometricCamera {
    tracker: GeometricTracker,
    poses: Box<dyn PoseSource>,
    schedule: ExposureSchedule,
    exposure: Duration,
}

/// One frame.
#[derive(Clone, Copy, Debug)]
pub struct GeometricFrame {
    /// Number of the exposure.
    pub sequence: u64,
    /// Middle of the exposure.
    pub exposed_at: MonotonicTime,
    /// What a tracker says of it.
    pub sighting: Sighting,
    /// The truth.
    pub cam_left_from_target: Pose<CamLeft, Target>,
}

impl GeometricCamera {
    /// A camera whose first exposure begins now.
    ///
    /// # Errors
    /// `Unusable` for a configuration out of its range, with the value.
    pub fn new(
        tracker: GeometricTracker,
        poses: Box<dyn PoseSource>,
        clock: Arc<dyn Clock>,
        config: &SimCameraConfig,
    ) -> Result<Self, CameraError> {
        config.validate()?;
        Ok(Self { tracker, poses, schedule: ExposureSchedule::from_now(clock, config), exposure: config.exposure })
    }

    /// What it sees with.
    pub fn config(&self) -> &GeometricConfig {
        self.tracker.config()
    }

    /// Waits for the end of the next exposure.
    ///
    /// # Errors
    /// `Timeout` if there is none in this time, `BadPair` if the poses are not finite.
    pub fn next_frame(&mut self, timeout: Duration) -> Result<GeometricFrame, CameraError> {
        let (sequence, start) = self.schedule.wait_for_next(NAME, timeout)?;
        let exposed_at = start + self.exposure / 2;
        let poses = self.poses.poses_at(exposed_at);
        let cam_left_from_target = poses.world_from_cam_left.inverse() * poses.world_from_target;
        if !cam_left_from_target.is_finite() {
            let message = format!("{NAME}: the poses at {} s are not finite: {poses:?}", exposed_at.as_secs_f64());
            return Err(CameraError::new(CameraErrorKind::BadPair, message));
        }
        let sighting = self.tracker.look(&cam_left_from_target, sequence);
        Ok(GeometricFrame { sequence, exposed_at, sighting, cam_left_from_target })
    }

    /// The target's outline in the left picture, as far as it lies before the camera, pixels.
    pub fn outline_px(&self, cam_left_from_target: &Pose<CamLeft, Target>) -> Vec<Vector2<f64>> {
        self.tracker.outline_px(cam_left_from_target)
    }
}
