//! A control cycle never allocates.
#![allow(clippy::unwrap_used)] // In helpers of tests.

use crate::common::{Cell, IDEAL, config, feed_forward, feed_forward_config, rotation};
use nalgebra::Vector3;
use pb3dp_allocation_count::requests;
use pb3dp_servo::{ArmResponse, ControllerConfig};

#[test]
fn steps_do_not_allocate() {
    steps_without_allocation(config());
    steps_without_allocation(feed_forward_config(feed_forward(ArmResponse { delay_s: 0.02, lag_s: 0.03 })));
}

fn steps_without_allocation(config: ControllerConfig) {
    let mut cell = Cell::new(config, IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.05, -0.04, 0.03), rotation(0.1, 0.2, -0.1));
    let mut calls = 0;
    for _ in 0..1000 {
        let observation = cell.observe(&target);
        let before = requests();
        let step = cell.controller.step(&cell.joints, Some(&observation), cell.now());
        calls += requests() - before;
        assert!(step.position_error_m.is_some());
        cell.step_controller();
    }
    assert_eq!(calls, 0);
    let probe = requests();
    drop(std::hint::black_box(Box::new([0u8; 64])));
    assert!(requests() > probe, "the allocation counter works");
}
