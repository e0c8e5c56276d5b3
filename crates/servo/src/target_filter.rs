//! Smoothed pose of the target in `base`: observations are gated and low-pass filtered, and held between frames.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{Base, CamLeft, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose, Twist};

use crate::config::TargetFilterConfig;
use crate::joint_history::NotInHistory;

/// Output of the estimator for one frame pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetObservation {
    /// Midpoint of the left exposure.
    pub at: MonotonicTime,
    /// Pose of the model in the left camera. A component that the method does not observe (the rotation about the normal in the
    /// published method) stays constant.
    pub cam_left_from_model: Pose<CamLeft, Model>,
    /// Whether the depth is confident; other observations are not used.
    pub trusted: bool,
    /// Covariance of `xi = [rho; phi]` (metres, radians; axes of `model`) in `true = cam_left_from_model * exp(xi)`; `None` if the
    /// method has none.
    pub covariance: Option<Matrix6<f64>>,
    /// Whether the images show each direction: shifts along x, y, z of `model`, and turns about them. What is not shown follows the hand or
    /// drifts; used as a measurement, it would make the hand follow itself.
    pub observed: [bool; 6],
}

/// What happened to the newest observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObservationVerdict {
    /// There is none, or it was already handled.
    NoneNew,
    /// Accepted into the pose of the target.
    Accepted,
    /// The estimator has low confidence.
    Untrusted,
    /// It contains a number that is not finite.
    NotFinite,
    /// The exposure is older than the observation time-out, or in the future.
    WrongTime {
        /// Age of the exposure, seconds.
        age_s: f64,
    },
    /// The joints at the time of exposure are unknown.
    JointsUnknown(NotInHistory),
    /// Too far from the pose of the target.
    Jump {
        /// Distance, metres.
        position_m: f64,
        /// Angle, radians.
        orientation_rad: f64,
    },
    /// Too far from the predicted pose.
    Outlier {
        /// Squared Mahalanobis distance of its six components.
        distance_squared: f64,
    },
    /// The covariance is invalid: not finite, not symmetric, or negative.
    BadCovariance,
}

/// The target in `base` at the time of the last accepted observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetTrack {
    base_from_model: Pose<Base, Model>,
    twist: Twist<Base>,
    observed_at: MonotonicTime,
    observations: u32,
}

impl TargetTrack {
    /// Starts from a first observation.
    pub fn begin(base_from_model: Pose<Base, Model>, observed_at: MonotonicTime) -> Self {
        Self { base_from_model, twist: Twist::zero(), observed_at, observations: 1 }
    }

    /// Smoothed pose.
    pub fn base_from_model(&self) -> &Pose<Base, Model> {
        &self.base_from_model
    }

    /// Time of the last accepted exposure.
    pub fn observed_at(&self) -> MonotonicTime {
        self.observed_at
    }

    /// Number of accepted observations.
    pub fn observations(&self) -> u32 {
        self.observations
    }

    /// Desired pose of the hand.
    pub fn base_from_hand_desired(&self, model_from_hand_desired: &Pose<Model, Hand>) -> Pose<Base, Hand> {
        self.base_from_model * *model_from_hand_desired
    }

    /// Velocity of the desired hand's origin and its angular velocity, in `base`, from differences of the smoothed pose.
    pub fn hand_desired_twist(&self, model_from_hand_desired: &Pose<Model, Hand>) -> Twist<Base> {
        let lever = self.base_from_model.transform_vector(&model_from_hand_desired.translation_m());
        let angular = self.twist.angular_rad_per_s;
        Twist::new(self.twist.linear_m_per_s + angular.cross(&lever), angular)
    }

    /// Adds an observation that passes the gate. A jump before the target is initialised restarts the initialisation.
    pub fn update(
        &mut self,
        config: &TargetFilterConfig,
        observed: &Pose<Base, Model>,
        at: MonotonicTime,
    ) -> ObservationVerdict {
        let shift = observed.translation_m() - self.base_from_model.translation_m();
        let turn = (observed.rotation() * self.base_from_model.rotation().inverse()).scaled_axis();
        let (position_m, orientation_rad) = (shift.norm(), turn.norm());
        let jumped = position_m > config.gate_position_m || orientation_rad > config.gate_orientation_rad;
        if jumped && self.is_locked(config) {
            return ObservationVerdict::Jump { position_m, orientation_rad };
        }
        if jumped {
            *self = Self::begin(*observed, at);
            return ObservationVerdict::Accepted;
        }
        let dt_s = at.seconds_since(self.observed_at);
        self.observations = self.observations.saturating_add(1);
        let mean = 1.0 / f64::from(self.observations);
        let shift = shift * share(dt_s, config.position_time_constant_s).max(mean);
        let turn = turn * share(dt_s, config.orientation_time_constant_s).max(mean);
        self.advance(shift, turn, dt_s);
        self.observed_at = at;
        ObservationVerdict::Accepted
    }

    /// Whether enough consistent observations were accepted.
    pub fn is_locked(&self, config: &TargetFilterConfig) -> bool {
        self.observations >= config.observations_to_lock
    }

