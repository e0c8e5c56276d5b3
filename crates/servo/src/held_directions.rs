//! Directions in which the images do not show the target: nothing that is estimated along them moves the hand.
//!
//! What is estimated along such a direction is a guess: it follows the camera, or drifts. The target keeps the place and the turn that it
//! had when they were last seen, in `base`, and an earlier velocity along them ends.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Model};

use crate::target_filter::TargetObservation;

/// Standard deviation of a place and of a turn that are held, metres and radians. Chosen by hand, not varied: as precise as a usual
/// observation, so that an earlier velocity ends within some frames.
const SIGMA_M: f64 = 1e-3;
const SIGMA_RAD: f64 = 0.01;
/// Standard deviations by which what is held may differ from the prediction. Chosen: so that a filter does not refuse it as an outlier.
const SIGMAS_MAX: f64 = 3.0;

/// What was last used of the target's pose.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HeldDirections {
    base_from_model: Option<Pose<Base, Model>>,
    /// The pose when the turn about the normal was last seen. From pose to pose, noise of the tilts would add up to a turn.
    spin_of: Option<Pose<Base, Model>>,
}

impl HeldDirections {
    /// An observation of the pose `measured`, with the last pose along the directions that it does not show; `predicted`: what is
    /// expected at its time.
    pub(crate) fn complete(
        &self,
        measured: &Pose<Base, Model>,
        predicted: Option<&Pose<Base, Model>>,
        observation: &TargetObservation,
    ) -> (Pose<Base, Model>, Option<Matrix6<f64>>) {
        let last = self.base_from_model.filter(|_| observation.observed.contains(&false));
        let spin_of = self.spin_of.filter(|_| !observation.observed[5]);
        let used = last.map_or(*measured, |last| keep_unseen(&last, spin_of.as_ref(), measured, &observation.observed));
        let Some((mut covariance, last)) = observation.covariance.zip(last) else {
            return (used, observation.covariance);
        };
        let ahead = predicted.map_or_else(Default::default, |predicted| (last.inverse() * *predicted).log());
        for axis in (0..6).filter(|&axis| !observation.observed[axis]) {
            let sigma = if axis < 3 { SIGMA_M } else { SIGMA_RAD }.max(ahead[axis].abs() / SIGMAS_MAX);
            covariance.row_mut(axis).fill(0.0);
            covariance.column_mut(axis).fill(0.0);
            covariance[(axis, axis)] = sigma.powi(2);
        }
        (used, Some(covariance))
    }

    /// Remembers a completed pose that was used. One that was refused, such as an outlier, is not what was last seen.
    pub(crate) fn keep(&mut self, used: &Pose<Base, Model>, observation: &TargetObservation) {
        self.base_from_model = Some(*used);
        self.spin_of = self.spin_of.filter(|_| !observation.observed[5]).or(Some(*used));
    }
}

/// The pose `measured`, with place and turn of `last` along the axes of `model` that are not observed, and the turn about the normal of `spin_of`.
fn keep_unseen(
    last: &Pose<Base, Model>,
    spin_of: Option<&Pose<Base, Model>>,
    measured: &Pose<Base, Model>,
    observed: &[bool; 6],
) -> Pose<Base, Model> {
    let shift = last.inverse().transform_vector(&(measured.translation_m() - last.translation_m()));
    let place = last.translation_m() + last.transform_vector(&shown(shift, &observed[..3]));
    // A turn about the normal may be any: the rest of the rotation is the smallest one between the normals.
    let normal = |pose: &Pose<Base, Model>| pose.transform_vector(&Vector3::z());
    let turned = spin_of.and_then(|known| {
        Some(UnitQuaternion::rotation_between(&normal(known), &normal(measured))? * known.rotation())
    });
    // Without a turn the normal points the other way: the observation contradicts what is known, and the filter ignores it.
    let tilted = turned.unwrap_or_else(|| measured.rotation());
    let turn = (last.rotation().inverse() * tilted).scaled_axis();
    Pose::from_parts(
        place,
        last.rotation() * UnitQuaternion::from_scaled_axis(shown(turn, &[observed[3], observed[4], true])),
    )
}

