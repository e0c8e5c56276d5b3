//! Statistics of an error over a run.

use nalgebra::Vector3;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};
use pb3dp_record::metrics::{Statistics, max_abs, rms};
use serde::Serialize;

use super::log::ControlSample;

/// Root mean square and largest value of an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RmsMax {
    /// Root mean square.
    pub rms: f64,
    /// Largest absolute value.
    pub max: f64,
}

impl RmsMax {
    /// Of errors; `None` without any.
    pub fn of(samples: &[f64]) -> Option<Self> {
        Some(Self { rms: rms(samples)?, max: max_abs(samples)? })
    }
}

/// Median and 95th percentile of an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MedianP95 {
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
}

impl MedianP95 {
    /// Of absolute errors; `None` without any.
    pub fn of(samples: &[f64]) -> Option<Self> {
        Statistics::of(samples).map(|s| Self { median: s.median, p95: s.p95 })
    }
}

/// Distance between the hand and its desired pose.
#[derive(Clone, Copy, Debug)]
pub struct TrackingError {
    /// Metres.
    pub position_m: f64,
    /// Radians.
    pub orientation_rad: f64,
    /// Angle between the camera axes, radians; excludes the rotation about them.
    pub tilt_rad: f64,
}

impl TrackingError {
    /// Error of one control step, against the desired pose in front of the true target.
    pub fn of(sample: &ControlSample) -> Self {
        Self::between(&sample.world_from_hand_wanted, &sample.world_from_hand)
    }

    /// Error of one control step, against the desired pose by the initial lock.
    pub fn of_locked(sample: &ControlSample) -> Self {
        Self::between(&sample.world_from_hand_locked, &sample.world_from_hand)
    }

    fn between(wanted: &Pose<World, Hand>, is: &Pose<World, Hand>) -> Self {
        let axis = |pose: &Pose<World, Hand>| pose.transform_vector(&Vector3::z());
        Self {
            position_m: (is.translation_m() - wanted.translation_m()).norm(),
            orientation_rad: wanted.rotation().angle_to(&is.rotation()),
            tilt_rad: axis(wanted).angle(&axis(is)),
        }
    }
}
