//! Parameters of the tracker.

use pb3dp_estimation_core::error::{EstimationError, check_range};
use pb3dp_estimation_core::ranges;

/// Parameters of the direct tracker.
///
/// Points, border, turn between views and relief follow the prototype of ADR 7; the other defaults are chosen by hand, not
/// varied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectTrackerConfig {
    /// Number of points of the model at full resolution, 64 to 16384. Time grows in proportion to the number of points, and the
    /// error decreases with its square root. Default 1024.
    pub points: usize,
    /// Width of the border excluded along the region's outline, pixels, 0 to 50: a defocused camera mixes target and background
    /// there. At most 0.12 times the side of a square as large as the region. Default 6.
    pub erosion_px: u32,
    /// Largest number of Gauss-Newton steps per frame and level, 1 to 50. Default 16.
    pub steps_max: usize,
    /// Largest number of stored views, 1 to 100; the first one is never replaced. Default 12.
    pub views_max: usize,
    /// A new view is stored if every stored view differs by more than this rotation, degrees, 2 to 60. Default 16.
    pub view_turn_deg: f64,
    /// A new view is stored if every stored view differs by more than this scale factor, 1.05 to 4. Default 1.4.
    pub view_scale: f64,
    /// Standard deviation of the surface about its plane, pixels of disparity, 0 (the target is flat) to 10. Default 1.5.
    pub relief_sigma_px: f64,
    /// Smallest share of the visible points that must fit, 0.05 to 0.95; below: `lost`. Default 0.35.
    pub inlier_share_min: f64,
    /// Smallest correlation of the stored view with each image, as a share of the value that its noise allows, 0 to 1; below:
    /// `lost`. Default 0.6.
    pub correlation_min: f64,
    /// Largest standard deviation of the normal, degrees, 0.01 to 90; above: `weak-tilt`. Default 3.
    pub tilt_sigma_sure_deg: f64,
    /// Time in which both cameras read their rows one after the other (rolling shutter), milliseconds, 0 (global shutter) to 100. A target that
    /// moves in this time is sheared; the covariance of its rotation contains that. Default 0.
    pub rolling_shutter_millis: f64,
}

impl Default for DirectTrackerConfig {
    fn default() -> Self {
        Self {
            points: 1024,
            erosion_px: 6,
            steps_max: 16,
            views_max: 12,
            view_turn_deg: 16.0,
            view_scale: 1.4,
            relief_sigma_px: 1.5,
            inlier_share_min: 0.35,
            correlation_min: 0.6,
            tilt_sigma_sure_deg: 3.0,
            rolling_shutter_millis: 0.0,
        }
    }
}

impl DirectTrackerConfig {
    ranges! {
        POINTS: usize = 64..=16_384;
        EROSION_PX: u32 = 0..=50;
        STEPS_MAX: usize = 1..=50;
        VIEWS_MAX: usize = 1..=100;
        VIEW_TURN_DEG: f64 = 2.0..=60.0;
        VIEW_SCALE: f64 = 1.05..=4.0;
        RELIEF_SIGMA_PX: f64 = 0.0..=10.0;
        INLIER_SHARE_MIN: f64 = 0.05..=0.95;
        CORRELATION_MIN: f64 = 0.0..=1.0;
        TILT_SIGMA_SURE_DEG: f64 = 0.01..=90.0;
        ROLLING_SHUTTER_MILLIS: f64 = 0.0..=100.0;
    }

    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        check_range("direct.tracker.points", self.points, Self::POINTS)?;
        check_range("direct.tracker.erosion_px", self.erosion_px, Self::EROSION_PX)?;
        check_range("direct.tracker.steps_max", self.steps_max, Self::STEPS_MAX)?;
        check_range("direct.tracker.views_max", self.views_max, Self::VIEWS_MAX)?;
        check_range("direct.tracker.view_turn_deg", self.view_turn_deg, Self::VIEW_TURN_DEG)?;
        check_range("direct.tracker.view_scale", self.view_scale, Self::VIEW_SCALE)?;
        check_range("direct.tracker.relief_sigma_px", self.relief_sigma_px, Self::RELIEF_SIGMA_PX)?;
        check_range("direct.tracker.inlier_share_min", self.inlier_share_min, Self::INLIER_SHARE_MIN)?;
        check_range("direct.tracker.correlation_min", self.correlation_min, Self::CORRELATION_MIN)?;
        check_range("direct.tracker.tilt_sigma_sure_deg", self.tilt_sigma_sure_deg, Self::TILT_SIGMA_SURE_DEG)?;
        check_range("direct.tracker.rolling_shutter_millis", self.rolling_shutter_millis, Self::ROLLING_SHUTTER_MILLIS)
    }
}
