//! The table `[drift]`: when a run warns that the cameras no longer match their calibration.

use std::time::Duration;

use serde::Deserialize;

use super::super::load::Checker;
use super::millis;

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

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DriftSection {
    every_s: f64,
    rows_max_px: f64,
    focus_max_px: f64,
    brightness_max_percent: f64,
    skew_max_millis: f64,
}

impl DriftSection {
    pub(super) fn build(&self, check: &mut Checker) -> DriftConfig {
        let every_s = check.limited("drift.every_s", self.every_s, 0.5..=3600.0);
        check.number("drift.rows_max_px", self.rows_max_px, 0.05..=5.0);
        check.number("drift.focus_max_px", self.focus_max_px, 0.1..=10.0);
        check.number("drift.brightness_max_percent", self.brightness_max_percent, 1.0..=100.0);
        check.number("drift.skew_max_millis", self.skew_max_millis, 0.01..=100.0);
        DriftConfig {
            every: Duration::from_secs_f64(every_s),
            rows_max_px: self.rows_max_px,
            focus_max_px: self.focus_max_px,
            brightness_max_percent: self.brightness_max_percent,
            skew_max: millis(self.skew_max_millis),
        }
    }
}
