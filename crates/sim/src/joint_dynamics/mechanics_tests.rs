//! Mechanics of a joint: friction, brake, gravity, and free joints.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{DOF, JointLimits, JointVector};
use proptest::prelude::*;

use super::{AxisMode, JointMechanics, JointPlant, JointPlantConfig};

fn millis(ms: u64) -> MonotonicTime {
    MonotonicTime::ZERO + Duration::from_millis(ms)
}

fn start() -> JointVector {
    JointVector::from([0.2, 0.5, 0.3, 1.1, -0.7, -0.9, 0.1])
}

fn mechanics() -> JointMechanics {
    JointMechanics { servo_friction_rad_per_s: JointVector::repeat(0.05), ..JointMechanics::default() }
}

fn plant() -> JointPlant {
    let max = JointVector::repeat(2.5);
    let config = JointPlantConfig {
        limits: JointLimits::new(-max, max, JointVector::repeat(1.0)).unwrap(),
        acceleration_max_rad_per_s2: JointVector::repeat(8.0),
        velocity_time_constant: Duration::from_millis(40),
        command_delay: Duration::ZERO,
        angle_quantum_rad: 0.0,
        history: Duration::from_secs(60),
    };
    JointPlant::new(config, start(), millis(0)).unwrap().with_mechanics(mechanics()).unwrap()
}

fn velocity_at(plant: &JointPlant, ms: u64, joint: usize) -> f64 {
    plant.velocity_at(millis(ms)).unwrap()[joint]
}

/// Explicit integration of v' = clamp((u - v - friction) / tau, +-a) with a step of 1 microsecond, sticking included.
#[test]
fn friction_agrees_with_fine_numerical_integration() {
    let commands = [(0, 0.03), (100, 0.4), (300, 0.0), (500, -0.9), (600, 0.7), (800, 0.04)];
    let mut plant = plant();
    for (ms, u) in commands {
        plant.advance_to(millis(ms));
        plant.command(millis(ms), JointVector::repeat(u)).unwrap();
    }
    plant.advance_to(millis(1200));
    let (mut x, mut v) = (start()[0], 0.0f64);
    let dt = 1e-6;
    for step in 0..1_200_000u64 {
        let ms = step as f64 * 1e-3;
        let u = commands.iter().rev().find(|(at, _)| *at as f64 <= ms + 1e-9).map_or(0.0, |(_, u)| *u);
        let drive = u - v;
        let before = v;
        if v == 0.0 {
            v += dt * ((drive - drive.clamp(-0.05, 0.05)) / 0.04).clamp(-8.0, 8.0);
        } else {
            v += dt * ((drive - 0.05f64.copysign(v)) / 0.04).clamp(-8.0, 8.0);
            // At zero velocity it sticks for a moment.
            v = if v * before < 0.0 { 0.0 } else { v };
        }
        x += dt * 0.5 * (v + before);
    }
    let state = plant.state();
    assert!((state.position_rad[0] - x).abs() < 1e-5, "{} and {x}", state.position_rad[0]);
    assert!((state.velocity_rad_per_s[0] - v).abs() < 1e-5, "{} and {v}", state.velocity_rad_per_s[0]);
}

#[test]
fn friction_swallows_small_commands_and_brings_to_rest() {
    let mut plant = plant();
    plant.command(millis(0), JointVector::repeat(0.05)).unwrap();
    plant.advance_to(millis(1000));
    assert_eq!(plant.state().position_rad, start());
    plant.command(millis(1000), JointVector::repeat(0.5)).unwrap();
    plant.command(millis(2000), JointVector::zeros()).unwrap();
    plant.advance_to(millis(3000));
    assert!((velocity_at(&plant, 1999, 0) - 0.45).abs() < 1e-6);
    assert!(velocity_at(&plant, 2080, 0) > 0.0);
    assert_eq!(velocity_at(&plant, 2200, 0), 0.0, "stopped, not decelerating");
}

#[test]
fn a_brake_holds_against_every_command() {
    let mut plant = plant();
    plant.command(millis(0), JointVector::repeat(0.8)).unwrap();
    plant.advance_to(millis(500));
    plant.set_modes(millis(500), [AxisMode::Brake; DOF]).unwrap();
    plant.advance_to(millis(600));
    let speed = velocity_at(&plant, 500, 0);
    assert!((velocity_at(&plant, 507, 0) - (speed - 50.0 * 0.007)).abs() < 1e-9);
    assert_eq!(velocity_at(&plant, 517, 0), 0.0);
    let held = plant.state().position_rad;
    plant.command(millis(600), JointVector::repeat(-0.8)).unwrap();
    plant.advance_to(millis(900));
    assert_eq!(plant.state().position_rad, held);
    plant.set_modes(millis(900), [AxisMode::Servo; DOF]).unwrap();
    plant.advance_to(millis(1300));
    assert!((plant.state().velocity_rad_per_s - JointVector::repeat(-0.75)).amax() < 1e-3, "the command is kept");
}

