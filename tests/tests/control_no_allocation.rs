//! A control step of a run, with the full chain of both arms, does not allocate.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use nalgebra::Matrix6;
use pb3dp_allocation_count::requests;
use pb3dp_cell::halves::Mover;
use pb3dp_cell::moving::Moving;
use pb3dp_cell::parts::Parts;
use pb3dp_cell::percept::Percept;
use pb3dp_servo::supervisor::{Confidence, EstimateInput, FrameInput, Permission};
use pb3dp_servo::{Mode, TargetObservation};
use pb3dp_setup::setup::read_setup;
use pb3dp_wiring::wire;
use system_tests::repository;

/// Steps after which every ring is full: more than the joint history and the flight recorder hold.
const WARM_UP: usize = 2500;
const COUNTED: usize = 1000;

#[test]
fn control_steps_of_both_arms_do_not_allocate() {
    let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    setup.compared.clear();
    let Parts { clock, vs, tc, cell, experiment, .. } = wire(&setup).unwrap();
    let mut moving = Moving::new(&setup, (vs, tc), &*experiment, clock.now()).unwrap();
    assert!(moving.enable().unwrap());
    let (mut calls, mut followed) = (0, 0);
    for step in 0..WARM_UP + COUNTED {
        let now = clock.now() + setup.control_period;
        clock.sleep_until(now);
        // An error-free observation of a model whose frame is the target's.
        let cam_left_from_target = cell.world_from_cam_left_at(now).inverse() * cell.world_from_target_at(now);
        let observation = TargetObservation {
            at: now,
            cam_left_from_model: cam_left_from_target.relabel(),
            trusted: true,
            covariance: Some(Matrix6::from_diagonal_element(1e-8)),
            observed: [true; 6],
        };
        let percept = Percept {
            frame: FrameInput { sequence: step as u64, at: now, skew_s: 0.0 },
            estimate: EstimateInput { at: now, confidence: Confidence::Sure, covariance: None, target: 1 },
            observation: Some(observation),
            surface_from_model: None,
        };
        moving.observe(percept, now);
        let before = requests();
        let moved = moving.step(now).unwrap();
        if step >= WARM_UP {
            calls += requests() - before;
            followed += usize::from(
                moved.mode == Mode::Tracking && moved.decision.permission == Permission::Move { share: 1.0 },
            );
        }
    }
    assert_eq!(calls, 0);
    assert!(followed > COUNTED / 2, "{followed} steps followed the target");
    let probe = requests();
    drop(std::hint::black_box(Box::new([0u8; 64])));
    assert!(requests() > probe, "the counter counts");
}
