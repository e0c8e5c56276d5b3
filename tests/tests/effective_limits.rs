//! One set of limits: with any speed scale of a setup, each consumer of an arm's limits uses the same numbers, which this
//! test computes independently from the robot description.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use nalgebra::Vector3;
use pb3dp_cell::parts::{ArmChoice, Parts};
use pb3dp_cell::plan::Plan;
use pb3dp_geometry::Pose;
use pb3dp_hal_api::{Arm, ArmError, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState, PowerOrder};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_middleware::{Guard, Limiter, LimiterConfig, StartPose};
use pb3dp_kinematics::{DOF, JointVector};
use pb3dp_servo::{Command, Controller, TargetObservation};
use pb3dp_setup::setup::{ArmSetup, Setup};
use pb3dp_sim::placement::{FlangePath, PathRefusal, PathRequirements, check_experiment};
use pb3dp_sim::trajectory::{StepExperiment, StepExperimentConfig};
use pb3dp_wiring::commissioning::slow_setup;
use pb3dp_wiring::wire;

use crate::closed_loop::support::changed_setup;

/// From the robot description, configs/robots/pa10_gen2.urdf, rad/s.
const DRIVES_RAD_PER_S: [f64; DOF] = [1.0, 1.0, 2.0, 2.0, 2.0, TAU, TAU];
const SCALES: [f64; 3] = [0.10, 0.25, 0.6];
const CYCLE: Duration = Duration::from_millis(10);

fn setup(scale: f64) -> Setup {
    changed_setup(&[("\nspeed_scale = 0.6 ", &format!("\nspeed_scale = {scale} "))])
}

fn allowed(scale: f64) -> JointVector {
    JointVector::from(DRIVES_RAD_PER_S) * scale
}

fn assert_equal(found: &JointVector, expected: &JointVector, what: &str) {
    assert!((found - expected).amax() < 1e-3 * expected.amax(), "{what}: {found} instead of {expected}");
}

/// An arm that reaches each velocity at once, times a factor.
struct Prompt {
    info: ArmInfo,
    clock: Arc<VirtualClock>,
    position_rad: JointVector,
    factor: f64,
}

impl Prompt {
    fn new(position_rad: JointVector, factor: f64) -> (Self, Arc<VirtualClock>) {
        let clock = Arc::new(VirtualClock::new());
        let info = ArmInfo { name: "prompt".to_owned(), cycle: CYCLE };
        (Self { info, clock: Arc::clone(&clock), position_rad, factor }, clock)
    }
}

impl Arm for Prompt {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let velocity_rad_per_s = match command {
            JointCommand::Velocity(velocity) => velocity * self.factor,
            JointCommand::Hold => JointVector::zeros(),
        };
        self.position_rad += velocity_rad_per_s * CYCLE.as_secs_f64();
        Ok(JointState { at: self.clock.now(), position_rad: self.position_rad, velocity_rad_per_s })
    }
}

impl ArmPower for Prompt {
    fn state(&self) -> ArmState {
        ArmState::Enabled
    }

    fn power(&mut self, _: PowerOrder) -> Result<Poll<()>, ArmError> {
        Ok(Poll::Ready(()))
    }
}

fn one_joint(joint: usize, velocity: f64) -> JointCommand {
    let mut all = JointVector::zeros();
    all[joint] = velocity;
    JointCommand::Velocity(all)
}

