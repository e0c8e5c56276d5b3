//! Prediction of the target's pose in the next frame.

use nalgebra::Vector3;
use pb3dp_estimation_core::method::{FramePrior, is_plausible_step};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, so3};

/// The last pose and the motion model: constant velocity of the origin and constant angular velocity of the axes, in a frame
/// that does not move with the camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub(super) cam_left_from_model: Pose<CamLeft, Model>,
    /// Metres and radians per unit of time (seconds, or frames if no time is given), in `cam_left`.
    velocity: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Change of the velocity of the origin per unit of time; zero if it is not known.
    acceleration: Vector3<f64>,
    /// Whether the last frame was without the target: its velocity was not measured, so no change follows from it.
    has_coasted: bool,
    /// Mean of the last velocities.
    steady: (Vector3<f64>, Vector3<f64>),
    /// Units of time between the last two frames.
    interval: f64,
}

/// Factor by which the velocity decreases in each frame without the target. Chosen by hand, not varied: after five frames,
/// 8 % remain (0.6^5).
const COASTING: f64 = 0.6;
/// Longest extrapolated interval, as a multiple of the last one. Chosen by hand, not varied: with more, errors of the
/// velocity grow; with less, a target is expected too near after a pause.
const STRETCH_MAX: f64 = 8.0;

/// Longest interval in which the velocity is extrapolated with its change, as a multiple of the last one. Chosen by hand, not varied: one
/// missing frame.
const GAP_MAX: f64 = 2.0;

/// The expected pose in the camera frame of the next exposure.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    pub(super) pose: Pose<CamLeft, Model>,
    /// As `pose`, but with the velocity decreased as in a frame without the target.
    pub(super) coasted: Pose<CamLeft, Model>,
}

/// Share of the newest velocity in the mean of the last ones. Derived: an error of the distance that alternates from frame to frame comes
/// back with 0.67 times the share of the skew in an interval; larger rates amplify it for skews of half an interval, smaller ones lag.
const STEADY_RATE: f64 = 0.5;

/// A share of a motion with constant velocity.
pub(super) fn share_of(motion: &Pose<CamLeft, CamLeft>, share: f64) -> Pose<CamLeft, CamLeft> {
    Pose::exp(&(motion.log() * share.clamp(-1.0, 1.0)))
}

impl Motion {
    pub(super) fn resting(cam_left_from_model: Pose<CamLeft, Model>) -> Self {
        Self {
            cam_left_from_model,
            velocity: None,
            acceleration: Vector3::zeros(),
            has_coasted: false,
            steady: Default::default(),
            interval: 1.0,
        }
    }

    /// Whether a velocity is known.
    pub(super) fn is_known(&self) -> bool {
        self.velocity.is_some()
    }

    /// The pose at the next exposure. A pose that the caller expects is taken as it is.
    pub(super) fn expect(&self, prior: &FramePrior) -> Expected {
        if let Some(pose) = prior.cam_left_from_model.filter(Pose::is_finite) {
            return Expected { pose, coasted: pose };
        }
        let still = prior.cam_left_prev_from_cam_left_now.unwrap_or_else(Pose::coincident).inverse();
        let step = self.step(prior);
        let [pose, coasted] = [1.0, COASTING].map(|share| still * self.advanced(step, share));
        Expected { pose, coasted }
    }

    fn step(&self, prior: &FramePrior) -> f64 {
        prior.dt_s.filter(|dt| *dt > 0.0 && dt.is_finite()).unwrap_or(self.interval)
    }

    /// The pose after a time with this share of the velocity.
    fn advanced(&self, by: f64, share: f64) -> Pose<CamLeft, Model> {
        let Some((linear, angular)) = self.velocity else { return self.cam_left_from_model };
        let by = share * by.min(STRETCH_MAX * self.interval);
        let rotation = so3::exp(&(angular * by)) * self.cam_left_from_model.rotation();
        let rotation = nalgebra::UnitQuaternion::new_normalize(rotation.into_inner());
        Pose::from_parts(self.cam_left_from_model.translation_m() + linear * by, rotation)
    }

