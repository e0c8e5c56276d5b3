//! Holds of the controller: cause, reported reason, and resuming.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use crate::common::{Cell, IDEAL, config, rotation, with_filter};
use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::{Command, ControlStep, ControllerConfig, HoldReason, Mode, NotInHistory, ObservationVerdict};

/// A cell whose hand has followed for half a second, and its target.
fn following(config: ControllerConfig) -> (Cell, Pose<Base, Model>) {
    let mut cell = Cell::new(config, IDEAL, 0.04);
    let target = cell.target_for_hand_moved(Vector3::new(0.05, -0.1, 0.08), rotation(0.1, 0.0, -0.2));
    for _ in 0..250 {
        cell.step(&target);
    }
    let step = cell.step(&target);
    assert!(moves(&step) && step.mode == Mode::Approaching, "{step:?}");
    (cell, target)
}

fn moves(step: &ControlStep) -> bool {
    matches!(step.command, Command::Velocity(velocity) if velocity.amax() > 1e-3)
}

/// Steps for this time without new images; returns the last step.
fn blind_for(cell: &mut Cell, seconds: f64) -> ControlStep {
    let steps = (seconds / cell.step_s) as usize;
    (0..steps).map(|_| cell.step_controller()).last().unwrap()
}

#[test]
fn without_new_images_the_hand_rests_then_the_target_is_lost() {
    let (mut cell, target) = following(config());
    let observed_at = cell.newest.unwrap().at;
    let age = |cell: &Cell| cell.now().seconds_since(observed_at);
    while age(&cell) <= 0.3 {
        assert!(moves(&cell.step_controller()), "no motion at {} s", age(&cell));
    }
    let step = cell.step_controller();
    assert!(matches!(step.mode, Mode::Holding(HoldReason::ObservationStale { age_s }) if age_s > 0.3), "{step:?}");
    assert_eq!((step.command, step.observation), (Command::Hold, ObservationVerdict::NoneNew));
    assert!(step.position_error_m.is_some(), "the errors are reported during a hold");
    assert!(step.mode.to_string().starts_with("holding: the last accepted observation is 0.30"), "{}", step.mode);
    let step = blind_for(&mut cell, 0.75);
    assert_eq!((step.mode, step.command, step.base_from_model), (Mode::Lost, Command::Hold, None));
    // The supervisor decides whether motion resumes; observations from before the operator's command do not count after it.
    cell.newest = Some(cell.observe(&target));
    assert_eq!(cell.step_controller().observation, ObservationVerdict::Accepted);
    cell.controller.acquire();
    assert_eq!(cell.step_controller().mode, Mode::Idle, "an old observation is not used again");
    let moved = (0..50).any(|_| moves(&cell.step(&target)));
    assert!(moved);
}

#[test]
fn a_short_gap_is_bridged_and_a_lost_target_is_found_again() {
    let (mut cell, target) = following(config());
    assert!(matches!(blind_for(&mut cell, 0.4).mode, Mode::Holding(_)));
    let back = (0..60).map(|_| cell.step(&target)).find(moves).unwrap();
    assert_eq!(back.mode, Mode::Approaching);
    assert_eq!(blind_for(&mut cell, 1.2).mode, Mode::Lost);
    assert!((0..60).any(|_| moves(&cell.step(&target))));
}

#[test]
fn after_a_rest_the_start_is_soft_again() {
    let mut config = config();
    config.speed.soft_start_s = 0.2;
    let (mut cell, target) = following(config);
    blind_for(&mut cell, 0.4);
    let first = (0..60).map(|_| cell.step(&target)).find(|step| step.command != Command::Hold).unwrap();
    assert_eq!(first.command, Command::Velocity(JointVector::zeros()));
}

#[test]
fn observations_that_can_not_be_used_are_refused_one_by_one() {
    let (mut cell, target) = following(config());
    let track = cell.step_controller().base_from_model;
    let mut refused = |change: &dyn Fn(&mut Cell)| {
        let mut copy = Cell::new(config(), IDEAL, 0.0);
        copy.controller = cell.controller.clone();
        (copy.joints, copy.time_s) = (cell.joints, cell.time_s);
        copy.newest = Some(copy.observe(&target));
        change(&mut copy);
        let step = copy.step_controller();
        assert_eq!(step.base_from_model, track, "{:?} changed the target", step.observation);
        cell.step_controller();
        step.observation
    };
    assert_eq!(refused(&|c| c.newest.as_mut().unwrap().trusted = false), ObservationVerdict::Untrusted);
    let nan = Pose::from_translation(Vector3::new(0.0, f64::NAN, 0.5));
    assert_eq!(refused(&|c| c.newest.as_mut().unwrap().cam_left_from_model = nan), ObservationVerdict::NotFinite);
    let verdict = refused(&|c| c.newest.as_mut().unwrap().at = c.now() + std::time::Duration::from_millis(5));
    assert!(matches!(verdict, ObservationVerdict::WrongTime { age_s } if age_s < 0.0), "{verdict:?}");
    let verdict = refused(&|c| {
        let far = Pose::from_parts(Vector3::new(0.6, 0.0, 0.0), rotation(0.0, 0.0, 0.0));
        let observed = &mut c.newest.as_mut().unwrap().cam_left_from_model;
        *observed = far * *observed;
    });
    assert!(
        matches!(verdict, ObservationVerdict::Jump { position_m, .. } if (position_m - 0.6).abs() < 1e-6),
        "{verdict:?}"
    );
    let verdict = refused(&|c| c.newest = None);
    assert_eq!(verdict, ObservationVerdict::NoneNew);
}

