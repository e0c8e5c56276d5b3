//! The limiter in front of scripted arms and of the mock arm.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use crate::common::{
    COMMAND_TIMEOUT, CYCLE, Tamper, Tampered, acceleration, assert_contract, jerk, limiter_config, limits, mock_arm,
    operating_range_rad, velocity,
};
use mockall::predicate::eq;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, EnablePosition, JointCommand, JointState,
    PowerOrder,
};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::mocks::MockScriptedArm;
use pb3dp_hal_middleware::{Limiter, LimiterConfig, LimiterError, LimiterStatistics, StartPose};
use pb3dp_kinematics::{DOF, JointVector};
use proptest::prelude::*;

fn rest() -> JointCommand {
    JointCommand::Velocity(JointVector::zeros())
}

fn sample(at: MonotonicTime) -> JointState {
    let position_rad = JointVector::from([0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1]);
    JointState { at, position_rad, velocity_rad_per_s: JointVector::zeros() }
}

/// An arm that permits only the calls that `script` expects.
fn scripted(script: impl FnOnce(&mut MockScriptedArm)) -> (Limiter<MockScriptedArm>, Arc<VirtualClock>) {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = MockScriptedArm::new();
    arm.expect_info().return_const(ArmInfo { name: "scripted".to_owned(), cycle: CYCLE });
    script(&mut arm);
    (Limiter::new(arm, limits(0.6), limiter_config(), Arc::clone(&clock) as Arc<dyn Clock>).unwrap(), clock)
}

/// An enabled mock arm whose commands are recorded.
fn noted() -> (Limiter<Tampered>, Arc<VirtualClock>, Arc<Mutex<Vec<JointCommand>>>) {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = mock_arm(&clock, JointVector::zeros());
    arm.enable().unwrap();
    let commanded = Arc::default();
    let arm = Tampered { arm, commanded: Arc::clone(&commanded), tamper: Arc::default() };
    (Limiter::new(arm, limits(1.0), limiter_config(), Arc::clone(&clock) as Arc<dyn Clock>).unwrap(), clock, commanded)
}

/// Expects exactly these commands, and answers each with a current sample.
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
        assert!(error.to_string().contains("limiter of arm scripted: axis 5"), "{error}");
        let LimiterStatistics { refused, refused_not_finite, changed, .. } = limiter.statistics();
        assert_eq!((refused, refused_not_finite, changed), (1, 1, 0));
    }
}

#[test]
fn without_a_fresh_sample_the_arm_rests() {
    let (mut limiter, clock) = scripted(|arm| {
        // 40 rad/s^3 for 10 ms give 0.4 rad/s^2, which give 0.004 rad/s after 10 ms; then no command for 90 ms, and after 60 ms
        // of them the arm starts to stop by itself.
        expect_commands(arm, &[(rest(), 0), (velocity(0, 0.004), 0), (rest(), 100)]);
    });
    // First no sample; then a current sample; then a sample that is too old.
    limiter.exchange(velocity(0, 0.1)).unwrap();
    clock.sleep_until(clock.now() + CYCLE);
    limiter.exchange(velocity(0, 0.1)).unwrap();
    clock.sleep_until(clock.now() + Duration::from_millis(90));
    limiter.exchange(velocity(0, 0.1)).unwrap();
    assert_eq!(limiter.statistics().held_stale, 2);
    assert_eq!(limiter.statistics().velocity_commands, 3);
    assert_eq!((limiter.statistics().changed, limiter.statistics().refused), (3, 0));
}

/// A command that is both too fast and too sudden counts as one changed command, and one that the arm refuses as refused.
#[test]
fn each_command_is_counted_once() {
    let (mut limiter, clock) = scripted(|arm| {
        expect_commands(arm, &[(JointCommand::Hold, 0), (rest(), 10), (velocity(0, 0.004), 20)]);
        let rejected = || Err(ArmError::new(ArmErrorKind::Rejected, "too little room"));
        arm.expect_exchange().with(eq(velocity(0, 0.012))).times(1).returning(move |_| rejected());
    });
    for (command, is_refused) in
        [(JointCommand::Hold, false), (rest(), false), (velocity(0, 5.0), false), (velocity(0, 5.0), true)]
    {
        assert_eq!(limiter.exchange(command).is_err(), is_refused);
        clock.sleep_until(clock.now() + CYCLE);
    }
    let LimiterStatistics { velocity_commands, changed, refused, speed_limited, acceleration_limited, .. } =
        limiter.statistics();
    assert_eq!((velocity_commands, changed, refused), (3, 1, 1));
    assert_eq!((speed_limited, acceleration_limited), (2, 2));
}

