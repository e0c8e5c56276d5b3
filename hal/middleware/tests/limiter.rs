//! The limiter in front of scripted arms and of the mock arm.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{CYCLE, acceleration, hard_limits, mock_arm, velocity};
use mockall::predicate::eq;
use pb3dp_arm_pa10::MockArm;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::mocks::MockScriptedArm;
use pb3dp_hal_conformance::{ArmExpectations, ArmHooks, arm_suite};
use pb3dp_hal_middleware::{Limiter, LimiterConfig, LimiterError};
use pb3dp_kinematics::{DOF, JointLimitsError, JointVector};
use proptest::prelude::*;

fn config(speed_scale: f64) -> LimiterConfig {
    let (operating_min_rad, operating_max_rad) = LimiterConfig::pa10_operating_range_rad();
    LimiterConfig {
        hard_limits: hard_limits(),
        operating_min_rad,
        operating_max_rad,
        speed_scale,
        acceleration_max_rad_per_s2: acceleration(),
        // One cycle of up to 20 ms, 15 ms of delay, 30 ms of lag.
        reaction_time: Duration::from_millis(65),
        stale_after: Duration::from_millis(50),
    }
}

fn rest() -> JointCommand {
    JointCommand::Velocity(JointVector::zeros())
}

fn sample(at: MonotonicTime) -> JointState {
    let position_rad = JointVector::from([0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1]);
    JointState { at, position_rad, velocity_rad_per_s: JointVector::zeros() }
}

/// An arm of which the expectations of `script` are all that may be asked.
fn scripted(script: impl FnOnce(&mut MockScriptedArm)) -> (Limiter<MockScriptedArm>, Arc<VirtualClock>) {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = MockScriptedArm::new();
    arm.expect_info().return_const(ArmInfo { name: "scripted".to_owned(), cycle: CYCLE });
    script(&mut arm);
    (Limiter::new(arm, config(0.6), Arc::clone(&clock) as Arc<dyn Clock>).unwrap(), clock)
}

/// Expects exactly these commands, and answers each with a sample of that moment.
fn expect_commands(arm: &mut MockScriptedArm, commands: &[(JointCommand, u64)]) {
    let mut in_order = mockall::Sequence::new();
    for &(command, at_ms) in commands {
        let at = MonotonicTime::ZERO + Duration::from_millis(at_ms);
        arm.expect_exchange().with(eq(command)).times(1).in_sequence(&mut in_order).returning(move |_| Ok(sample(at)));
    }
}

#[test]
fn a_number_that_is_not_finite_reaches_no_arm() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let (mut limiter, _) = scripted(|arm| expect_commands(arm, &[(JointCommand::Hold, 0)]));
        let error = limiter.exchange(velocity(4, bad)).unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Rejected);
        assert!(error.to_string().contains("limiter of arm scripted: joint 4"), "{error}");
        assert_eq!(limiter.statistics().refused_not_finite, 1);
    }
}

#[test]
fn without_a_fresh_sample_the_arm_rests() {
    let (mut limiter, clock) = scripted(|arm| {
        let first_step = velocity(0, 0.02);
        expect_commands(arm, &[(rest(), 0), (first_step, 0), (rest(), 100)]);
    });
    // Nothing is known yet; then a sample of this moment; then one that has become too old.
    limiter.exchange(velocity(0, 0.1)).unwrap();
    clock.sleep_until(clock.now() + CYCLE);
    limiter.exchange(velocity(0, 0.1)).unwrap();
    clock.sleep_until(clock.now() + Duration::from_millis(90));
    limiter.exchange(velocity(0, 0.1)).unwrap();
    assert_eq!(limiter.statistics().held_stale, 2);
    assert_eq!(limiter.statistics().velocity_commands, 3);
}

#[test]
fn hold_passes_as_it_is_and_the_next_start_is_from_rest() {
    let step = |value| velocity(0, value);
    let (mut limiter, clock) = scripted(|arm| {
        expect_commands(
            arm,
            &[(JointCommand::Hold, 0), (step(0.02), 10), (step(0.04), 20), (JointCommand::Hold, 30), (step(-0.02), 40)],
        );
    });
    for command in [JointCommand::Hold, step(0.5), step(0.5), JointCommand::Hold, step(-0.5)] {
        limiter.exchange(command).unwrap();
        clock.sleep_until(clock.now() + CYCLE);
    }
    assert_eq!(limiter.statistics().acceleration_limited, 3);
}