#[test]
fn an_observation_is_placed_with_the_joints_at_its_exposure() {
    let mut cell = Cell::new(config(), IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.0, 0.05, 0.0), rotation(0.0, 0.0, 0.0));
    // The joints move freely; one image, exposed during the motion between two joint samples, arrives 50 ms later.
    let mut observed = None;
    for i in 0..60 {
        if i == 30 {
            observed = Some(cell.observe(&target));
        }
        let velocity = JointVector::from([0.5, -0.3, 0.4, 0.2, -0.6, 0.3, 1.0]);
        cell.joints.velocity_rad_per_s = velocity;
        cell.controller.step(&cell.joints, None, cell.now());
        cell.joints.position_rad += velocity * 0.002;
        cell.time_s += 0.002;
        cell.joints.at = cell.now();
    }
    let step = cell.controller.step(&cell.joints, observed.as_ref(), cell.now());
    assert_eq!(step.observation, ObservationVerdict::Accepted);
    let off = step.base_from_model.unwrap().inverse() * target;
    assert!(off.translation_m().norm() < 1e-9 && off.rotation_angle_rad() < 1e-9, "{off:?}");
}

#[test]
fn an_observation_from_before_the_first_joint_sample_is_refused() {
    let mut cell = Cell::new(config(), IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.0, 0.05, 0.0), rotation(0.0, 0.0, 0.0));
    let mut observation = cell.observe(&target);
    observation.at = MonotonicTime::from_secs_f64(4.9);
    let step = cell.controller.step(&cell.joints, Some(&observation), cell.now());
    assert_eq!(step.observation, ObservationVerdict::JointsUnknown(NotInHistory::TooOld));
    assert_eq!((step.mode, step.command), (Mode::Idle, Command::Hold));
}

#[test]
fn bad_joints_stop_the_hand_and_good_ones_let_it_go_on() {
    let (mut cell, target) = following(config());
    let good = cell.joints;
    cell.joints.position_rad[3] = f64::NAN;
    let step = cell.controller.step(&cell.joints, cell.newest.as_ref(), cell.now());
    assert_eq!((step.mode, step.command), (Mode::Holding(HoldReason::JointsNotFinite), Command::Hold));
    assert_eq!(step.base_from_hand, None);
    cell.joints = good;
    cell.joints.velocity_rad_per_s[0] = f64::INFINITY;
    let step = cell.controller.step(&cell.joints, cell.newest.as_ref(), cell.now());
    assert_eq!(step.mode, Mode::Holding(HoldReason::JointsNotFinite));
    cell.joints = good;
    cell.time_s += 0.05;
    let step = cell.controller.step(&cell.joints, cell.newest.as_ref(), cell.now());
    assert!(matches!(step.mode, Mode::Holding(HoldReason::JointsStale { age_s }) if age_s > 0.03), "{step:?}");
    cell.joints.at = cell.now();
    assert!(moves(&cell.step(&target)));
}

#[test]
fn a_clock_that_steps_back_loses_the_target() {
    for joints_only in [true, false] {
        let (mut cell, target) = following(config());
        cell.joints.at = MonotonicTime::from_secs_f64(cell.time_s - 0.02);
        if !joints_only {
            cell.time_s -= 0.02;
        }
        let step = cell.controller.step(&cell.joints, cell.newest.as_ref(), cell.now());
        assert_eq!((step.mode, step.command), (Mode::Holding(HoldReason::ClockStepped), Command::Hold));
        cell.joints.at = cell.now();
        assert_eq!(cell.step_controller().mode, Mode::Lost, "earlier observations do not count");
        // The target is initialised again from observations after the clock step.
        assert!((0..50).any(|_| moves(&cell.step(&target))));
    }
}

#[test]
fn the_hand_does_not_move_before_enough_observations_agree() {
    let config = with_filter(config(), |filter| filter.observations_to_lock = 5);
    let mut cell = Cell::new(config, IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.05, 0.0, 0.0), rotation(0.0, 0.0, 0.0));
    let mut accepted = 0;
    loop {
        let step = cell.step(&target);
        accepted += u32::from(step.observation == ObservationVerdict::Accepted);
        if accepted == 5 {
            assert!(moves(&step));
            break;
        }
        assert_eq!((step.mode, step.command), (Mode::Locking, Command::Hold));
    }
    // A target that was never initialised is dropped, not lost.
    let mut cell = Cell::new(config, IDEAL, 0.0);
    cell.step(&target);
    assert_eq!(blind_for(&mut cell, 1.2).mode, Mode::Idle);
}