/// The components of a vector that are observed.
fn shown(vector: Vector3<f64>, observed: &[bool]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| if observed[axis] { vector[axis] } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;
    use pb3dp_geometry::MonotonicTime;

    use super::*;

    fn pose(translation: [f64; 3], rotation_vector: [f64; 3]) -> Pose<Base, Model> {
        Pose::from_parts(translation.into(), UnitQuaternion::from_scaled_axis(Vector3::from(rotation_vector)))
    }

    fn observation(observed: [bool; 6]) -> TargetObservation {
        TargetObservation {
            at: MonotonicTime::from_nanos(0),
            cam_left_from_model: Pose::coincident(),
            trusted: true,
            covariance: Some(Matrix6::identity() * 4.0),
            observed,
        }
    }

    fn used(
        held: &mut HeldDirections,
        measured: &Pose<Base, Model>,
        observation: &TargetObservation,
    ) -> (Pose<Base, Model>, Option<Matrix6<f64>>) {
        let (pose, covariance) = held.complete(measured, None, observation);
        held.keep(&pose, observation);
        (pose, covariance)
    }

    #[test]
    fn each_direction_that_is_not_observed_stays_and_the_others_follow() {
        let first = pose([0.7, -0.1, 0.5], [0.4, -1.2, 0.3]);
        for axis in 0..6 {
            let mut held = HeldDirections::default();
            let all = observation([true; 6]);
            assert_eq!(used(&mut held, &first, &all), (first, all.covariance));
            let mut observed = [true; 6];
            observed[axis] = false;
            for step in 1..5 {
                let step = f64::from(step);
                let shift = Vector3::new(0.01, -0.02, 0.015) * step;
                // Turns about several axes do not add up, so one at a time.
                let turn = Vector3::ith(axis % 3, 0.02 * step);
                let measured = Pose::from_parts(shift, UnitQuaternion::from_scaled_axis(turn));
                let (pose, covariance) = used(&mut held, &(first * measured), &observation(observed));
                let moved = first.inverse() * pose;
                assert!((moved.translation_m() - shown(shift, &observed[..3])).norm() < 1e-9, "{axis}: {moved:?}");
                assert!(
                    (moved.rotation().scaled_axis() - shown(turn, &observed[3..])).norm() < 1e-9,
                    "{axis}: {moved:?}"
                );
                let sigma = if axis < 3 { SIGMA_M } else { SIGMA_RAD };
                let covariance = covariance.expect("stated");
                assert!(
                    (covariance[(axis, axis)].sqrt() - sigma).abs() < 1e-12
                        && covariance[((axis + 1) % 6, (axis + 1) % 6)] == 4.0
                );
            }
        }
    }

    #[test]
    fn a_large_spin_leaves_the_tilt() {
        let last = pose([0.7, -0.1, 0.5], [0.4, -1.2, 0.3]);
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.05, -0.08, 0.0));
        let about = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.6));
        let position = Vector3::new(0.71, -0.12, 0.53);
        let mut observed = [true; 6];
        observed[5] = false;
        let used =
            keep_unseen(&last, Some(&last), &Pose::from_parts(position, last.rotation() * tilt * about), &observed);
        // A tilt about an axis in the plane is the smallest rotation to its normal.
        assert!(used.rotation().angle_to(&(last.rotation() * tilt)) < 1e-9, "{used:?}");
        assert!((used.translation_m() - position).norm() < 1e-12);
        let behind = Pose::from_parts(
            position,
            last.rotation() * UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI),
        );
        let normal = |pose: &Pose<Base, Model>| pose.transform_vector(&Vector3::z());
        assert!(normal(&keep_unseen(&last, Some(&last), &behind, &observed)).dot(&normal(&behind)) > 0.999);
    }

    #[test]
    fn noise_of_the_tilts_does_not_add_up_to_a_turn_about_the_normal() {
        let first = pose([0.7, -0.1, 0.5], [0.4, -1.2, 0.3]);
        let (mut held, mut random) = (HeldDirections::default(), pb3dp_computing::rng::SplitMix64::new(3));
        used(&mut held, &first, &observation([true; 6]));
        let hidden = observation([true, true, true, true, true, false]);
        for _ in 0..10_000 {
            let tilt = Vector3::new(random.between(-0.1, 0.1), random.between(-0.1, 0.1), random.between(-0.5, 0.5));
            let measured =
                Pose::from_parts(first.translation_m(), first.rotation() * UnitQuaternion::from_scaled_axis(tilt));
            used(&mut held, &measured, &hidden);
        }
        let (pose, _) = used(&mut held, &first, &hidden);
        assert!(pose.rotation().angle_to(&first.rotation()) < 1e-6, "{pose:?}");
    }

    #[test]
    fn what_is_held_is_no_outlier_where_the_target_moved_before() {
        let first = pose([0.7, -0.1, 0.5], [0.4, -1.2, 0.3]);
        let mut held = HeldDirections::default();
        used(&mut held, &first, &observation([true; 6]));
        let ahead = first * Pose::exp(&Vector6::new(0.03, 0.0, 0.0, 0.0, 0.0, 0.0));
        let hidden = [false, true, true, true, true, true];
        let (used, covariance) = held.complete(&ahead, Some(&ahead), &observation(hidden));
        assert!((used.translation_m() - first.translation_m()).norm() < 1e-12);
        assert!((covariance.expect("stated")[(0, 0)].sqrt() - 0.01).abs() < 1e-9);
    }
}
