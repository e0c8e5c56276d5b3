//! Parameters of the tracker.

use pb3dp_geometry::ranges;

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
        pub fn validate "direct.tracker.";
        points, POINTS: usize = 64..=16_384;
        erosion_px, EROSION_PX: u32 = 0..=50;
        steps_max, STEPS_MAX: usize = 1..=50;
        views_max, VIEWS_MAX: usize = 1..=100;
        view_turn_deg, VIEW_TURN_DEG: f64 = 2.0..=60.0;
        view_scale, VIEW_SCALE: f64 = 1.05..=4.0;
        relief_sigma_px, RELIEF_SIGMA_PX: f64 = 0.0..=10.0;
        inlier_share_min, INLIER_SHARE_MIN: f64 = 0.05..=0.95;
        correlation_min, CORRELATION_MIN: f64 = 0.0..=1.0;
        tilt_sigma_sure_deg, TILT_SIGMA_SURE_DEG: f64 = 0.01..=90.0;
        rolling_shutter_millis, ROLLING_SHUTTER_MILLIS: f64 = 0.0..=100.0;
    }
}