/// The largest speed that each joint reaches alone when its command is far too large.
fn fastest_behind_the_limiter(arm: &ArmSetup) -> JointVector {
    JointVector::from_fn(|joint, _| {
        let (prompt, clock) = Prompt::new(arm.start_rad, 1.0);
        let config = LimiterConfig { start: StartPose::Anywhere, ..arm.limiter.clone() };
        let mut limiter = Limiter::new(prompt, arm.limits, config, Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
        limiter.enable().unwrap();
        // Away from the joint's position, until the end of its range slows it.
        let direction = if arm.start_rad[joint] > 0.0 { -1.0 } else { 1.0 };
        let speeds = (0..400).map(|_| {
            clock.sleep_until(clock.now() + CYCLE);
            limiter.exchange(one_joint(joint, direction * 100.0)).unwrap().velocity_rad_per_s[joint].abs()
        });
        speeds.fold(0.0, f64::max)
    })
}

/// Whether the guard accepts this speed of a joint of this arm for some samples.
fn is_within_guard(arm: &ArmSetup, joint: usize, speed_rad_per_s: f64) -> bool {
    let (prompt, clock) = Prompt::new(arm.start_rad, 1.0);
    let mut guard = Guard::new(prompt, arm.limits, arm.guard.clone()).unwrap();
    (0..4).all(|_| {
        clock.sleep_until(clock.now() + CYCLE);
        guard.exchange(one_joint(joint, speed_rad_per_s)).is_ok()
    })
}

/// The largest share of its limit that the controller gives any joint for a target that is far away.
fn share_of_the_controller(setup: &Setup, scale: f64) -> f64 {
    let mut config = setup.controller;
    (config.speed.soft_start_s, config.approach.speed) = (0.0, config.speed.tracking);
    (config.speed.tracking.linear_m_per_s, config.speed.tracking.angular_rad_per_s) = (2.0, 6.0);
    config.approach.speed = config.speed.tracking;
    let arm = &setup.rig.arms.vs;
    let mut controller = Controller::new(config, arm.chain.clone(), arm.limits).unwrap();
    let clock = VirtualClock::new();
    let mut share: f64 = 0.0;
    let far =
        Pose::from_parts(Vector3::new(0.4, -0.3, 0.9), nalgebra::UnitQuaternion::from_euler_angles(0.3, 0.2, 1.0));
    for _ in 0..100 {
        clock.sleep_until(clock.now() + CYCLE);
        let joints =
            JointState { at: clock.now(), position_rad: arm.start_rad, velocity_rad_per_s: JointVector::zeros() };
        let observation = TargetObservation {
            at: clock.now(),
            cam_left_from_model: far,
            trusted: true,
            covariance: None,
            observed: [true; 6],
        };
        if let Command::Velocity(velocity) = controller.step(&joints, Some(&observation), clock.now()).command {
            share = share.max(velocity.component_div(&allowed(scale)).amax());
        }
    }
    share
}

/// Quick moves of the target's arm; the planner refuses them at the first joint that would be too fast.
fn refused_by_the_planner(arm: &ArmSetup, setup: &Setup) -> (usize, f64) {
    let target = arm.world_from_base * arm.chain.forward(&arm.start_rad) * setup.rig.flange_from_target;
    let quick = StepExperimentConfig { move_s: 0.05, hold_s: 0.1, ..StepExperimentConfig::default() };
    let experiment = StepExperiment::new(quick, target).unwrap();
    let path = FlangePath::of_carrier(&experiment, &arm.world_from_base, &setup.rig.flange_from_target);
    let requirements = PathRequirements { limit_margin_rad: 0.0, step_s: 5e-4, ..PathRequirements::OF_EXPERIMENT };
    match check_experiment(&arm.chain, &arm.limits, &arm.start_rad, &path, &requirements).unwrap_err() {
        PathRefusal::TooFast { joint, allowed_rad_per_s, .. } => (joint, allowed_rad_per_s),
        other => panic!("{other}"),
    }
}

#[test]
fn every_consumer_of_the_limits_keeps_to_the_same_speeds() {
    for scale in SCALES {
        let setup = setup(scale);
        let expected = allowed(scale);
        for (name, arm) in [("vs", &setup.rig.arms.vs), ("tc", &setup.rig.arms.tc)] {
            assert_equal(arm.limits.velocity_max_rad_per_s(), &expected, name);
            assert_equal(&fastest_behind_the_limiter(arm), &expected, &format!("limiter, {name}, {scale}"));
            for joint in 0..DOF {
                assert!(is_within_guard(arm, joint, 1.05 * expected[joint]), "guard, {name}, {scale}, {joint}");
                assert!(!is_within_guard(arm, joint, 1.15 * expected[joint]), "guard, {name}, {scale}, {joint}");
            }
            assert_eq!(arm.coupled().limits, arm.limits, "coupling");
        }
        let share = share_of_the_controller(&setup, scale);
        assert!((0.99..=1.0 + 1e-9).contains(&share), "controller at {scale}: {share}");
        let (joint, allowed_rad_per_s) = refused_by_the_planner(&setup.rig.arms.tc, &setup);
        assert!((allowed_rad_per_s - expected[joint]).abs() < 1e-3, "planner at {scale}, joint {joint}");
    }
}

#[test]
fn commissioning_only_takes_away() {
    const JOINT_MAX_RAD_PER_S: f64 = 0.08;
    for scale in SCALES {
        let setup = setup(scale);
        for choice in [ArmChoice::Vs, ArmChoice::Tc] {
            let slow = slow_setup(&setup, choice, JOINT_MAX_RAD_PER_S).unwrap();
            let (arm, other) = (choice.of(&slow), choice.other().of(&slow));
            let expected = allowed(scale.min(0.10)).map(|speed| speed.min(JOINT_MAX_RAD_PER_S));
            assert_equal(arm.limits.velocity_max_rad_per_s(), &expected, "commissioning");
            assert_equal(other.limits.velocity_max_rad_per_s(), &allowed(scale.min(0.10)), "the other arm");
            assert_equal(&fastest_behind_the_limiter(arm), &expected, "limiter of commissioning");
            // The guard allows for the ripple of slow gears, 0.02 rad/s.
            for joint in 0..DOF {
                assert!(is_within_guard(arm, joint, 1.05 * (expected[joint] + 0.02)), "{scale}, {joint}");
                assert!(!is_within_guard(arm, joint, 1.15 * (expected[joint] + 0.02)), "{scale}, {joint}");
            }
            let plan = Plan::new(arm, arm.start_rad, JointVector::repeat(0.2)).unwrap();
            let times = (0..=1000u32).map(|part| plan.duration() * part / 1000);
            let peak = times.map(|time| plan.at(time).1.component_div(&expected).amax()).fold(0.0, f64::max);
            assert!((0.3..=1.0).contains(&peak), "plan at {scale}: {peak}");
        }
    }
}

#[test]
fn wired_arms_reach_the_limits_of_their_setup_and_no_more() {
    let setup = setup(0.6);
    let Parts { mut vs, mut tc, clock, .. } = wire(&setup).unwrap();
    for arm in [&mut vs, &mut tc] {
        arm.enable().unwrap();
        arm.exchange(JointCommand::Hold).unwrap();
    }
    let mut fastest: f64 = 0.0;
    for _ in 0..200 {
        clock.sleep_until(clock.now() + CYCLE);
        vs.exchange(one_joint(6, 100.0)).unwrap();
        let now = tc.exchange(one_joint(6, 100.0)).unwrap();
        fastest = fastest.max(now.velocity_rad_per_s[6]);
    }
    let most = allowed(0.6)[6];
    assert!((0.98 * most..=most * (1.0 + 1e-6)).contains(&fastest), "{fastest} of {most}");
}
