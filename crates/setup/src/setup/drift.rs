//! The table `[drift]`: when a run warns that the cameras no longer match their calibration.

use std::time::Duration;

use super::super::table::table;

/// Interval of the checks, and limits for the median of several checks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftConfig {
    /// Time between two checks.
    pub every: Duration,
    /// Largest vertical misalignment, pixels.
    pub rows_max_px: f64,
    /// Additional blur of one camera, standard deviation in pixels.
    pub focus_max_px: f64,
    /// Difference of the mean luminances, percent of the brighter camera.
    pub brightness_max_percent: f64,
    /// Time between both exposures, for synchronised cameras.
    pub skew_max: Duration,
}

table! {
    pub(super) struct DriftSection builds DriftConfig {
        every_s: f64 => every = duration_s(0.5..=3600.0);
        rows_max_px: f64 => rows_max_px = number(0.05..=5.0);
        focus_max_px: f64 => focus_max_px = number(0.1..=10.0);
        brightness_max_percent: f64 => brightness_max_percent = number(1.0..=100.0);
        skew_max_millis: f64 => skew_max = duration_millis(1e-5..=0.1);
    }
}