    /// Motion of the target in `cam_left` from the left exposure of the next pair to the right one; none if the times are not known.
    pub(super) fn between_exposures(&self, expected: &Expected, prior: &FramePrior) -> Pose<CamLeft, CamLeft> {
        let Some(step) = prior.dt_s.filter(|_| prior.skew_s != 0.0) else { return Pose::coincident() };
        let now_from_prev = prior.cam_left_prev_from_cam_left_now.unwrap_or_else(Pose::coincident).inverse();
        let of_camera = share_of(&now_from_prev, prior.skew_s / step);
        // The velocity is that of the middle of the last interval.
        let ahead = if step > GAP_MAX * self.interval { 0.0 } else { 0.5 * (self.interval + prior.skew_s) + step };
        self.moved(&expected.pose, (ahead, prior.skew_s), [&of_camera, &now_from_prev])
    }

    /// As [`Self::between_exposures`] for the pair whose left image shows this pose: its own motion is known better than it was foreseen.
    pub(super) fn between_tracked_exposures(
        &self,
        found: &Pose<CamLeft, Model>,
        prior: &FramePrior,
    ) -> Option<Pose<CamLeft, CamLeft>> {
        let step = prior.dt_s.filter(|step| prior.skew_s != 0.0 && *step <= GAP_MAX * self.interval)?;
        self.velocity.filter(|_| !self.has_coasted)?;
        let now_from_prev = prior.cam_left_prev_from_cam_left_now.unwrap_or_else(Pose::coincident).inverse();
        let of_camera = share_of(&now_from_prev, prior.skew_s / step);
        let mut learnt = *self;
        learnt.learn(found, prior);
        let ahead = 0.5 * (step + prior.skew_s);
        Some(learnt.moved(found, (ahead, prior.skew_s), [&of_camera, &Pose::coincident()]))
    }

    /// Motion of a target at this pose in a time, that long after the middle of the last interval.
    fn moved(
        &self,
        pose: &Pose<CamLeft, Model>,
        (ahead, duration): (f64, f64),
        [of_camera, now_from_prev]: [&Pose<CamLeft, CamLeft>; 2],
    ) -> Pose<CamLeft, CamLeft> {
        let Some((linear, angular)) = self.velocity else { return *of_camera };
        // The left image shows motions across the ray best. Errors of the distance and of the tilts come back in the next frame, and would
        // grow if they were extrapolated.
        let ray = now_from_prev.inverse().transform_vector(&pose.translation_m().normalize());
        let along = |vector: Vector3<f64>| ray * ray.dot(&vector);
        let across = |vector: Vector3<f64>| vector - along(vector);
        let shift = across(linear + self.acceleration * ahead) + along(self.steady.0);
        let turn = along(angular) + across(self.steady.1);
        let [shift, turn] = [shift, turn].map(|velocity| now_from_prev.transform_vector(&(velocity * duration)));
        let later = Pose::from_parts(pose.translation_m() + shift, so3::exp(&turn) * pose.rotation());
        let motion = *of_camera * later * pose.inverse();
        if is_plausible_step(&motion) { motion } else { Pose::coincident() }
    }

    /// Updates the motion with the estimated pose.
    pub(super) fn learn(&mut self, found: &Pose<CamLeft, Model>, prior: &FramePrior) {
        let step = self.step(prior);
        let prev_from_now = prior.cam_left_prev_from_cam_left_now.unwrap_or_else(Pose::coincident);
        let in_prev = prev_from_now * *found;
        let linear = (in_prev.translation_m() - self.cam_left_from_model.translation_m()) / step;
        let angular = so3::log(&(in_prev.rotation() * self.cam_left_from_model.rotation().inverse())) / step;
        let turn = prev_from_now.rotation().inverse();
        let measured = self.velocity.filter(|_| !self.has_coasted);
        self.acceleration =
            measured.map_or_else(Vector3::zeros, |(was, _)| turn * (linear - was) / (0.5 * (step + self.interval)));
        self.has_coasted = false;
        let mean = |was: Vector3<f64>, is: Vector3<f64>| turn * (was + (is - was) * STEADY_RATE);
        self.steady = match self.velocity {
            Some(_) => (mean(self.steady.0, linear), mean(self.steady.1, angular)),
            None => (turn * linear, turn * angular),
        };
        self.velocity = Some((turn * linear, turn * angular));
        (self.cam_left_from_model, self.interval) = (*found, step);
    }