/// The outer arm leans outwards at S2 (0.5 rad) and E1 (1.6), and W1 points upwards again (0.7).
#[test]
fn a_free_joint_falls_as_gravity_pulls_and_friction_allows() {
    let mut plant = plant();
    plant.set_modes(millis(0), [AxisMode::Free; DOF]).unwrap();
    plant.advance_to(millis(3000));
    let early = plant.velocity_at(millis(10)).unwrap();
    for (joint, tilt, gravity) in [(1, 0.5f64, 6.0), (3, 1.6, 9.0), (5, 0.7, 12.0)] {
        let acceleration = gravity * tilt.sin() - 1.0;
        assert!((early[joint] / 0.01 - acceleration).abs() < 0.02 * acceleration, "joint {joint}: {early}");
    }
    for joint in [0, 2, 4, 6] {
        assert_eq!(early[joint], 0.0, "joint {joint}");
    }
    assert_eq!(plant.state().position_rad[3], 2.5, "down to its stop");
}

#[test]
fn a_free_joint_that_does_not_fall_runs_out() {
    let mut plant = plant();
    plant.command(millis(0), JointVector::repeat(0.8)).unwrap();
    plant.advance_to(millis(500));
    plant.set_modes(millis(500), [AxisMode::Free; DOF]).unwrap();
    plant.advance_to(millis(2500));
    assert!(velocity_at(&plant, 700, 0) > 0.2, "nothing but friction slows it down");
    assert_eq!(velocity_at(&plant, 2000, 0), 0.0);
}

#[test]
fn a_driven_joint_follows_its_velocity_and_no_command() {
    let mut plant = plant();
    let mut modes = [AxisMode::Servo; DOF];
    modes[4] = AxisMode::Driven { velocity_rad_per_s: 3.05 };
    plant.set_modes(millis(0), modes).unwrap();
    plant.command(millis(0), JointVector::repeat(-0.1)).unwrap();
    plant.advance_to(millis(700));
    assert!((velocity_at(&plant, 700, 4) - 3.0).abs() < 1e-3, "{}", velocity_at(&plant, 700, 4));
    assert!((velocity_at(&plant, 700, 3) + 0.05).abs() < 1e-6);
    let mut wrong = modes;
    wrong[2] = AxisMode::Driven { velocity_rad_per_s: f64::NAN };
    assert!(plant.set_modes(millis(800), wrong).unwrap_err().to_string().contains("axis 3"));
    assert_eq!(*plant.modes(), modes);
}

#[test]
fn mechanics_that_can_not_be_are_refused() {
    let refused = |change: fn(&mut JointMechanics)| {
        let mut mechanics = mechanics();
        change(&mut mechanics);
        plant().with_mechanics(mechanics).unwrap_err().to_string()
    };
    let brake = refused(|mechanics| mechanics.brake_deceleration_rad_per_s2[2] = 0.0);
    assert!(brake.contains("brake_deceleration_rad_per_s2 of axis 3 is 0, it must be a positive"), "{brake}");
    assert!(refused(|mechanics| mechanics.servo_friction_rad_per_s[0] = -1.0).contains("servo_friction"));
    assert!(refused(|mechanics| mechanics.gravity_rad_per_s2[5] = f64::NAN).contains("gravity_rad_per_s2 of axis 6"));
    assert!(refused(|mechanics| mechanics.free_friction_rad_per_s2[6] = f64::INFINITY).contains("axis 7"));
    assert!(refused(|mechanics| mechanics.free_time_constant = Duration::ZERO).contains("free_time_constant is 0"));
}

fn any_mode() -> impl Strategy<Value = AxisMode> {
    prop_oneof![
        4 => Just(AxisMode::Servo),
        2 => Just(AxisMode::Brake),
        2 => Just(AxisMode::Free),
        1 => (-8.0..8.0f64).prop_map(|velocity_rad_per_s| AxisMode::Driven { velocity_rad_per_s }),
    ]
}

fn any_events() -> impl Strategy<Value = Vec<(u64, f64, [AxisMode; DOF])>> {
    prop::collection::vec((1..400_000_000u64, -2.0..2.0f64, prop::array::uniform7(any_mode())), 1..20)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(150) })]

    /// In any mode the joints stay within their stops, move without jumps, and do not depend on the step size.
    #[test]
    fn joints_move_without_jumps_whatever_holds_them(events in any_events(), piece in 1..50u64) {
        let (mut in_one, mut in_many) = (plant(), plant());
        let mut at = millis(0);
        for (after, velocity, modes) in &events {
            let next = at + Duration::from_nanos(*after);
            while at < next {
                at = (at + Duration::from_millis(piece)).min(next);
                in_many.advance_to(at);
            }
            for plant in [&mut in_one, &mut in_many] {
                plant.command(next, JointVector::repeat(*velocity)).unwrap();
                plant.set_modes(next, *modes).unwrap();
            }
        }
        let end = at + Duration::from_secs(3);
        in_one.advance_to(end);
        in_many.advance_to(end);
        prop_assert_eq!(in_one.state(), in_many.state());
        let mut time = millis(0);
        while time + Duration::from_millis(1) < end {
            let later = time + Duration::from_millis(1);
            let (before, after) = (in_one.position_at(time).unwrap(), in_one.position_at(later).unwrap());
            prop_assert!(in_one.config().limits.violation(&after).is_none());
            let fastest = in_one.velocity_at(time).unwrap().amax().max(in_one.velocity_at(later).unwrap().amax());
            prop_assert!((after - before).amax() <= (fastest + 1.0) * 0.001 + 1e-9, "{:?}", time);
            time = later;
        }
    }
}
