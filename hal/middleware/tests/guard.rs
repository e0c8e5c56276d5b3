//! The guard around a mock arm with modified answers.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::{
    CYCLE, Tamper, Tampered, assert_contract, guard_config, limiter_config, limits, mock_arm, servo_limits, velocity,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand, JointState};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_middleware::{Guard, GuardConfig, GuardError, Limiter};
use pb3dp_kinematics::{DOF, JointVector};
use proptest::prelude::*;

const START: [f64; DOF] = [0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1];

/// An enabled, guarded arm, and the handles to disturb it.
struct Bench {
    guard: Guard<Tampered>,
    clock: Arc<VirtualClock>,
    tamper: Arc<Mutex<Option<Tamper>>>,
    commanded: Arc<Mutex<Vec<JointCommand>>>,
}

impl Bench {
    fn new(start: [f64; DOF], speed_scale: f64) -> Self {
        let clock = Arc::new(VirtualClock::new());
        let (tamper, commanded) = (Arc::new(Mutex::new(None)), Arc::new(Mutex::new(Vec::new())));
        let arm = Tampered {
            arm: mock_arm(&clock, start.into()),
            tamper: Arc::clone(&tamper),
            commanded: Arc::clone(&commanded),
        };
        let mut guard = Guard::new(arm, limits(speed_scale), guard_config()).unwrap();
        guard.enable().unwrap();
        Self { guard, clock, tamper, commanded }
    }

    fn tamper(&self, with: impl FnMut(&mut JointState) + Send + 'static) {
        *self.tamper.lock().unwrap() = Some(Box::new(with));
    }

    fn step(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        self.clock.sleep_until(self.clock.now() + CYCLE);
        self.guard.exchange(command)
    }

    /// Commands the velocity until it is refused; returns the time.
    fn until_refused(&mut self, command: JointCommand, at_most: Duration) -> Option<(Duration, ArmError)> {
        let begin = self.clock.now();
        while self.clock.now() < begin + at_most {
            if let Err(error) = self.step(command) {
                return Some((self.clock.now().saturating_since(begin), error));
            }
        }
        None
    }

    fn last_command(&self) -> JointCommand {
        *self.commanded.lock().unwrap().last().unwrap()
    }

    /// Latched: velocities are refused and do not reach the arm, hold works, and only a reset ends the latch and leads to
    /// `Disabled`.
    fn assert_latched_until_reset(&mut self) {
        assert_eq!(self.last_command(), JointCommand::Hold);
        assert_eq!(self.guard.state(), ArmState::Fault);
        let error = self.step(velocity(2, 0.05)).unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Fault);
        assert!(error.to_string().contains("remove the cause, then reset"), "{error}");
        assert_eq!(self.last_command(), JointCommand::Hold);
        self.step(JointCommand::Hold).unwrap();
        assert_eq!(self.guard.enable().unwrap_err().kind(), ArmErrorKind::Fault);
        *self.tamper.lock().unwrap() = None;
        self.guard.reset().unwrap();
        assert_eq!((self.guard.state(), self.guard.latched()), (ArmState::Disabled, None));
        self.guard.enable().unwrap();
        self.step(velocity(2, 0.05)).unwrap();
    }
}

#[test]
fn a_joint_that_does_not_follow_its_command_stops_the_arm() {
    let mut bench = Bench::new(START, 0.6);
    bench.step(JointCommand::Hold).unwrap();
    let stuck_at = START[3];
    bench.tamper(move |sample| {
        sample.position_rad[3] = stuck_at;
        sample.velocity_rad_per_s[3] = 0.0;
    });
    // At 0.5 rad/s, after a ramp of a quarter of a second, the error reaches 0.05 rad after 0.05 / 0.5 + 0.125 s and the lag, and
    // is a fault 0.1 s later.
    let (after, error) = bench.until_refused(velocity(3, 0.5), Duration::from_secs(2)).unwrap();
    assert_eq!(error.kind(), ArmErrorKind::Fault);
    assert!(error.to_string().contains("axis 4 is -") && error.to_string().contains("commanded position"), "{error}");
    assert_eq!((error.joint(), error.code()), (Some(3), None));
    let expected = Duration::from_millis(100 + 125 + 45 + 100);
    assert!(after.abs_diff(expected) < Duration::from_millis(60), "{after:?}");
    bench.assert_latched_until_reset();
}

