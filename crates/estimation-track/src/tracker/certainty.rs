//! How certain a pose is: variances that its equations do not contain, and the status that follows from the covariance.

use std::fmt::Write;

use nalgebra::Matrix6;
use pb3dp_estimation_core::estimate::{PlaneEstimate, SHIFT_SIGMA_SURE, TrackEstimate};
use pb3dp_estimation_core::method::FramePrior;
use pb3dp_estimation_core::status::Status;

use super::DirectTracker;
use crate::target::Target;

/// Depth and the tilts about x and y in a covariance: what a plane determines.
const PLANE_AXES: [usize; 3] = [2, 3, 4];
/// Standard deviation of the velocity of a target that is not known to move, metres and radians per second: of the sideways motion, and of
/// the turn. Chosen by hand, not varied: half of a motion that a hand follows with ease.
const SPEED_SIGMA_M_PER_S: f64 = 0.05;
const TURN_SIGMA_RAD_PER_S: f64 = 0.3;

/// Directions of a pose in words.
const AXES: [&str; 6] = [
    "a shift along x",
    "a shift along y",
    "the depth",
    "the turn about x",
    "the turn about y",
    "the turn about the normal",
];

/// A covariance with other variances of depth and tilts.
fn with_diagonal(mut covariance: Matrix6<f64>, variances: [f64; 3]) -> Matrix6<f64> {
    for (axis, variance) in PLANE_AXES.into_iter().zip(variances) {
        covariance[(axis, axis)] = variance;
    }
    covariance
}

impl DirectTracker {
    /// The first pose on a curved surface whose frame is not that of the visible surface, with the errors of the plane that defines it: the tilt of a
    /// curved surface is no more certain than that plane. Later poses are measured relative to the first one.
    pub(super) fn with_errors_of_plane(&self, first: TrackEstimate, found: &PlaneEstimate) -> TrackEstimate {
        let is_wanted = |target: &Target| !target.is_on_surface && target.is_curved();
        let of_plane = found.plane_covariance.filter(|_| self.target.as_ref().is_some_and(is_wanted));
        let (Some(covariance), Some(of_plane)) = (first.covariance, of_plane) else { return first };
        let variances = PLANE_AXES.map(|axis| covariance[(axis, axis)].max(of_plane[(axis - 2, axis - 2)]));
        self.with_variances(first, variances, "the plane of the surface has")
    }

    /// The first pose of a target that may move between the two exposures, with the errors of this motion. The second frame shows how it moves,
    /// and what remains is the error of the skew itself.
    pub(super) fn with_errors_of_motion(&mut self, first: TrackEstimate, prior: &FramePrior) -> TrackEstimate {
        let FramePrior { skew_s, skew_sigma_s, .. } = *prior;
        let restored = self.target.as_ref().and_then(|target| target.first_pose_covariance);
        if restored.is_some() {
            return TrackEstimate { first_pose_covariance: restored, ..first };
        }
        if let Some(target) = &mut self.target {
            target.first_skew_s = Some(skew_s).filter(|skew_s| *skew_s != 0.0);
        }
        let (Some(covariance), Some(pose)) = (first.covariance, first.cam_left_from_model) else { return first };
        let depth_per_baseline = pose.translation_m().norm() / self.rig.baseline_m();
        let variances_of = |skew_s: f64| {
            let rates = [SPEED_SIGMA_M_PER_S, TURN_SIGMA_RAD_PER_S, TURN_SIGMA_RAD_PER_S];
            let sigmas = rates.map(|rate| rate * skew_s * depth_per_baseline);
            std::array::from_fn(|k| covariance[(PLANE_AXES[k], PLANE_AXES[k])] + sigmas[k].powi(2))
        };
        let variances = variances_of(skew_s.hypot(skew_sigma_s));
        let first =
            self.with_variances(first, variances, "the target may have moved between the exposures, so the tilt has");
        if let Some(target) = &mut self.target {
            target.first_pose_covariance = first.covariance;
            target.first_pose_covariance_at_rest = Some(with_diagonal(covariance, variances_of(skew_sigma_s)));
        }
        let surface = self.target.as_ref().and_then(Target::surface_estimate);
        TrackEstimate { first_pose_covariance: first.covariance, surface, ..first }
    }

    /// A pose with other variances of depth and tilts.
    fn with_variances(&self, mut first: TrackEstimate, variances: [f64; 3], what_has: &str) -> TrackEstimate {
        first.covariance = first.covariance.map(|covariance| with_diagonal(covariance, variances));
        let (tilt_deg, limit) = (variances[1].max(variances[2]).sqrt().to_degrees(), self.config.tilt_sigma_sure_deg);
        if first.status == Status::Ok && tilt_deg > limit {
            first.status = Status::WeakTilt;
            first.reason = format!("{what_has} a standard deviation of {tilt_deg:.1} degrees (limit {limit:.1})");
        }
        first
    }

    /// Status, and which directions are observed, by the standard deviations of the six directions.
    pub(super) fn judge_covariance(
        &self,
        covariance: Option<&Matrix6<f64>>,
        distance_m: f64,
        reason: &mut String,
    ) -> (Status, Option<[bool; 6]>) {
        let limit = self.config.tilt_sigma_sure_deg;
        let Some(covariance) = covariance else {
            reason.push_str("the normal's standard deviation is unknown: the tilt is not determined");
            return (Status::WeakTilt, None);
        };
        let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
        let most = |axis: usize| if axis < 3 { SHIFT_SIGMA_SURE * distance_m } else { limit.to_radians() };
        let observed: [bool; 6] = std::array::from_fn(|axis| sigma(axis) <= most(axis));
        let tilt_deg = sigma(3).hypot(sigma(4)).to_degrees();
        let (sure, verb) = if tilt_deg <= limit { (true, "is determined") } else { (false, "is not determined") };
        // Writing into a string cannot fail.
        let _ = write!(
            reason,
            "the normal's standard deviation is {tilt_deg:.2} degrees (limit {limit:.2}): the tilt {verb}"
        );
        let [x, y, depth, _, _, spin] = observed;
        if !(x && y && depth && spin) {
            reason.push_str("; the images do not show");
            for (count, (name, _)) in AXES.iter().zip(observed).filter(|(_, is_observed)| !is_observed).enumerate() {
                let _ = write!(reason, "{} {name}", if count == 0 { "" } else { "," });
            }
        }
        let status = match (depth, x && y && spin) {
            (false, _) => Status::Ambiguous,
            (true, false) => Status::PartlyObserved,
            (true, true) if sure => Status::Ok,
            (true, true) => Status::WeakTilt,
        };
        (status, Some(observed))
    }
}
