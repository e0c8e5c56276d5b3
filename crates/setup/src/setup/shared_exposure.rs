//! The table `[camera.shared_exposure]`: one exposure for both cameras, adapted to the light.

use pb3dp_camera_settings::SharedExposure;
use serde::Deserialize;

use super::super::load::{Checker, whole};
use super::millis;

/// Name of the table.
pub(super) const TABLE: &str = "camera.shared_exposure";

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SharedExposureSection {
    target_grey: f64,
    exposure_min_millis: f64,
    exposure_max_millis: f64,
    blur_max_px: f64,
    gain_min: Option<i64>,
    gain_max: Option<i64>,
}

impl SharedExposureSection {
    /// The limits, checked. `uses_gain`: the program changes the gain, too. `nearest_m`: the nearest distance of the target.
    pub(super) fn build(
        &self,
        uses_gain: bool,
        (period_millis, nearest_m): (f64, f64),
        check: &mut Checker,
    ) -> SharedExposure {
        let key = |name: &str| format!("{TABLE}.{name}");
        check.number(&key("target_grey"), self.target_grey, 30.0..=200.0);
        let longest = check.limited(&key("exposure_max_millis"), self.exposure_max_millis, 0.2..=period_millis);
        check.number(&key("exposure_min_millis"), self.exposure_min_millis, 0.1..=longest);
        check.number(&key("blur_max_px"), self.blur_max_px, 0.2..=20.0);
        for (name, gain) in [("gain_min", self.gain_min), ("gain_max", self.gain_max)] {
            match gain {
                Some(gain) => check.count(&key(name), gain, 0..=100_000),
                None if uses_gain => check.refuse(format!(
                    "{TABLE}.{name}: missing; gain = \"shared\" needs it, in units of the driver (`pb3dp cameras list` shows its range)"
                )),
                None => {}
            }
        }
        let gain = self.gain_min.zip(self.gain_max);
        if let Some((min, max)) = gain.filter(|(min, max)| min > max) {
            check.refuse(format!("{TABLE}.gain_min = {min}: larger than gain_max = {max}"));
        }
        SharedExposure {
            target_grey: self.target_grey,
            time: [millis(self.exposure_min_millis), millis(self.exposure_max_millis)],
            gain: gain.filter(|_| uses_gain).map(|(min, max)| [whole(min), whole(max)]),
            blur_max_px: self.blur_max_px,
            nearest_m,
            start: None,
        }
    }
}