/// While an arm is being enabled, it is measured again, perhaps after a long pause; from then on a joint that moves by itself is
/// detected before any motion is commanded.
#[test]
fn an_arm_that_is_being_switched_on_is_watched_from_its_first_fresh_sample_on() {
    let mut bench = Bench::new(START, 0.6);
    bench.guard.stop().unwrap();
    bench.guard.begin_enable().unwrap();
    bench.step(JointCommand::Hold).unwrap();
    // A person turned the joint by hand, with closed brakes.
    bench.tamper(|sample| sample.position_rad[2] += 0.4);
    bench.clock.sleep_until(bench.clock.now() + Duration::from_secs(3));
    assert!(bench.until_refused(JointCommand::Hold, Duration::from_secs(1)).is_none());
    let mut went_rad = 0.4;
    bench.tamper(move |sample| {
        went_rad += 0.5 * CYCLE.as_secs_f64();
        sample.position_rad[2] += went_rad;
        sample.velocity_rad_per_s[2] = 0.5;
    });
    let (after, error) = bench.until_refused(JointCommand::Hold, Duration::from_secs(1)).unwrap();
    assert!(error.to_string().contains("axis 3 is +") && error.to_string().contains("commanded position"), "{error}");
    assert!(after < Duration::from_millis(250), "{after:?}");
    assert_eq!(bench.guard.poll_enable().unwrap_err().kind(), ArmErrorKind::Fault);
    assert_eq!(bench.guard.state(), ArmState::Fault);
}

/// An enabled arm is monitored across a gap in its samples: an unreachable position is a wrong sample.
#[test]
fn an_arm_that_is_on_is_not_measured_anew() {
    let mut bench = Bench::new(START, 0.6);
    bench.guard.stop().unwrap();
    bench.guard.begin_enable().unwrap();
    assert!(bench.guard.poll_enable().unwrap());
    bench.step(JointCommand::Hold).unwrap();
    bench.tamper(|sample| sample.position_rad[2] += 2.0);
    bench.clock.sleep_until(bench.clock.now() + Duration::from_millis(200));
    assert!(bench.step(JointCommand::Hold).is_err());
}

/// At the speed of a jog, 0.02 rad/s: the error reaches 0.05 rad after 2.8 s, because 0.002 rad/s may be drift.
#[test]
fn a_joint_that_is_blocked_in_a_jog_stops_the_arm() {
    let mut bench = Bench::new(START, 0.1);
    bench.step(JointCommand::Hold).unwrap();
    bench.tamper(|sample| (sample.position_rad[6], sample.velocity_rad_per_s[6]) = (START[6], 0.0));
    let (after, error) = bench.until_refused(velocity(6, 0.02), Duration::from_secs(8)).unwrap();
    assert!(error.to_string().contains("axis 7 is -2.") && error.to_string().contains("commanded position"), "{error}");
    assert!(after > Duration::from_millis(2700) && after < Duration::from_millis(3100), "{after:?}");
    bench.assert_latched_until_reset();
}

#[test]
fn a_joint_that_moves_by_itself_stops_the_arm() {
    let mut bench = Bench::new(START, 0.6);
    let mut drift = 0.0;
    bench.tamper(move |sample| {
        drift += 0.002;
        sample.position_rad[1] -= drift;
        sample.velocity_rad_per_s[1] -= 0.2;
    });
    let (_, error) = bench.until_refused(JointCommand::Hold, Duration::from_secs(2)).unwrap();
    assert!(error.to_string().contains("axis 2 is -") && error.to_string().contains("pushed"), "{error}");
    bench.assert_latched_until_reset();
}

