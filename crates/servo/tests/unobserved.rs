//! Directions that the images do not show: whatever is estimated along them, the hand does not move there.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use nalgebra::{Vector3, Vector6};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_servo::{ArmResponse, ControllerConfig, Mode, ObservationVerdict};

use crate::common::{Cell, Plant, config, feed_forward, feed_forward_config, rotation};

const PLANT: Plant = Plant { delay_steps: 10, lag_s: 0.03 };
const ARM: ArmResponse = ArmResponse { delay_s: 0.02, lag_s: 0.03 };
const LATENCY_S: f64 = 0.05;
/// Velocities along and about an axis, metres and radians per second.
const DRIFT: [f64; 6] = [0.04, -0.05, 0.045, 0.15, -0.12, 0.2];

fn configs() -> [ControllerConfig; 2] {
    [feed_forward_config(feed_forward(ARM)), config()]
}

fn drifted(pose: &Pose<Base, Model>, axis: usize, by: f64) -> Pose<Base, Model> {
    *pose * Pose::exp(&Vector6::from_fn(|k, _| if k == axis { by } else { 0.0 }))
}

/// Distance (m) and angle (rad) between the hand and its desired pose at a target.
fn off(cell: &Cell, target: &Pose<Base, Model>) -> (f64, f64) {
    let (desired, hand): (Pose<Base, Hand>, _) = (*target * cell.config.model_from_hand_desired, cell.base_from_hand());
    ((desired.translation_m() - hand.translation_m()).norm(), desired.rotation().angle_to(&hand.rotation()))
}

/// A cell whose hand has arrived at a target at rest.
fn arrived(config: ControllerConfig) -> (Cell, Pose<Base, Model>) {
    let mut cell = Cell::new(config, PLANT, LATENCY_S);
    let home = cell.target_for_hand_moved(Vector3::zeros(), rotation(0.0, 0.0, 0.0));
    for _ in 0..1500 {
        cell.step(&home);
    }
    assert_eq!(cell.step(&home).mode, Mode::Tracking);
    (cell, home)
}

#[test]
fn what_drifts_along_a_direction_that_is_not_observed_does_not_move_the_hand() {
    for (config, axis) in configs().into_iter().flat_map(|config| (0..6).map(move |axis| (config, axis))) {
        let (mut cell, home) = arrived(config);
        cell.observed[axis] = false;
        for step in 0..1000 {
            cell.step(&drifted(&home, axis, DRIFT[axis] * 0.002 * f64::from(step)));
            let (position_m, angle_rad) = off(&cell, &home);
            assert!(position_m < 1e-3 && angle_rad < 2e-3, "axis {axis}: {position_m} m, {angle_rad} rad");
        }
        // The same drift moves the hand if it is seen.
        cell.observed[axis] = true;
        for _ in 0..1000 {
            cell.step(&drifted(&home, axis, 2.0 * DRIFT[axis]));
        }
        let (position_m, angle_rad) = off(&cell, &home);
        assert!(position_m > 0.02 || angle_rad > 0.1, "axis {axis}: {position_m} m, {angle_rad} rad");
    }
}

#[test]
fn the_hand_follows_along_the_other_directions() {
    for (config, axis) in configs().into_iter().flat_map(|config| (0..6).map(move |axis| (config, axis))) {
        let (mut cell, home) = arrived(config);
        cell.observed[axis] = false;
        let other = (axis + 1) % 6;
        let moved = drifted(&home, other, 0.5 * DRIFT[other]);
        for _ in 0..2000 {
            cell.step(&moved);
        }
        let (position_m, angle_rad) = off(&cell, &moved);
        assert!(position_m < 2e-3 && angle_rad < 4e-3, "axis {axis}: {position_m} m, {angle_rad} rad");
    }
}

#[test]
fn a_velocity_ends_where_its_direction_is_no_longer_observed() {
    for (axis, velocity) in DRIFT.into_iter().enumerate() {
        let (mut cell, home) = arrived(feed_forward_config(feed_forward(ARM)));
        let at = |step: i32| drifted(&home, axis, velocity * 0.002 * f64::from(step));
        for step in 0..800 {
            cell.step(&at(step));
        }
        cell.observed[axis] = false;
        for step in 800..1800 {
            cell.step(&at(step));
        }
        let place = cell.base_from_hand();
        for step in 1800..2800 {
            cell.step(&at(step));
        }
        let moved = place.inverse() * cell.base_from_hand();
        assert!(moved.translation_m().norm() < 1e-3 && moved.rotation_angle_rad() < 2e-3, "axis {axis}: {moved:?}");
        let (position_m, angle_rad) = off(&cell, &at(800));
        assert!(position_m < 0.01 && angle_rad < 0.02, "axis {axis}: {position_m} m, {angle_rad} rad after it");
    }
}

/// An outlier is refused, and so is not where the target was last seen.
#[test]
fn an_outlier_before_a_direction_is_hidden_does_not_move_the_hand() {
    for axis in 0..6 {
        let (mut cell, home) = arrived(feed_forward_config(feed_forward(ARM)));
        let mut refused = false;
        let far = drifted(&home, axis, if axis < 3 { 0.05 } else { 0.2 });
        // The time between two exposures.
        for _ in 0..17 {
            cell.step(&far);
        }
        cell.observed[axis] = false;
        for _ in 0..1500 {
            let step = cell.step(&home);
            refused |= matches!(step.observation, ObservationVerdict::Outlier { .. });
            let (position_m, angle_rad) = off(&cell, &home);
            assert!(position_m < 1e-3 && angle_rad < 2e-3, "axis {axis}: {position_m} m, {angle_rad} rad");
        }
        assert!(refused, "axis {axis}");
    }
}
