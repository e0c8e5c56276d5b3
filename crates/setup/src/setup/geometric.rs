//! The table `[estimator.geometric]`: errors and visibility limits of a tracker without images.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_sim::geometric::{GeometricConfig, PoseSigma};
use serde::Deserialize;

use super::super::load::Checker;
use super::super::table::{Builds, deg, number, table};

/// Its name in setups.
pub(super) const NAME: &str = "geometric";
/// Position in the list after the methods that use images.
pub(super) const ALSO_KNOWN: &str = ", and geometric, which renders no image";

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GeometricSection {
    noise: SigmaSection,
    lock: SigmaSection,
    in_view_share_min: f64,
    turned_max_deg: f64,
}

table! {
    /// Standard deviations of a pose, along and about the axes of the model.
    struct SigmaSection builds PoseSigma {
        lateral_mm: f64 => lateral_m = mm(PoseSigma::POSITION_M);
        depth_mm: f64 => depth_m = mm(PoseSigma::POSITION_M);
        tilt_deg: f64 => tilt_rad = deg(PoseSigma::ANGLE_RAD);
        about_normal_deg: f64 => about_normal_rad = deg(PoseSigma::ANGLE_RAD);
    }
}

impl GeometricSection {
    /// It sees targets in the search range.
    pub(super) fn build(&self, range: &SearchRange, check: &mut Checker) -> GeometricConfig {
        let key = |name: &str| format!("estimator.{NAME}.{name}");
        let (in_view, turned_deg) = (&self.in_view_share_min, &self.turned_max_deg);
        GeometricConfig {
            noise: self.noise.build(&key("noise"), check),
            lock: self.lock.build(&key("lock"), check),
            in_view_share_min: number(in_view, &key("in_view_share_min"), check, GeometricConfig::IN_VIEW_SHARE_MIN),
            turned_max_rad: deg(turned_deg, &key("turned_max_deg"), check, GeometricConfig::TURNED_MAX_RAD),
            z_min_m: range.z_min_m,
            z_max_m: range.z_max_m,
            // Each run sets the seed: see `Setup::reseed`.
            seed: 0,
        }
    }
}