#[test]
fn hold_passes_as_it_is_and_the_next_start_is_from_rest() {
    let step = |value| velocity(0, value);
    let (mut limiter, clock) = scripted(|arm| {
        // In 10 ms, 40 rad/s^3 give 0.4 rad/s^2, which give 0.004 rad/s. The arm's own ramp ends after 6 ms.
        expect_commands(
            arm,
            &[
                (JointCommand::Hold, 0),
                (step(0.004), 10),
                (step(0.012), 20),
                (JointCommand::Hold, 30),
                (step(-0.004), 40),
            ],
        );
    });
    for command in [JointCommand::Hold, step(0.5), step(0.5), JointCommand::Hold, step(-0.5)] {
        limiter.exchange(command).unwrap();
        clock.sleep_until(clock.now() + CYCLE);
    }
    assert_eq!(limiter.statistics().acceleration_limited, 3);
}

/// 10 ms after a hold at 0.5 rad/s the arm's own ramp is at 0.48 rad/s: the next velocity starts there and not at standstill.
#[test]
fn a_velocity_right_after_a_hold_goes_on_from_the_ramp() {
    let (mut limiter, clock, passed) = noted();
    let mut tell = |command| {
        limiter.exchange(command).unwrap();
        clock.sleep_until(clock.now() + CYCLE);
    };
    (0..100).for_each(|_| tell(velocity(0, 0.5)));
    tell(JointCommand::Hold);
    tell(rest());
    let Some(&JointCommand::Velocity(last)) = passed.lock().unwrap().last() else { panic!("no velocity") };
    // 0.48 rad/s, minus 10 ms at 1.6 to 2 rad/s^2.
    assert!(last[0] > 0.46 - 1e-12 && last[0] < 0.464 + 1e-12, "{last}");
}

/// The position of `sample`, with an offset of one joint.
fn start_with(joint: usize, offset_rad: f64) -> StartPose {
    let mut position_rad = sample(MonotonicTime::ZERO).position_rad;
    position_rad[joint] -= offset_rad;
    StartPose::Near { position_rad, tolerance_rad: StartPose::TOLERANCE_RAD }
}

