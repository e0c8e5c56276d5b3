//! Commands of the controller that did not reach the arm.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use crate::common::{Cell, IDEAL, config, rotation};
use nalgebra::Vector3;
use pb3dp_servo::{Command, ControlStep};

fn speed(step: &ControlStep) -> f64 {
    let Command::Velocity(velocity) = step.command else { panic!("{}", step.mode) };
    velocity.amax()
}

/// The time in which no command reached the arm does not count for the soft start.
#[test]
fn a_hand_that_was_kept_at_rest_starts_softly() {
    let mut config = config();
    config.speed.soft_start_s = 0.5;
    let mut cell = Cell::new(config, IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.05, -0.04, 0.03), rotation(0.1, 0.2, -0.1));
    let resting = cell.joints;
    for _ in 0..500 {
        cell.step(&target);
        cell.controller.set_executed_command(Command::Hold);
        cell.joints = pb3dp_kinematics::JointState { at: cell.now(), ..resting };
    }
    let first = cell.step(&target);
    assert!(speed(&first) < 1e-9, "{} rad/s in the first step", speed(&first));
    for _ in 0..250 {
        cell.step(&target);
    }
    assert!(speed(&cell.step(&target)) > 0.05);
}
