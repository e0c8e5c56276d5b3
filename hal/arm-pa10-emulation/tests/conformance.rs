//! The mock arm fulfils the contract of the arm traits, and fails as scripted.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10_emulation::mock::{MockArm, MockArmConfig};
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::{ArmExpectations, ArmHooks, arm_suite};
use pb3dp_kinematics::{Chain, JointVector};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig, PA10_ANGLE_QUANTUM_RAD};

const CYCLE: Duration = Duration::from_millis(10);

/// An arm whose E2 soon exceeds half a turn, so that wrapped angles would be detected.
fn arm(clock: &Arc<VirtualClock>) -> MockArm {
    let urdf = include_str!("../../../configs/robots/pa10_gen2.urdf");
    let limits = *Chain::from_urdf_str(urdf, "base_link", "flange").unwrap().limits();
    let config = JointPlantConfig {
        limits,
        acceleration_max_rad_per_s2: JointVector::from([2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0]),
        velocity_time_constant: Duration::from_millis(30),
        command_delay: Duration::from_millis(15),
        angle_quantum_rad: PA10_ANGLE_QUANTUM_RAD,
        history: Duration::from_secs(1),
    };
    let start = JointVector::from([0.2, -0.5, 0.3, 1.1, std::f64::consts::PI - 0.02, 0.9, 0.1]);
    let plant = Arc::new(Mutex::new(JointPlant::new(config, start, clock.now()).unwrap()));
    let config =
        MockArmConfig { name: "vs-robot".to_owned(), cycle: CYCLE, command_timeout: Duration::from_millis(50) };
    MockArm::new(config, plant, Arc::clone(clock) as Arc<dyn Clock>)
}

fn hooks() -> ArmHooks<MockArm> {
    ArmHooks {
        lose_reply: Some(Box::new(|arm| arm.faults().drop_replies(1))),
        raise_fault: Some(Box::new(|arm| arm.faults().raise_fault("overcurrent in E1"))),
        remove_fault_cause: Some(Box::new(|arm| arm.faults().remove_fault_cause())),
        press_e_stop: Some(Box::new(|arm| arm.faults().press_e_stop())),
        release_e_stop: Some(Box::new(|arm| arm.faults().release_e_stop())),
    }
}

#[test]
fn mock_arm_keeps_the_contract() {
    let clock = Arc::new(VirtualClock::new());
    let expectations = ArmExpectations { speed_rad_per_s: 0.1, settles_within: Duration::from_millis(400) };
    arm_suite(|| arm(&clock), clock.as_ref(), &expectations, &hooks()).assert_passed();
}

fn velocity(value: f64) -> JointCommand {
    JointCommand::Velocity(JointVector::repeat(value))
}

fn exchange_for(arm: &mut MockArm, clock: &VirtualClock, command: JointCommand, cycles: u32) {
    for _ in 0..cycles {
        arm.exchange(command).unwrap();
        clock.sleep_until(clock.now() + CYCLE);
    }
}

#[test]
fn silence_stops_the_arm_and_latches_a_fault() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    exchange_for(&mut arm, &clock, velocity(0.2), 20);
    clock.sleep_until(clock.now() + Duration::from_millis(400));
    let error = arm.exchange(velocity(0.2)).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Fault);
    assert!(error.to_string().contains("arm vs-robot (pa10 mock): stopped: no command for 410ms"), "{error}");
    let at_rest = arm.exchange(JointCommand::Hold).unwrap();
    assert!(at_rest.velocity_rad_per_s.amax() < 1e-3, "{at_rest:?}");
    assert_eq!(arm.state(), ArmState::Fault);
    arm.reset().unwrap();
    assert_eq!(arm.state(), ArmState::Disabled);
}

#[test]
fn a_held_arm_may_be_left_alone() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    exchange_for(&mut arm, &clock, velocity(0.2), 20);
    arm.exchange(JointCommand::Hold).unwrap();
    clock.sleep_until(clock.now() + Duration::from_secs(5));
    assert_eq!(arm.state(), ArmState::Enabled);
    arm.exchange(velocity(0.1)).unwrap();
}

#[test]
fn speeds_beyond_the_joint_are_rejected_by_name() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    let mut fast = JointVector::zeros();
    fast[1] = -1.01;
    let error = arm.exchange(JointCommand::Velocity(fast)).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Rejected);
    assert!(error.to_string().contains("axis 2: command -1.01 rad/s is not within +-1 rad/s"), "{error}");
    fast[1] = 1.0;
    arm.exchange(JointCommand::Velocity(fast)).unwrap();
}

#[test]
fn a_broken_link_stays_broken_and_the_arm_stops() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    exchange_for(&mut arm, &clock, velocity(0.2), 20);
    arm.faults().unplug();
    for command in [velocity(0.1), JointCommand::Hold] {
        assert_eq!(arm.exchange(command).unwrap_err().kind(), ArmErrorKind::Disconnected);
    }
    for result in [arm.enable(), arm.stop(), arm.reset()] {
        assert_eq!(result.unwrap_err().kind(), ArmErrorKind::Disconnected);
    }
    assert_eq!(arm.state(), ArmState::Fault);
    clock.sleep_until(clock.now() + Duration::from_secs(1));
    let plant = arm.plant();
    let mut plant = plant.lock().unwrap();
    plant.advance_to(clock.now());
    assert!(plant.state().velocity_rad_per_s.amax() < 1e-3);
}

#[test]
fn an_emergency_stop_needs_no_exchange() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    exchange_for(&mut arm, &clock, velocity(0.2), 50);
    arm.exchange(velocity(0.2)).unwrap();
    arm.faults().press_e_stop();
    // Sooner than the watchdog would act; S1 brakes at 2 rad/s^2 first, then with the lag.
    clock.sleep_until(clock.now() + Duration::from_millis(45));
    let plant = arm.plant();
    let mut plant = plant.lock().unwrap();
    plant.advance_to(clock.now());
    let speed = plant.state().velocity_rad_per_s.amax();
    assert!((0.1..0.12).contains(&speed), "0.2 - 2 x 0.045 = 0.11 rad/s: {speed}");
}

#[test]
fn enabling_waits_for_rest() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    exchange_for(&mut arm, &clock, velocity(0.5), 50);
    let faults = arm.faults();
    faults.press_e_stop();
    faults.release_e_stop();
    arm.reset().unwrap();
    let error = arm.enable().unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Rejected);
    assert!(error.to_string().contains("still moving"), "{error}");
    clock.sleep_until(clock.now() + Duration::from_secs(1));
    arm.enable().unwrap();
}

#[test]
fn a_fault_does_not_replace_an_emergency_stop() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    let faults = arm.faults();
    faults.press_e_stop();
    faults.raise_fault("overcurrent in E1");
    assert_eq!(arm.state(), ArmState::EStop);
    faults.release_e_stop();
    assert!(arm.reset().unwrap_err().to_string().contains("the fault is still present"), "its cause is, too");
    faults.remove_fault_cause();
    arm.reset().unwrap();
}

/// A camera that observes the same joints sees the pose of the arm at the time of exposure.
#[test]
fn shared_joints_answer_for_the_past() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = arm(&clock);
    arm.enable().unwrap();
    exchange_for(&mut arm, &clock, velocity(0.2), 30);
    let measured = arm.exchange(velocity(0.2)).unwrap();
    exchange_for(&mut arm, &clock, velocity(-0.2), 10);
    let true_position = arm.plant().lock().unwrap().position_at(measured.at).unwrap();
    assert!((true_position - measured.position_rad).amax() <= 0.51 * PA10_ANGLE_QUANTUM_RAD);
}