#[test]
fn a_reply_that_is_not_finite_is_thrown_away() {
    let (mut limiter, _) = scripted(|arm| {
        let mut in_order = mockall::Sequence::new();
        let mut broken = sample(MonotonicTime::ZERO);
        broken.position_rad[3] = f64::NAN;
        arm.expect_exchange().with(eq(rest())).times(1).in_sequence(&mut in_order).returning(move |_| Ok(broken));
        arm.expect_exchange()
            .with(eq(JointCommand::Hold))
            .times(1)
            .in_sequence(&mut in_order)
            .returning(move |_| Ok(broken));
        arm.expect_exchange().with(eq(rest())).times(1).in_sequence(&mut in_order).returning(move |_| Ok(broken));
        arm.expect_exchange().returning(move |_| Ok(broken));
    });
    assert_eq!(limiter.exchange(velocity(0, 0.1)).unwrap_err().kind(), ArmErrorKind::Timeout);
    // It was not taken as a sample: the next command has none to go by.
    assert_eq!(limiter.exchange(velocity(0, 0.1)).unwrap_err().kind(), ArmErrorKind::Timeout);
    assert_eq!((limiter.statistics().samples_not_finite, limiter.statistics().held_stale), (2, 2));
}

#[test]
fn after_an_error_of_the_arm_the_start_is_from_rest() {
    let (mut limiter, clock) = scripted(|arm| {
        let mut in_order = mockall::Sequence::new();
        let now = MonotonicTime::ZERO;
        arm.expect_exchange().times(3).in_sequence(&mut in_order).returning(move |_| Ok(sample(now)));
        arm.expect_exchange()
            .times(1)
            .in_sequence(&mut in_order)
            .returning(|_| Err(ArmError::new(ArmErrorKind::Timeout, "lost")));
        arm.expect_exchange()
            .with(eq(velocity(0, 0.02)))
            .times(1)
            .in_sequence(&mut in_order)
            .returning(move |_| Ok(sample(now)));
    });
    limiter.exchange(JointCommand::Hold).unwrap();
    for _ in 0..2 {
        clock.sleep_until(clock.now() + CYCLE);
        limiter.exchange(velocity(0, 0.5)).unwrap();
    }
    clock.sleep_until(clock.now() + CYCLE);
    assert_eq!(limiter.exchange(velocity(0, 0.5)).unwrap_err().kind(), ArmErrorKind::Timeout);
    clock.sleep_until(clock.now() + CYCLE);
    limiter.exchange(velocity(0, 0.5)).unwrap();
}

#[test]
fn power_is_the_arms_own() {
    let (mut limiter, _) = scripted(|arm| {
        arm.expect_state().times(1).return_const(ArmState::EStop);
        arm.expect_enable().times(1).returning(|| Err(ArmError::new(ArmErrorKind::Fault, "latched")));
        arm.expect_stop().times(1).returning(|| Ok(()));
        arm.expect_reset().times(1).returning(|| Ok(()));
    });
    assert_eq!(limiter.state(), ArmState::EStop);
    assert_eq!(limiter.enable().unwrap_err().kind(), ArmErrorKind::Fault);
    limiter.stop().unwrap();
    limiter.reset().unwrap();
}

#[test]
fn refuses_numbers_that_are_no_limits() {
    let refused = |change: fn(&mut LimiterConfig)| {
        let mut config = config(0.6);
        change(&mut config);
        Limiter::new(MockScriptedArm::new(), config, Arc::new(VirtualClock::new())).err()
    };
    assert_eq!(refused(|c| c.speed_scale = 0.0), Some(LimiterError::SpeedScale(0.0)));
    assert_eq!(refused(|c| c.speed_scale = 1.01), Some(LimiterError::SpeedScale(1.01)));
    assert!(matches!(refused(|c| c.speed_scale = f64::NAN), Some(LimiterError::SpeedScale(_))));
    let wide = refused(|c| c.operating_max_rad[1] = 1.6);
    assert!(
        matches!(wide, Some(LimiterError::OperatingRange(JointLimitsError::NotWithin { joint: 1, .. }))),
        "{wide:?}"
    );
    let weak = refused(|c| c.acceleration_max_rad_per_s2[5] = -1.0);
    assert_eq!(weak, Some(LimiterError::Acceleration { joint: 5, value: -1.0 }));
    assert_eq!(refused(|c| c.stale_after = Duration::ZERO), Some(LimiterError::ZeroTime("the age of a stale sample")));
    assert_eq!(refused(|_| {}), None);
}

