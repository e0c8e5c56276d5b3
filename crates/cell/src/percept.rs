//! What the motion half receives for one stereo pair.

use nalgebra::Matrix6;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Model, Surface};
use pb3dp_servo::TargetObservation;
use pb3dp_servo::supervisor::{Confidence, EstimateInput, FrameInput};

/// Result of one stereo pair, with or without a pose.
#[derive(Clone, Copy, Debug)]
pub struct Percept {
    /// Sequence number and time of the pair.
    pub frame: FrameInput,
    /// Confidence of the estimate.
    pub estimate: EstimateInput,
    /// Input of the controller, if there is a pose.
    pub observation: Option<TargetObservation>,
    /// The visible surface beside `model`, if it is known.
    pub surface_from_model: Option<Pose<Surface, Model>>,
}

impl Percept {
    /// Result of a pair in which the estimator follows target number `target`.
    pub fn new(
        frame: FrameInput,
        estimate: &TrackEstimate,
        target: u64,
        observation: Option<TargetObservation>,
    ) -> Self {
        let confidence = confidence(estimate.status, observation.is_some());
        let observation = observation.filter(|_| confidence != Confidence::Miscalibrated);
        let covariance = estimate.pose_covariance.map(|covariance| without_spin(covariance, estimate));
        let input = EstimateInput { at: frame.at, confidence, covariance, target };
        Self {
            frame,
            estimate: input,
            observation,
            surface_from_model: estimate.surface.map(|known| known.surface_from_model),
        }
    }
}

/// A rotation about the normal that nobody sees is not used, so its uncertainty hinders nothing.
fn without_spin(mut covariance: Matrix6<f64>, estimate: &TrackEstimate) -> Matrix6<f64> {
    if !estimate.rotation_about_normal_observed {
        covariance.row_mut(5).fill(0.0);
        covariance.column_mut(5).fill(0.0);
    }
    covariance
}

fn confidence(status: Status, has_pose: bool) -> Confidence {
    match (has_pose, status) {
        (_, Status::Miscalibrated) => Confidence::Miscalibrated,
        (false, _) => Confidence::NoPose,
        (true, status) if status.depth_is_sure() => Confidence::Sure,
        (true, _) => Confidence::Doubtful,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_pose_whose_depth_is_sure_is_confident() {
        for status in [Status::Ok, Status::WeakTilt, Status::PartlyObserved] {
            assert_eq!(confidence(status, true), Confidence::Sure);
        }
        for status in [Status::Ambiguous, Status::NotObservable, Status::Lost, Status::Error] {
            assert_eq!(confidence(status, true), Confidence::Doubtful);
        }
        assert_eq!(confidence(Status::Ok, false), Confidence::NoPose);
        assert_eq!([true, false].map(|has| confidence(Status::Miscalibrated, has)), [Confidence::Miscalibrated; 2]);
    }

    #[test]
    fn only_a_spin_that_nobody_sees_leaves_the_covariance() {
        let covariance = Matrix6::from_fn(|i, j| if i == j { 1.0 + i as f64 } else { 0.1 });
        let blank = TrackEstimate::without_pose(Status::PartlyObserved, String::new());
        let tracked = TrackEstimate { rotation_about_normal_observed: true, ..blank.clone() };
        assert_eq!(without_spin(covariance, &tracked), covariance);
        let left = without_spin(covariance, &blank);
        assert_eq!(left.fixed_view::<5, 5>(0, 0), covariance.fixed_view::<5, 5>(0, 0));
        assert!(left.row(5).norm() == 0.0 && left.column(5).norm() == 0.0);
    }
}