    /// The target was not found: the prediction continues with decreasing velocity.
    pub(super) fn coast(&mut self, prior: &FramePrior) {
        let (found, step) = (self.expect(prior).pose, self.step(prior));
        let now_from_prev = prior.cam_left_prev_from_cam_left_now.unwrap_or_else(Pose::coincident).inverse().rotation();
        self.velocity = self
            .velocity
            .map(|(linear, angular)| (now_from_prev * linear * COASTING, now_from_prev * angular * COASTING));
        (self.acceleration, self.has_coasted) = (Vector3::zeros(), true);
        self.steady = self.velocity.unwrap_or_default();
        (self.cam_left_from_model, self.interval) = (found, step);
    }

    /// The target was found again: its pose is known, its velocity is not.
    pub(super) fn restart(&mut self, found: &Pose<CamLeft, Model>) {
        *self = Self { interval: self.interval, ..Self::resting(*found) };
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector6};
    use pb3dp_geometry::frames::World;

    use super::*;

    fn pose() -> Pose<CamLeft, Model> {
        Pose::exp(&Vector6::new(0.05, -0.02, 0.5, 0.2, -0.3, 0.5))
    }

    #[test]
    fn a_screw_about_the_origin_is_foretold_with_any_time_step() {
        let at = |t: f64| {
            let turn = so3::exp(&(Vector3::new(0.4, -0.2, 0.9) * t));
            Pose::from_parts(pose().translation_m() + Vector3::new(0.3, 0.1, -0.2) * t, turn * pose().rotation())
        };
        let mut motion = Motion::resting(at(0.0));
        let prior = |dt_s| FramePrior { dt_s: Some(dt_s), ..FramePrior::default() };
        motion.learn(&at(0.04), &prior(0.04));
        let error = at(0.14).inverse() * motion.expect(&prior(0.10)).pose;
        assert!(error.log().norm() < 1e-9, "{error:?}");
    }

    #[test]
    fn the_motion_between_the_exposures_is_extrapolated_with_its_change() {
        // The target swings and the camera moves evenly; the right camera exposes 5 ms later.
        let camera_at = |t: f64| Pose::<World, CamLeft>::exp(&(Vector6::new(0.1, -0.05, 0.08, 0.2, -0.1, 0.3) * t));
        let target_at = |t: f64| {
            let turn = so3::exp(&(Vector3::new(0.4, -0.2, 0.9) * (1.5 * t).sin()));
            let at = pose().translation_m() + Vector3::new(0.05, 0.03, -0.02) * (1.5 * t).sin();
            Pose::<World, Model>::from_parts(at, turn * pose().rotation())
        };
        let pose_at = |t: f64| camera_at(t).inverse() * target_at(t);
        let (dt, skew_s) = (1.0 / 30.0, 0.005);
        let prior_at = |t: f64| FramePrior {
            dt_s: Some(dt),
            cam_left_prev_from_cam_left_now: Some(camera_at(t - dt).inverse() * camera_at(t)),
            skew_s,
            ..FramePrior::default()
        };
        let mut motion = Motion::resting(pose_at(0.0));
        for frame in 1..3 {
            let t = f64::from(frame) * dt;
            motion.learn(&pose_at(t), &prior_at(t));
        }
        let expected = motion.expect(&prior_at(3.0 * dt));
        let found = motion.between_exposures(&expected, &prior_at(3.0 * dt));
        let truth = pose_at(3.0 * dt + skew_s) * pose_at(3.0 * dt).inverse();
        let point = Point3::from(pose_at(3.0 * dt).translation_m());
        let [shift, whole] = [found, truth].map(|motion| motion.transform_point(&point) - point);
        // 0.5 mm; without the change of the velocity 1 % of it would be missing.
        assert!(whole.norm() > 3e-4 && (shift - whole).norm() < 3e-3 * whole.norm(), "{shift} {whole}");
        assert!((found.inverse() * truth).rotation_angle_rad() < 0.02 * truth.rotation_angle_rad());
        let none = FramePrior { dt_s: None, ..prior_at(0.1) };
        assert!(motion.between_exposures(&expected, &none).log().norm() == 0.0, "no time, no motion");
    }

