//! The keys of the table `[camera]` about size and rate of the images, which all backends have.

use super::super::load::Checker;

/// Checks the size of the images.
pub(super) fn check_size(width_px: i64, height_px: i64, check: &mut Checker) {
    for (key, pixels) in [("camera.width_px", width_px), ("camera.height_px", height_px)] {
        check.count(key, pixels, 64..=4096);
    }
}

/// Checks the rate of the pairs; a refused one is limited to what is allowed.
pub(super) fn frame_rate_hz(stated_hz: f64, check: &mut Checker) -> f64 {
    check.limited("camera.frame_rate_hz", stated_hz, 1.0..=240.0)
}