#[test]
fn one_sample_that_jumps_is_thrown_away_and_two_stop_the_arm() {
    let mut bench = Bench::new(START, 0.6);
    bench.step(velocity(6, 0.3)).unwrap();
    let bad = |times: u32| {
        let mut left = times;
        move |sample: &mut JointState| {
            if left > 0 {
                left -= 1;
                sample.position_rad[6] += 0.3;
            }
        }
    };
    bench.tamper(bad(1));
    let error = bench.step(velocity(6, 0.3)).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Timeout);
    assert!(error.to_string().contains("axis 7 seems to have moved by +17."), "{error}");
    assert_eq!(bench.last_command(), JointCommand::Hold);
    bench.step(velocity(6, 0.3)).unwrap();
    assert_eq!(bench.guard.latched(), None);
    // The guard commands a hold after each wrong sample, and the answer to the hold is wrong as well.
    bench.tamper(bad(3));
    assert_eq!(bench.step(velocity(6, 0.3)).unwrap_err().kind(), ArmErrorKind::Timeout);
    assert_eq!(bench.step(velocity(6, 0.3)).unwrap_err().kind(), ArmErrorKind::Fault);
    bench.assert_latched_until_reset();
}

/// Every second sample is wrong: never two in a row.
#[test]
fn samples_of_which_every_second_jumps_stop_the_arm() {
    let mut bench = Bench::new(START, 0.6);
    bench.step(JointCommand::Hold).unwrap();
    let mut samples = 0;
    bench.tamper(move |sample| {
        samples += 1;
        // The guard asks once more after a wrong sample, and discards that answer.
        if samples % 3 == 1 {
            sample.position_rad[3] += 0.2;
        }
    });
    let begin = bench.clock.now();
    let latched =
        (0..100).find_map(|_| bench.step(JointCommand::Hold).err().filter(|e| e.kind() == ArmErrorKind::Fault));
    let (text, after) = (latched.unwrap().to_string(), bench.clock.now().saturating_since(begin));
    assert!(text.contains("5 of the last 100 samples jump"), "{text}");
    assert!(after <= Duration::from_millis(100), "{after:?}");
    bench.assert_latched_until_reset();
}

/// By hand: 0.0015 rad/s reach 0.02 rad after 15.1 s; more are the half second in which the joints settle, and the last second.
#[test]
fn a_joint_that_creeps_while_the_arm_holds_stops_the_arm() {
    let mut bench = Bench::new(START, 0.6);
    let mut crept = 0.0;
    bench.tamper(move |sample| {
        crept += 0.0015 * CYCLE.as_secs_f64();
        sample.position_rad[1] += crept;
    });
    let (after, error) = bench.until_refused(JointCommand::Hold, Duration::from_secs(60)).unwrap();
    assert_eq!((error.kind(), error.joint()), (ArmErrorKind::Fault, Some(1)));
    assert!(error.to_string().contains("axis 2 has crept by +1.2"), "{error}");
    assert!((16.0..17.5).contains(&after.as_secs_f64()), "{after:?}");
}

/// A joint that settles by half a degree after a stop is no creep, however often.
#[test]
fn joints_that_settle_after_each_stop_creep_not() {
    let mut bench = Bench::new(START, 0.6);
    for round in 0..30 {
        let speed = if round % 2 == 0 { 0.2 } else { -0.2 };
        assert!(bench.until_refused(velocity(2, speed), Duration::from_secs(1)).is_none());
        assert!(bench.until_refused(JointCommand::Hold, Duration::from_secs(2)).is_none());
    }
}

#[test]
fn a_sample_that_is_no_number_is_no_sample() {
    let mut bench = Bench::new(START, 0.6);
    bench.step(velocity(0, 0.1)).unwrap();
    let mut left = 1;
    bench.tamper(move |sample| {
        if left > 0 {
            left -= 1;
            sample.position_rad[5] = f64::NAN;
        }
    });
    assert_eq!(bench.step(velocity(0, 0.1)).unwrap_err().kind(), ArmErrorKind::Timeout);
    bench.step(velocity(0, 0.1)).unwrap();
    bench.tamper(|sample| sample.velocity_rad_per_s[5] = f64::NAN);
    assert!(bench.until_refused(velocity(0, 0.1), CYCLE * 3).is_some());
    bench.assert_latched_until_reset();
}