    fn advance(&mut self, shift: Vector3<f64>, turn: Vector3<f64>, dt_s: f64) {
        let mut rotation = UnitQuaternion::from_scaled_axis(turn) * self.base_from_model.rotation();
        rotation.renormalize();
        self.base_from_model = Pose::from_parts(self.base_from_model.translation_m() + shift, rotation);
        self.twist = if dt_s > 0.0 { Twist::new(shift / dt_s, turn / dt_s) } else { Twist::zero() };
    }
}

/// Share of the difference that a first-order low-pass filter applies in `dt_s`.
fn share(dt_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { 1.0 - (-dt_s / time_constant_s).exp() } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: TargetFilterConfig = TargetFilterConfig {
        position_time_constant_s: 0.1,
        orientation_time_constant_s: 0.3,
        gate_position_m: 0.2,
        gate_orientation_rad: 0.5,
        observations_to_lock: 3,
    };

    fn at(millis: u64) -> MonotonicTime {
        MonotonicTime::from_nanos(millis * 1_000_000)
    }

    fn pose(x_m: f64, turn_rad: f64) -> Pose<Base, Model> {
        let axis = Vector3::new(2.0, -1.0, 2.0) / 3.0;
        Pose::from_parts(Vector3::new(x_m, 0.3, -0.2), UnitQuaternion::from_scaled_axis(axis * turn_rad))
    }

    #[test]
    fn the_first_observations_are_averaged() {
        let mut track = TargetTrack::begin(pose(0.0, 0.0), at(0));
        for (millis, x) in [(1, 0.03), (2, 0.06), (3, 0.03)] {
            assert_eq!(track.update(&CONFIG, &pose(x, x), at(millis)), ObservationVerdict::Accepted);
        }
        assert!((track.base_from_model().translation_m().x - 0.03).abs() < 1e-12, "{track:?}");
        assert!((track.base_from_model().rotation_angle_rad() - 0.03).abs() < 1e-12);
        assert_eq!(track.observations(), 4);
    }

    #[test]
    fn a_step_is_followed_with_the_two_time_constants() {
        let mut track = TargetTrack::begin(pose(0.0, 0.0), at(0));
        let mut millis = 0;
        for _ in 0..1000 {
            millis += 10;
            track.update(&CONFIG, &pose(0.0, 0.0), at(millis));
        }
        for _ in 0..30 {
            millis += 10;
            track.update(&CONFIG, &pose(0.1, 0.4), at(millis));
        }
        let position = track.base_from_model().translation_m().x;
        assert!((position - 0.1 * (1.0 - (-3f64).exp())).abs() < 1e-9, "{position}");
        let angle = track.base_from_model().rotation_angle_rad();
        assert!((angle - 0.4 * (1.0 - (-1f64).exp())).abs() < 1e-9, "{angle}");
    }

    #[test]
    fn a_jump_is_refused_once_locked_and_begins_anew_before() {
        let mut track = TargetTrack::begin(pose(0.0, 0.0), at(0));
        assert_eq!(track.update(&CONFIG, &pose(0.5, 0.0), at(33)), ObservationVerdict::Accepted);
        assert_eq!((track.observations(), track.base_from_model().translation_m().x), (1, 0.5));
        track.update(&CONFIG, &pose(0.5, 0.0), at(66));
        track.update(&CONFIG, &pose(0.5, 0.0), at(100));
        let before = track;
        let verdict = track.update(&CONFIG, &pose(0.5, 0.6), at(133));
        assert!(
            matches!(verdict, ObservationVerdict::Jump { position_m, orientation_rad }
            if position_m < 1e-12 && (orientation_rad - 0.6).abs() < 1e-12),
            "{verdict:?}"
        );
        let verdict = track.update(&CONFIG, &pose(0.75, 0.0), at(133));
        assert!(matches!(verdict, ObservationVerdict::Jump { .. }), "{verdict:?}");
        assert_eq!(track, before);
    }

    #[test]
    fn without_smoothing_the_twist_of_the_desired_hand_is_that_of_a_rigid_body() {
        let config = TargetFilterConfig { position_time_constant_s: 0.0, orientation_time_constant_s: 0.0, ..CONFIG };
        let model_from_hand = Pose::<Model, Hand>::from_parts(
            Vector3::new(0.02, -0.03, -0.5),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, -0.3)),
        );
        let mut track = TargetTrack::begin(pose(0.0, 0.0), at(0));
        track.update(&config, &pose(1e-4, 2e-4), at(1));
        let before = track.base_from_hand_desired(&model_from_hand);
        track.update(&config, &pose(2e-4, 4e-4), at(2));
        let after = track.base_from_hand_desired(&model_from_hand);
        let twist = track.hand_desired_twist(&model_from_hand);
        let linear = (after.translation_m() - before.translation_m()) / 1e-3;
        let angular = (after.rotation() * before.rotation().inverse()).scaled_axis() / 1e-3;
        assert!((twist.linear_m_per_s - linear).norm() < 1e-4, "{twist:?} {linear}");
        assert!((twist.angular_rad_per_s - angular).norm() < 1e-9, "{twist:?} {angular}");
        assert!((angular.norm() - 0.2).abs() < 1e-9);
    }
}
