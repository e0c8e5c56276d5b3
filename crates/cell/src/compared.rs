//! Compared methods: they process the same pairs as the leading method, without influence on the hand.

use std::time::Instant;

use anyhow::Result;
use nalgebra::Vector3;
use pb3dp_estimation::estimator::{FramePrior, Method};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_hal_api::FramePair;
use pb3dp_setup::setup::Setup;

use super::log::{FrameSample, MethodLog};
use crate::follower::Follower;
use crate::perception::NOT_SELECTED;
use crate::true_surface::true_model_frame;

/// One compared method.
pub struct ComparedMethod {
    method: Method,
    follower: Follower,
    has_target: bool,
    log: MethodLog,
}

impl ComparedMethod {
    /// The methods that a setup compares with the leading one.
    ///
    /// # Errors
    /// A method parameter out of its range.
    pub fn all_of(setup: &Setup) -> Result<Vec<Self>> {
        let onlooker = |&method: &Method| {
            let follower = Follower::of_setup(setup, method)?;
            Ok(Self { method, follower, has_target: false, log: MethodLog::new(method) })
        };
        setup.compared.iter().map(onlooker).collect()
    }

    /// Processes a pair: the first one with the operator's region, later ones with the known camera motion. Its errors are recorded and do
    /// not affect the run. Pairs before the first region are left out: a recording may begin in the middle of a run.
    pub fn look(&mut self, pair: &FramePair, frame: &Frame<'_>) {
        self.has_target |= frame.region.is_some();
        if !self.has_target {
            return;
        }
        let started = Instant::now();
        let outcome = self.follower.look(&pair.left, &pair.right, frame.region, frame.prior, &mut || true);
        let latency_millis = started.elapsed().as_secs_f64() * 1e3;
        let estimate = outcome.unwrap_or_else(|error| {
            tracing::warn!("compared method {}: {error}", self.method);
            TrackEstimate::without_pose(Status::Error, error.to_string())
        });
        self.log.push(frame, &estimate, latency_millis);
    }

    /// The recorded estimates.
    pub fn into_log(self) -> MethodLog {
        self.log
    }
}

/// Status word in the results of a run for frames before a target is selected: nothing is lost in them.
pub const NO_TARGET: &str = "no-target";

/// One pair with the information about it.
pub struct Frame<'a> {
    /// Seconds since the experiment began.
    pub t_s: f64,
    /// The operator's region, in the first pair.
    pub region: Option<&'a Region>,
    /// Prior information: camera motion since the previous pair from the joints, and the time.
    pub prior: &'a FramePrior,
    /// The true pose, if there is one.
    pub cam_left_from_target: Option<Pose<CamLeft, Target>>,
    /// The true plane of the target, if there is one.
    pub cam_left_from_plane: Option<Pose<CamLeft, Model>>,
    /// Age of the leading method's estimate when the controller receives it, milliseconds.
    pub age_millis: Option<f64>,
}

/// Depth error (metres, on the ray of the estimated origin) and angle between the normals (radians) of an estimate.
pub fn plane_errors(estimate: &TrackEstimate, cam_left_from_plane: &Pose<CamLeft, Model>) -> Option<(f64, f64)> {
    let pose = estimate.cam_left_from_model?;
    let truth = true_model_frame(&pose, cam_left_from_plane)?;
    let normals = [&pose, &truth].map(|pose| pose.transform_vector(&Vector3::z()));
    Some((pose.translation_m().z - truth.translation_m().z, normals[0].angle(&normals[1])))
}

impl MethodLog {
    fn new(method: Method) -> Self {
        Self { method: method.name().to_owned(), ..Self::default() }
    }

    /// Records the estimate of a frame.
    pub fn push(&mut self, frame: &Frame<'_>, estimate: &TrackEstimate, latency_millis: f64) {
        let errors = frame.cam_left_from_plane.as_ref().and_then(|truth| plane_errors(estimate, truth));
        self.rotation_about_normal_observed |= estimate.rotation_about_normal_observed;
        self.estimated.push(estimate.cam_left_from_model);
        self.truth.extend(frame.cam_left_from_target.as_ref().map(Pose::relabel));
        self.frames.push(FrameSample {
            t_s: frame.t_s,
            status: match estimate.reason.as_str() {
                NOT_SELECTED => NO_TARGET.to_owned(),
                _ => estimate.status.to_string(),
            },
            fitness: estimate.fitness,
            depth_error_m: errors.map(|(depth_m, _)| depth_m),
            normal_error_rad: errors.map(|(_, normal_rad)| normal_rad),
            latency_millis,
            age_millis: frame.age_millis,
            covariance: estimate.covariance,
            pose_covariance: estimate.pose_covariance,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_before_a_selection_are_not_lost() {
        let mut log = MethodLog::new(Method::Direct);
        let prior = FramePrior::default();
        let frame = Frame {
            t_s: 0.0,
            region: None,
            prior: &prior,
            cam_left_from_target: None,
            cam_left_from_plane: None,
            age_millis: None,
        };
        for reason in [NOT_SELECTED, "out of sight"] {
            log.push(&frame, &TrackEstimate::without_pose(Status::Lost, reason.to_owned()), 1.0);
        }
        let statuses: Vec<_> = log.frames.iter().map(|frame| frame.status.as_str()).collect();
        assert_eq!(statuses, [NO_TARGET, "lost"]);
    }
}