#[test]
fn a_joint_that_is_too_fast_twice_stops_the_arm() {
    let mut bench = Bench::new(START, 0.1);
    bench.step(JointCommand::Hold).unwrap();
    // Allowed for joint 2 are 0.1 x 2 rad/s, and 1.1 times this speed for a short time.
    for (speed, samples, is_stopped) in [(0.219, 50, false), (0.3, 1, false), (0.221, 2, true)] {
        let mut left = samples;
        bench.tamper(move |sample| {
            if left > 0 {
                left -= 1;
                sample.velocity_rad_per_s[2] = -speed;
            }
        });
        let refused = bench.until_refused(JointCommand::Hold, CYCLE * (samples + 1));
        assert_eq!(refused.is_some(), is_stopped, "{speed} rad/s in {samples} samples: {refused:?}");
        if let Some((_, error)) = refused {
            let text = error.to_string();
            assert!(text.contains("axis 3 moves at -0.221 rad/s, the limit is 0.200 rad/s"), "{text}");
        }
    }
    bench.assert_latched_until_reset();
}

#[test]
fn a_joint_beyond_its_limits_stops_the_arm() {
    let mut bench = Bench::new(START, 0.6);
    let inside = |sample: &mut JointState| sample.position_rad[1] = 90.9_f64.to_radians();
    bench.tamper(inside);
    bench.step(JointCommand::Hold).unwrap();
    bench.tamper(|sample| sample.position_rad[1] = 91.5_f64.to_radians());
    let error = bench.step(JointCommand::Hold).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Fault);
    assert!(error.to_string().contains("axis 2 is at 91.50 degrees, beyond its limits -91.00 to 91.00"), "{error}");
    bench.assert_latched_until_reset();
}

/// S2 is 0.03 rad beyond its servo limit when the arm is enabled: it may move back, but not further out, and not out again.
#[test]
fn a_joint_that_is_found_beyond_its_limits_may_come_back() {
    let limit = servo_limits().position_max_rad()[1];
    let mut start = START;
    start[1] = limit - 0.02;
    let shown_beyond = |sample: &mut JointState| sample.position_rad[1] += 0.05;
    let mut bench = Bench::new(start, 0.6);
    bench.tamper(shown_beyond);
    bench.step(JointCommand::Hold).unwrap();
    let (_, error) = bench.until_refused(velocity(1, 0.05), Duration::from_secs(1)).unwrap();
    assert!(error.to_string().contains("axis 2 is at 9"), "{error}");
    assert_eq!(bench.guard.state(), ArmState::Fault);
    bench.guard.reset().unwrap();
    bench.guard.enable().unwrap();
    assert!(bench.until_refused(velocity(1, -0.1), Duration::from_secs(1)).is_none(), "the way back");
    let (_, error) = bench.until_refused(velocity(1, 0.1), Duration::from_secs(3)).unwrap();
    assert!(error.to_string().contains("axis 2 is at 9"), "{error}");
}

#[test]
fn a_joint_where_none_can_be_has_a_wrong_encoder() {
    let mut bench = Bench::new(START, 0.6);
    bench.tamper(|sample| sample.position_rad[3] = -143.1_f64.to_radians());
    let error = bench.step(JointCommand::Hold).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Fault);
    assert!(error.to_string().contains("axis 4 is at -143.10 degrees, beyond its mechanical stops"), "{error}");
    bench.assert_latched_until_reset();
}