#[test]
fn limited_mock_arm_keeps_the_contract() {
    let clock = Arc::new(VirtualClock::new());
    let make = || {
        let arm = mock_arm(&clock, JointVector::from([0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1]));
        Limiter::new(arm, config(0.6), Arc::clone(&clock) as Arc<dyn Clock>).unwrap()
    };
    let hooks = ArmHooks::<Limiter<MockArm>> {
        lose_reply: Some(Box::new(|limiter| limiter.arm().faults().drop_replies(1))),
        raise_fault: Some(Box::new(|limiter| limiter.arm().faults().raise_fault("overcurrent in E1"))),
        remove_fault_cause: Some(Box::new(|limiter| limiter.arm().faults().remove_fault_cause())),
        press_e_stop: Some(Box::new(|limiter| limiter.arm().faults().press_e_stop())),
        release_e_stop: Some(Box::new(|limiter| limiter.arm().faults().release_e_stop())),
    };
    let expectations = ArmExpectations { speed_rad_per_s: 0.1, settles_within: Duration::from_millis(400) };
    arm_suite(make, clock.as_ref(), &expectations, &hooks).assert_passed();
}

/// Notes every velocity that passes.
struct Spy {
    arm: MockArm,
    passed: Arc<Mutex<Vec<JointVector>>>,
}

impl Arm for Spy {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        if let JointCommand::Velocity(velocity) = command {
            self.passed.lock().unwrap().push(velocity);
        }
        self.arm.exchange(command)
    }
}

/// Some hundred milliseconds of one wild command after the other, at cycles of 5 to 20 ms.
fn any_drive() -> impl Strategy<Value = Vec<([f64; DOF], u64, usize)>> {
    prop::collection::vec((prop::array::uniform7(-12.0..12.0f64), 5..20u64, 1..150usize), 1..20)
}

fn within_operating_range() -> impl Strategy<Value = JointVector> {
    let (_, max) = LimiterConfig::pa10_operating_range_rad();
    prop::array::uniform7(-0.999..0.999f64).prop_map(move |part| max.component_mul(&JointVector::from(part)))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(150) })]

    #[test]
    fn no_command_drives_the_arm_beyond_its_limits(
        start in within_operating_range(), drive in any_drive(), scale in prop::sample::select(vec![0.1, 0.6, 1.0]),
    ) {
        let clock = Arc::new(VirtualClock::new());
        let mut arm = mock_arm(&clock, start);
        arm.enable().unwrap();
        let plant = arm.plant();
        let passed = Arc::new(Mutex::new(Vec::new()));
        let spy = Spy { arm, passed: Arc::clone(&passed) };
        let mut limiter = Limiter::new(spy, config(scale), Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
        limiter.exchange(JointCommand::Hold).unwrap();
        limiter.exchange(rest()).unwrap();
        let (hard, operating) = (hard_limits(), LimiterConfig::pa10_operating_range_rad().1);
        let mut before = JointVector::zeros();
        for (velocity, cycle_ms, cycles) in drive {
            for _ in 0..cycles {
                clock.sleep_until(clock.now() + Duration::from_millis(cycle_ms));
                limiter.exchange(JointCommand::Velocity(velocity.into())).unwrap();
                let sent = *passed.lock().unwrap().last().unwrap();
                for i in 0..DOF {
                    prop_assert!(sent[i].abs() <= scale * hard.velocity_max_rad_per_s()[i], "joint {i}: {sent}");
                    // Harder than this only where a joint would otherwise come too near to its limit: then it brakes.
                    let change = (sent[i] - before[i]).abs();
                    let gentle = change <= acceleration()[i] * cycle_ms as f64 * 1e-3 + 1e-12;
                    prop_assert!(gentle || sent[i].abs() < before[i].abs(), "joint {i}: {before} to {sent}");
                }
                before = sent;
            }
        }
        let end = clock.now();
        let plant = plant.lock().unwrap();
        let mut at = MonotonicTime::ZERO;
        while at <= end {
            let Some(position) = plant.position_at(at) else { break };
            prop_assert!(hard.violation(&position).is_none(), "at {at:?}: {position}");
            let beyond = (position.abs() - operating).max();
            prop_assert!(beyond < 1e-4, "beyond the operating range by {beyond} rad at {at:?}: {position}");
            at = at + Duration::from_millis(3);
        }
    }
}