#[test]
fn the_first_velocity_is_refused_away_from_the_start() {
    for (joint, offset_rad, is_refused) in [(4, 0.0101, true), (2, -0.02, true), (6, 0.0099, false), (0, 0.0, false)] {
        let clock = Arc::new(VirtualClock::new());
        let mut arm = mock_arm(&clock, sample(MonotonicTime::ZERO).position_rad);
        arm.enable().unwrap();
        let config = LimiterConfig { start: start_with(joint, offset_rad), ..limiter_config() };
        let mut limiter = Limiter::new(arm, limits(0.6), config, Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
        let mut cycle = |command| {
            clock.sleep_until(clock.now() + CYCLE);
            limiter.exchange(command).map_err(|error| (error.kind(), error.to_string()))
        };
        cycle(JointCommand::Hold).unwrap();
        let first = cycle(velocity(1, 0.2));
        assert_eq!(first.is_err(), is_refused, "joint {joint} off by {offset_rad}: {first:?}");
        if let Err((kind, text)) = first {
            assert_eq!(kind, ArmErrorKind::Rejected);
            let named = format!("axis {} is at ", joint + 1);
            assert!(text.contains(&named) && text.contains("move the arm to its start pose"), "{text}");
            assert!(cycle(velocity(1, 0.2)).is_err(), "it stays refused");
            assert_eq!(limiter.statistics().refused_start, 2);
            continue;
        }
        // After its start the arm may have any position, until it is enabled again.
        assert!((0..50).all(|_| cycle(velocity(1, 0.2)).is_ok()));
        limiter.stop().unwrap();
        limiter.enable().unwrap();
        limiter.exchange(JointCommand::Hold).unwrap();
        assert_eq!(limiter.exchange(velocity(1, 0.2)).unwrap_err().kind(), ArmErrorKind::Rejected);
    }
}

/// What asks a latched arm for the cause of its latch is a velocity of zero, which moves nothing.
#[test]
fn an_arm_that_latched_away_from_its_start_pose_names_the_cause_of_its_latch() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = mock_arm(&clock, sample(MonotonicTime::ZERO).position_rad);
    arm.enable().unwrap();
    let config = LimiterConfig { start: start_with(3, 0.5), ..limiter_config() };
    let mut limiter = Limiter::new(arm, limits(0.6), config, Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
    limiter.exchange(JointCommand::Hold).unwrap();
    limiter.exchange(rest()).unwrap();
    assert_eq!(limiter.exchange(velocity(1, 0.2)).unwrap_err().kind(), ArmErrorKind::Rejected, "rest is no start");
    limiter.arm().faults().raise_fault("an overcurrent");
    let error = limiter.exchange(rest()).unwrap_err().to_string();
    assert!(error.contains("an overcurrent") && !error.contains("start pose"), "{error}");
}

/// An arm that has started at its start pose may continue from another position, also if the first try to enable it failed.
#[test]
fn an_arm_that_is_switched_on_where_it_is_at_the_second_try_goes_on() {
    let clock = Arc::new(VirtualClock::new());
    let mut arm = mock_arm(&clock, sample(MonotonicTime::ZERO).position_rad);
    arm.enable().unwrap();
    let config = LimiterConfig { start: start_with(0, 0.0), ..limiter_config() };
    let mut limiter = Limiter::new(arm, limits(0.6), config, Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
    limiter.exchange(JointCommand::Hold).unwrap();
    for _ in 0..50 {
        clock.sleep_until(clock.now() + CYCLE);
        limiter.exchange(velocity(1, 0.2)).unwrap();
    }
    limiter.stop().unwrap();
    limiter.arm().faults().press_e_stop();
    assert!(limiter.power(PowerOrder::Enable(EnablePosition::Here)).is_err(), "the emergency stop is pressed");
    limiter.arm().faults().release_e_stop();
    limiter.reset().unwrap();
    let _ = limiter.power(PowerOrder::Enable(EnablePosition::Here)).unwrap();
    limiter.exchange(JointCommand::Hold).unwrap();
    limiter.exchange(velocity(1, 0.2)).unwrap();
}

#[test]
fn beyond_a_servo_limit_only_the_way_back_is_open() {
    for outwards in [1.0, -1.0] {
        let mut outside = sample(MonotonicTime::ZERO);
        outside.position_rad[1] = 1.6 * outwards;
        let (mut limiter, _) = scripted(|arm| {
            let mut in_order = mockall::Sequence::new();
            let is_hold = eq(JointCommand::Hold);
            arm.expect_exchange().with(is_hold).times(2).in_sequence(&mut in_order).returning(move |_| Ok(outside));
            let back = velocity(1, -0.004 * outwards);
            arm.expect_exchange().with(eq(back)).times(1).in_sequence(&mut in_order).returning(move |_| Ok(outside));
        });
        limiter.exchange(JointCommand::Hold).unwrap();
        let error = limiter.exchange(velocity(1, 1e-6 * outwards)).unwrap_err();
        assert_eq!((error.kind(), limiter.statistics().refused_outwards), (ArmErrorKind::Rejected, 1));
        let sign = if outwards > 0.0 { "" } else { "-" };
        let expected = format!("axis 2 is at {sign}91.67 degrees, beyond its servo limits -91.00 to 91.00");
        assert!(error.to_string().contains(&expected), "{error}");
        limiter.exchange(velocity(1, -0.5 * outwards)).unwrap();
    }
}

/// E2 and W2 turn to 249 degrees: an angle beyond half a turn is not wrapped to a smaller one.
#[test]
fn joints_turn_beyond_half_a_turn() {
    let clock = Arc::new(VirtualClock::new());
    let start = JointVector::from([0.2, -0.5, 0.3, 1.1, 170f64.to_radians(), 0.9, -170f64.to_radians()]);
    let mut arm = mock_arm(&clock, start);
    arm.enable().unwrap();
    let mut limiter = Limiter::new(arm, limits(0.6), limiter_config(), Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
    let mut desired = JointVector::zeros();
    (desired[4], desired[6]) = (1.0, -1.0);
    let mut last = limiter.exchange(JointCommand::Hold).unwrap();
    for _ in 0..600 {
        clock.sleep_until(clock.now() + CYCLE);
        last = limiter.exchange(JointCommand::Velocity(desired)).unwrap();
    }
    for (joint, angle) in [(4, last.position_rad[4]), (6, -last.position_rad[6])] {
        let end = 249f64.to_radians();
        assert!(angle > end - 0.01 && angle < end + 1e-5, "joint {joint} came to {} degrees", angle.to_degrees());
    }
}

/// The mock arm stops each joint separately: 0.4 s after a hold at 1.6 rad/s the elbow with 2 rad/s^2 still moves, as on a common
/// ramp of all joints, but the wrist with 5 rad/s^2 is stationary, where a common ramp would be at 0.8 rad/s.
#[test]
fn a_velocity_after_a_hold_goes_on_from_where_each_joint_really_is() {
    let (mut limiter, clock, passed) = noted();
    let mut tell = |command| {
        clock.sleep_until(clock.now() + CYCLE);
        limiter.exchange(command).unwrap()
    };
    let mut desired = JointVector::zeros();
    (desired[3], desired[6]) = (1.6, 1.6);
    for _ in 0..130 {
        tell(JointCommand::Velocity(desired));
    }
    for _ in 0..40 {
        tell(JointCommand::Hold);
    }
    let measured = tell(rest()).velocity_rad_per_s;
    let Some(&JointCommand::Velocity(commanded)) = passed.lock().unwrap().last() else { panic!("no velocity") };
    assert!(measured[3] > 0.7 && measured[6] < 0.01, "{measured}");
    assert!((commanded - measured).amax() < 0.1, "commanded {commanded}, at {measured}");
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
    // The reply is discarded: the next command has no sample to use.
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
            .with(eq(velocity(0, 0.004)))
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

/// The arm's own ramp ends at rest: its deceleration is not continued beyond, against the direction that is asked for.
#[test]
fn after_a_lost_reply_no_joint_turns_around() {
    let (mut limiter, clock, commanded) = noted();
    for cycle in 0..20 {
        if cycle == 6 {
            limiter.arm().arm.faults().drop_replies(1);
        }
        clock.sleep_until(clock.now() + CYCLE);
        assert_eq!(limiter.exchange(velocity(1, 0.1)).is_err(), cycle == 6);
    }
    let commanded: Vec<f64> = commanded
        .lock()
        .unwrap()
        .iter()
        .map(|command| match command {
            JointCommand::Velocity(velocity) => velocity[1],
            JointCommand::Hold => 0.0,
        })
        .collect();
    assert!(commanded.iter().all(|&speed| speed >= 0.0) && commanded[5] > 0.05, "{commanded:?}");
}

#[test]
fn power_is_the_arms_own() {
    let (mut limiter, _) = scripted(|arm| {
        arm.expect_state().times(1).return_const(ArmState::EStop);
        for by_other in [true, false] {
            arm.expect_is_stopped_by_other().times(1).return_const(by_other);
        }
        let enable = PowerOrder::Enable(EnablePosition::Start);
        arm.expect_power().with(eq(enable)).times(1).returning(|_| Err(ArmError::new(ArmErrorKind::Fault, "latched")));
        for order in [PowerOrder::Stop, PowerOrder::Reset] {
            arm.expect_power().with(eq(order)).times(1).returning(|_| Ok(Poll::Ready(())));
        }
    });
    assert_eq!(limiter.state(), ArmState::EStop);
    assert!(limiter.is_stopped_by_other() && !limiter.is_stopped_by_other());
    assert_eq!(limiter.enable().unwrap_err().kind(), ArmErrorKind::Fault);
    limiter.stop().unwrap();
    limiter.reset().unwrap();
}

#[test]
fn refuses_numbers_that_are_none() {
    let refused = |change: fn(&mut LimiterConfig)| {
        let mut config = limiter_config();
        change(&mut config);
        Limiter::new(MockScriptedArm::new(), limits(0.6), config, Arc::new(VirtualClock::new())).err()
    };
    let nowhere = refused(|c| c.start = StartPose::Near { position_rad: JointVector::zeros(), tolerance_rad: 0.0 });
    assert_eq!(nowhere, Some(LimiterError::StartTolerance(0.0)));
    assert_eq!(refused(|c| c.stale_after = Duration::ZERO), Some(LimiterError::ZeroTime("the age of a stale sample")));
    assert_eq!(refused(|_| {}), None);
}

#[test]
fn limited_mock_arm_keeps_the_contract() {
    let clock = Arc::new(VirtualClock::new());
    let make = || {
        let arm = mock_arm(&clock, JointVector::from([0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1]));
        Limiter::new(arm, limits(0.6), limiter_config(), Arc::clone(&clock) as Arc<dyn Clock>).unwrap()
    };
    assert_contract(&clock, make, |limiter| limiter.arm());
}

/// Behaviour of a caller, or of the link behind the limiter, for some cycles.
#[derive(Clone, Debug)]
enum Action {
    Request([f64; DOF]),
    Reverse,
    NotFinite(usize, f64),
    Hold,
    /// Replies repeat the same sample.
    Freeze,
    LoseReply,
    /// No calls for this number of milliseconds.
    Silence(u64),
}

fn any_deed() -> impl Strategy<Value = Action> {
    prop_oneof![
        6 => prop::array::uniform7(-12.0..12.0f64).prop_map(Action::Request),
        2 => Just(Action::Request([f64::MAX, -f64::MAX, 1e300, 0.0, 1.0, -1.0, 1e-300])),
        2 => Just(Action::Reverse),
        1 => (0..DOF, prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY]))
            .prop_map(|(joint, value)| Action::NotFinite(joint, value)),
        1 => Just(Action::Hold),
        2 => Just(Action::Freeze),
        1 => Just(Action::LoseReply),
        1 => (1..200u64).prop_map(Action::Silence),
    ]
}

/// A sequence of actions, each for some cycles of up to 20 ms.
fn any_drive() -> impl Strategy<Value = Vec<(Action, Vec<u64>)>> {
    prop::collection::vec((any_deed(), prop::collection::vec(0..20u64, 1..100)), 1..25)
}

fn within_operating_range() -> impl Strategy<Value = JointVector> {
    let max = operating_range_rad();
    prop::array::uniform7(-0.999..0.999f64).prop_map(move |part| max.component_mul(&JointVector::from(part)))
}

/// A limited arm under test, and the limits of its set-points.
struct Wild {
    limiter: Limiter<Tampered>,
    clock: Arc<VirtualClock>,
    passed: Arc<Mutex<Vec<JointCommand>>>,
    frozen: Arc<Mutex<Option<Tamper>>>,
    speeds: JointVector,
    /// The last set-point, and its acceleration if the set-point before was consecutive; otherwise none.
    before: Option<(JointVector, Option<JointVector>)>,
    last_exchange: MonotonicTime,
}

impl Wild {
    fn new(start: JointVector, speed_scale: f64) -> Self {
        let clock = Arc::new(VirtualClock::new());
        let mut arm = mock_arm(&clock, start);
        arm.enable().unwrap();
        let (passed, frozen) = (Arc::new(Mutex::new(Vec::new())), Arc::default());
        let arm = Tampered { arm, commanded: Arc::clone(&passed), tamper: Arc::clone(&frozen) };
        let limiter =
            Limiter::new(arm, limits(speed_scale), limiter_config(), Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
        let speeds = *limits(speed_scale).velocity_max_rad_per_s();
        let last_exchange = clock.now();
        let mut wild = Self { limiter, clock, passed, frozen, speeds, before: None, last_exchange };
        wild.limiter.exchange(JointCommand::Hold).unwrap();
        wild
    }

    fn exchange(&mut self, command: JointCommand) -> Result<(), TestCaseError> {
        self.passed.lock().unwrap().clear();
        // Waiting for a lost reply takes time.
        let now = self.clock.now();
        let answer = self.limiter.exchange(command);
        let dt_s = now.seconds_since(self.last_exchange);
        self.last_exchange = now;
        let passed = std::mem::take(&mut *self.passed.lock().unwrap());
        let velocities = passed.iter().filter_map(|command| match command {
            JointCommand::Velocity(velocity) => Some(velocity),
            JointCommand::Hold => None,
        });
        for velocity in velocities {
            self.check(velocity, dt_s)?;
        }
        if answer.is_err() || passed.last() == Some(&JointCommand::Hold) {
            self.before = None;
        }
        if self.limiter.state() == ArmState::Fault {
            self.limiter.stop().unwrap();
            self.limiter.reset().unwrap();
            self.limiter.enable().unwrap();
            *self.frozen.lock().unwrap() = None;
        }
        Ok(())
    }

    fn check(&mut self, velocity: &JointVector, dt_s: f64) -> Result<(), TestCaseError> {
        for i in 0..DOF {
            prop_assert!(velocity[i].abs() <= self.speeds[i], "joint {i}: {velocity}");
        }
        let Some((before, acceleration_before)) = self.before else {
            self.before = Some((*velocity, None));
            return self.after_hold(velocity);
        };
        let change = velocity - before;
        for i in 0..DOF {
            let most = acceleration()[i] * dt_s + 1e-12;
            prop_assert!(change[i].abs() <= most, "joint {i}: {} rad/s in {dt_s} s", change[i]);
        }
        if dt_s == 0.0 {
            return Ok(());
        }
        let acceleration_now = change / dt_s;
        if let Some(acceleration_before) = acceleration_before {
            for i in 0..DOF {
                let change = (acceleration_now[i] - acceleration_before[i]).abs();
                prop_assert!(change <= jerk()[i] * dt_s + 1e-9, "joint {i}: {change} rad/s^2 in {dt_s} s");
            }
        }
        self.before = Some((*velocity, Some(acceleration_now)));
        Ok(())
    }

    fn after_hold(&self, velocity: &JointVector) -> Result<(), TestCaseError> {
        let sample = self.limiter.arm().arm.plant().lock().unwrap().state();
        let far = (velocity - sample.velocity_rad_per_s).abs().component_div(&acceleration()).max();
        // The lag of the drives is less than the motion of a tenth of a second.
        let moving = sample.velocity_rad_per_s;
        prop_assert!(far < 0.1 + COMMAND_TIMEOUT.as_secs_f64(), "{velocity} at {moving}");
        Ok(())
    }

    fn live_through(&mut self, drive: Vec<(Action, Vec<u64>)>) -> Result<(), TestCaseError> {
        let mut desired = JointVector::zeros();
        for (action, cycles) in drive {
            *self.frozen.lock().unwrap() = None;
            match action {
                Action::Request(velocity) => desired = velocity.into(),
                Action::Reverse => desired = -desired,
                Action::LoseReply => self.limiter.arm().arm.faults().drop_replies(1),
                Action::Silence(ms) => self.clock.sleep_until(self.clock.now() + Duration::from_millis(ms)),
                Action::Freeze => {
                    let newest = self.limiter.arm().arm.plant().lock().unwrap().state();
                    *self.frozen.lock().unwrap() = Some(Box::new(move |sample| *sample = newest));
                }
                Action::NotFinite(..) | Action::Hold => {}
            }
            for cycle_ms in cycles {
                self.clock.sleep_until(self.clock.now() + Duration::from_millis(cycle_ms));
                let mut velocity = desired;
                if let Action::NotFinite(joint, value) = action {
                    velocity[joint] = value;
                }
                let is_hold = matches!(action, Action::Hold);
                self.exchange(if is_hold { JointCommand::Hold } else { JointCommand::Velocity(velocity) })?;
            }
        }
        Ok(())
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    /// For any requested, lost, late or non-finite values: set-points keep speed, acceleration and jerk limits, and joints their
    /// range.
    #[test]
    fn nothing_drives_the_arm_beyond_its_limits(
        start in within_operating_range(), drive in any_drive(), scale in prop::sample::select(vec![0.1, 0.6, 1.0]),
    ) {
        let mut wild = Wild::new(start, scale);
        wild.live_through(drive)?;
        let end = wild.clock.now();
        wild.limiter.stop().unwrap();
        let plant = wild.limiter.arm().arm.plant();
        let plant = plant.lock().unwrap();
        let operating = operating_range_rad();
        let mut at = MonotonicTime::ZERO;
        while at <= end {
            let Some(position) = plant.position_at(at) else { break };
            let beyond = (position.abs() - operating).max();
            prop_assert!(beyond < 1e-5, "beyond the operating range by {beyond} rad at {at:?}: {position}");
            at = at + Duration::from_millis(3);
        }
    }
}