    #[test]
    fn a_frame_without_the_target_is_no_change_of_its_velocity() {
        let at = |t: f64| Pose::from_parts(pose().translation_m() + Vector3::new(0.1, 0.0, 0.0) * t, pose().rotation());
        let prior = FramePrior { dt_s: Some(0.04), ..FramePrior::of_skew(0.005) };
        let mut motion = Motion::resting(at(0.0));
        motion.learn(&at(0.04), &prior);
        motion.coast(&prior);
        motion.learn(&at(0.12), &prior);
        let between = motion.between_exposures(&motion.expect(&prior), &prior);
        assert!((between.translation_m() - Vector3::new(0.1, 0.0, 0.0) * 0.005).norm() < 2e-5, "{between:?}");
    }

    #[test]
    fn known_motion_of_the_camera_is_taken_out() {
        let prev_from_now: Pose<CamLeft, CamLeft> = Pose::exp(&Vector6::new(0.01, 0.02, -0.01, 0.03, -0.02, 0.04));
        let prior = FramePrior { cam_left_prev_from_cam_left_now: Some(prev_from_now), ..FramePrior::default() };
        let mut motion = Motion::resting(pose());
        let second = prev_from_now.inverse() * pose();
        assert!((motion.expect(&prior).pose.inverse() * second).log().norm() < 1e-12);
        motion.learn(&second, &prior);
        // A stationary target has no velocity of its own while the camera moves.
        let third = prev_from_now.inverse() * second;
        assert!((motion.expect(&prior).pose.inverse() * third).log().norm() < 1e-12);
    }

    #[test]
    fn a_coasted_pose_is_behind_the_expected_one_and_a_given_pose_is_taken_as_it_is() {
        let at = |x_m: f64| Pose::from_parts(pose().translation_m() + Vector3::new(x_m, 0.0, 0.0), pose().rotation());
        let mut motion = Motion::resting(at(0.0));
        motion.learn(&at(0.010), &FramePrior::default());
        let Expected { pose: expected, coasted } = motion.expect(&FramePrior::default());
        assert!((at(0.020).inverse() * expected).log().norm() < 1e-9);
        assert!((at(0.010 + COASTING * 0.010).inverse() * coasted).log().norm() < 1e-9);
        let given = FramePrior { cam_left_from_model: Some(at(0.5)), ..FramePrior::default() };
        let Expected { pose: expected, coasted } = motion.expect(&given);
        assert!((expected.inverse() * coasted).log().norm() < 1e-12);
    }

    #[test]
    fn ten_thousand_predictions_stay_a_rigid_motion() {
        let mut motion = Motion::resting(pose());
        let prior = FramePrior::default();
        for frame in 0..10_000 {
            let wobble = Vector6::new(1e-4, -2e-4, 1e-4, 0.01, 0.02, -0.015) * f64::from(frame % 7);
            let found = motion.expect(&prior).pose.perturbed_in_from(&(wobble * 0.1));
            motion.learn(&found, &prior);
            if frame % 50 == 49 {
                motion.restart(&pose());
            }
        }
        let rotation = motion.cam_left_from_model.rotation_matrix();
        assert!((rotation * rotation.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-12);
        assert!((motion.cam_left_from_model.rotation().norm() - 1.0).abs() < 1e-12);
    }
}