#[test]
fn the_emergency_stop_and_the_arms_own_faults_come_first() {
    let mut bench = Bench::new(START, 0.6);
    bench.guard.arm().arm.faults().press_e_stop();
    assert_eq!(bench.guard.state(), ArmState::EStop);
    assert!(bench.guard.reset().is_err(), "it is still pressed");
    bench.tamper(|sample| sample.position_rad[1] = 2.0);
    assert!(bench.step(JointCommand::Hold).is_err());
    assert_eq!(bench.guard.state(), ArmState::EStop);
    assert!(bench.guard.reset().is_err() && bench.guard.latched().is_some());
}

#[test]
fn refuses_numbers_that_are_none() {
    let refused = |change: fn(&mut GuardConfig)| {
        let mut config = guard_config();
        change(&mut config);
        Guard::new(mock_arm(&Arc::new(VirtualClock::new()), START.into()), limits(0.6), config).err()
    };
    assert_eq!(refused(|c| c.ripple_rad_per_s = -0.1), Some(GuardError::Ripple(-0.1)));
    assert!(matches!(refused(|c| c.ripple_rad_per_s = f64::NAN), Some(GuardError::Ripple(_))));
    let narrow = refused(|c| c.mechanical_max_rad[1] = 1.5);
    assert!(matches!(narrow, Some(GuardError::MechanicalRange(_))), "{narrow:?}");
    assert!(matches!(refused(|c| c.tracking_error_max_rad = f64::NAN), Some(GuardError::TrackingError(_))));
    assert_eq!(refused(|_| {}), None);
}

#[test]
fn guarded_mock_arm_keeps_the_contract() {
    let clock = Arc::new(VirtualClock::new());
    let make = || Guard::new(mock_arm(&clock, START.into()), limits(0.6), guard_config()).unwrap();
    assert_contract(&clock, make, |guard| guard.arm());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    /// Behind the limiter, an arm that follows its commands is never stopped, for any commands.
    #[test]
    fn an_arm_that_follows_is_left_alone(
        start in prop::array::uniform7(-1.2..1.2f64),
        drive in prop::collection::vec((prop::array::uniform7(-8.0..8.0f64), 5..20u64, 1..150usize, any::<bool>()), 1..20),
        scale in prop::sample::select(vec![0.1, 0.6, 1.0]),
    ) {
        let clock = Arc::new(VirtualClock::new());
        let guard = Guard::new(mock_arm(&clock, start.into()), limits(scale), guard_config()).unwrap();
        let mut limiter = Limiter::new(guard, limits(scale), limiter_config(), Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
        limiter.enable().unwrap();
        limiter.exchange(JointCommand::Hold).unwrap();
        let mut at = MonotonicTime::ZERO;
        for (velocity, cycle_ms, cycles, holds) in drive {
            for _ in 0..cycles {
                at = at + Duration::from_millis(cycle_ms);
                clock.sleep_until(at);
                let command = if holds { JointCommand::Hold } else { JointCommand::Velocity(JointVector::from(velocity)) };
                let answer = limiter.exchange(command);
                prop_assert!(answer.is_ok(), "{:?}", answer.map_err(|error| error.to_string()));
            }
        }
    }
}

/// A joint that no longer follows its drive moves although the arm holds: the part that can close the brakes gets one report at
/// once.
#[test]
fn the_brakes_are_commanded_when_the_guard_stops_the_arm() {
    let clock = Arc::new(VirtualClock::new());
    let commanded = Arc::new(Mutex::new(0));
    let count = Arc::clone(&commanded);
    let mut guard =
        Guard::new(mock_arm(&clock, START.into()), limits(0.1), guard_config()).unwrap().on_stop(move || {
            *count.lock().unwrap() += 1;
        });
    guard.enable().unwrap();
    for cycle in 0..50 {
        clock.sleep_until(clock.now() + CYCLE);
        // Ten times the allowed speed.
        let stopped = guard.exchange(velocity(0, 1.0)).is_err();
        assert_eq!(*commanded.lock().unwrap(), u32::from(guard.latched().is_some()), "cycle {cycle}, {stopped}");
    }
    assert_eq!(*commanded.lock().unwrap(), 1);
}
