//! The table `[estimator.geometric]`: errors and visibility limits of a tracker without images.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_sim::geometric::{GeometricConfig, PoseSigma};
use serde::Deserialize;

use super::super::load::Checker;
use super::super::units::{in_deg, in_mm};

/// Its name in setups.
pub(super) const NAME: &str = "geometric";
/// Position in the list after the methods that use images.
pub(super) const ALSO_KNOWN: &str = ", and geometric, which renders no image";

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GeometricSection {
    noise: SigmaSection,
    lock: SigmaSection,
    in_view_share_min: f64,
    turned_max_deg: f64,
}

/// Standard deviations of a pose, along and about the axes of the model.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SigmaSection {
    lateral_mm: f64,
    depth_mm: f64,
    tilt_deg: f64,
    about_normal_deg: f64,
}

impl GeometricSection {
    /// It sees targets in the search range.
    pub(super) fn build(&self, range: &SearchRange, check: &mut Checker) -> GeometricConfig {
        let key = |name: &str| format!("estimator.{NAME}.{name}");
        check.number(&key("in_view_share_min"), self.in_view_share_min, GeometricConfig::IN_VIEW_SHARE_MIN);
        check.number(&key("turned_max_deg"), self.turned_max_deg, in_deg(GeometricConfig::TURNED_MAX_RAD));
        GeometricConfig {
            noise: self.noise.build(&key("noise"), check),
            lock: self.lock.build(&key("lock"), check),
            in_view_share_min: self.in_view_share_min,
            turned_max_rad: self.turned_max_deg.to_radians(),
            z_min_m: range.z_min_m,
            z_max_m: range.z_max_m,
            // Each run sets the seed: see `Setup::reseed`.
            seed: 0,
        }
    }
}

impl SigmaSection {
    fn build(&self, key: &str, check: &mut Checker) -> PoseSigma {
        check.number(&format!("{key}.lateral_mm"), self.lateral_mm, in_mm(PoseSigma::POSITION_M));
        check.number(&format!("{key}.depth_mm"), self.depth_mm, in_mm(PoseSigma::POSITION_M));
        check.number(&format!("{key}.tilt_deg"), self.tilt_deg, in_deg(PoseSigma::ANGLE_RAD));
        check.number(&format!("{key}.about_normal_deg"), self.about_normal_deg, in_deg(PoseSigma::ANGLE_RAD));
        PoseSigma {
            lateral_m: self.lateral_mm * 1e-3,
            depth_m: self.depth_mm * 1e-3,
            tilt_rad: self.tilt_deg.to_radians(),
            about_normal_rad: self.about_normal_deg.to_radians(),
        }
    }
}
