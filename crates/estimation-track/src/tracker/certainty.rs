//! How certain a pose is: variances that its equations do not contain, and the status that follows from the covariance.

use std::fmt::Write;

use nalgebra::{Matrix6, Vector3};
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, PlanePose, SHIFT_SIGMA_SURE, TrackEstimate};
use pb3dp_estimation_core::method::FramePrior;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

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

/// A plane relative to the frame of a pose: its depth along the normal, metres, and its tilts about x and y, radians.
fn apart(pose: &Pose<CamLeft, Model>, plane: &PlanePose) -> [f64; 3] {
    let (origin, normal) = (pose.translation_m(), pose.transform_vector(&Vector3::z()));
    let inverse_depth = plane.inverse_depth_plane.dot(&origin);
    // A small turn of the plane about x moves its normal against y, one about y along x.
    let turned = pose.inverse().transform_vector(&plane.inverse_depth_plane.normalize());
    [(1.0 / inverse_depth - 1.0) * normal.dot(&origin), -turned.y, turned.x]
}

impl DirectTracker {
    /// The first pose of a target whose frame is not that of the visible surface, with the errors of the plane that defines it: its equations contain
    /// the noise of the images, but not what real surfaces, lenses and light do to a plane. If a part of the region is followed, it may have
    /// another plane than the region; their difference counts as error. Later poses are measured relative to the first one.
    pub(super) fn with_errors_of_plane(&self, first: TrackEstimate, found: &PlaneEstimate) -> TrackEstimate {
        let is_part = first.warnings.iter().any(|warning| matches!(warning, EstimateWarning::PartFollowed { .. }));
        // A model of before has its own errors.
        let is_wanted = |target: &&Target| {
            let is_new = target.first_pose_covariance.is_none();
            is_new && (!target.is_on_surface || (is_part && !target.is_curved()))
        };
        let Some(target) = self.target.as_ref().filter(is_wanted) else { return first };
        let (Some(covariance), Some(of_plane)) = (first.covariance, found.plane_covariance) else { return first };
        let apart = first.cam_left_from_model.zip(found.pose).map_or([0.0; 3], |(pose, plane)| apart(&pose, &plane));
        let variance = |k: usize| covariance[(PLANE_AXES[k], PLANE_AXES[k])].max(of_plane[(k, k)]) + apart[k].powi(2);
        // A plane was judged by its own limit before.
        let limit_deg = match target.is_curved() {
            true => self.config.tilt_sigma_sure_deg,
            false => self.estimator.config().verdict.normal_sigma_max_deg,
        };
        self.with_variances(first, std::array::from_fn(variance), limit_deg, "the plane of the surface has")
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
        let skew_in_all_s = skew_s.hypot(skew_sigma_s);
        let first = match skew_in_all_s > 0.0 {
            true => {
                let what = "the target may have moved between the exposures, so the tilt has";
                self.with_variances(first, variances_of(skew_in_all_s), self.config.tilt_sigma_sure_deg, what)
            }
            false => first,
        };
        if let Some(target) = &mut self.target {
            target.first_pose_covariance = first.covariance;
            target.first_pose_covariance_at_rest = Some(with_diagonal(covariance, variances_of(skew_sigma_s)));
        }
        let surface = self.target.as_ref().and_then(Target::surface_estimate);
        TrackEstimate { first_pose_covariance: first.covariance, surface, ..first }
    }

    /// A pose with other variances of depth and tilts, and the limit of the latter's standard deviation.
    fn with_variances(
        &self,
        mut first: TrackEstimate,
        variances: [f64; 3],
        limit_deg: f64,
        what_has: &str,
    ) -> TrackEstimate {
        first.covariance = first.covariance.map(|covariance| with_diagonal(covariance, variances));
        let tilt_deg = (variances[1] + variances[2]).sqrt().to_degrees();
        if first.status == Status::Ok {
            let (status, what, end) = match tilt_deg <= limit_deg {
                true => (Status::Ok, "the normal has", ": the tilt is determined"),
                false => (Status::WeakTilt, what_has, ""),
            };
            first.status = status;
            first.reason = format!("{what} a standard deviation of {tilt_deg:.2} degrees (limit {limit_deg:.2}){end}");
        }
        first
    }

    /// Status, and which directions are observed, by the standard deviations of the six directions: of the motion since the first pair. What
    /// that pair itself leaves open is in the reason.
    pub(super) fn judge_covariance(
        &self,
        [covariance, of_first]: [Option<&Matrix6<f64>>; 2],
        distance_m: f64,
        reason: &mut String,
    ) -> (Status, Option<[bool; 6]>) {
        let limit = self.config.tilt_sigma_sure_deg;
        let Some(covariance) = covariance else {
            reason.push_str("the normal's standard deviation is unknown: the tilt is not determined");
            return (Status::WeakTilt, None);
        };
        let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
        let tilt_deg_of = |covariance: &Matrix6<f64>| (covariance[(3, 3)] + covariance[(4, 4)]).sqrt().to_degrees();
        let most = |axis: usize| if axis < 3 { SHIFT_SIGMA_SURE * distance_m } else { limit.to_radians() };
        let observed: [bool; 6] = std::array::from_fn(|axis| sigma(axis) <= most(axis));
        let tilt_deg = tilt_deg_of(covariance);
        let (sure, verb) = if tilt_deg <= limit { (true, "is determined") } else { (false, "is not determined") };
        // Writing into a string cannot fail.
        let _ = write!(
            reason,
            "the normal's standard deviation since the first pair is {tilt_deg:.2} degrees (limit {limit:.2}): the tilt {verb}"
        );
        if let Some(first_deg) = of_first.map(tilt_deg_of).filter(|first_deg| *first_deg > tilt_deg) {
            let _ = write!(reason, "; that of the first pair is {first_deg:.2} degrees");
        }
        let [x, y, depth, _, _, spin] = observed;
        if !(x && y && depth && spin) {
            reason.push_str("; the images do not show");
            for (count, (name, _)) in AXES.iter().zip(observed).filter(|(_, is_observed)| !is_observed).enumerate() {
                let _ = write!(reason, "{} {name}", if count == 0 { "" } else { "," });
            }
        }
        (status_of(observed, sure), Some(observed))
    }
}

/// The status by the directions that are observed, and whether the tilt is sure.
fn status_of([x, y, depth, _, _, spin]: [bool; 6], tilt_is_sure: bool) -> Status {
    match (depth, x && y && spin) {
        (false, false) => Status::Ambiguous,
        (false, true) => Status::WeakDepth,
        (true, false) => Status::PartlyObserved,
        (true, true) if tilt_is_sure => Status::Ok,
        (true, true) => Status::WeakTilt,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_names_what_is_not_observed() {
        let without =
            |axes: &[usize], tilt_is_sure| status_of(std::array::from_fn(|i| !axes.contains(&i)), tilt_is_sure);
        assert_eq!(without(&[], true), Status::Ok);
        assert_eq!(without(&[3, 4], false), Status::WeakTilt);
        assert_eq!([0, 1, 5].map(|axis| without(&[axis], true)), [Status::PartlyObserved; 3]);
        assert_eq!(without(&[2], true), Status::WeakDepth);
        assert_eq!(without(&[2, 3, 4], false), Status::WeakDepth);
        assert_eq!([0, 1, 5].map(|axis| without(&[axis, 2], true)), [Status::Ambiguous; 3]);
    }
}
