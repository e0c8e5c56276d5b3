//! Each condition alone: detection, action, and how motion resumes.

use std::time::Duration;

use nalgebra::Matrix6;
use pb3dp_servo::supervisor::{
    Action, ArmCondition, Condition, Confidence, Detail, Event, FrameInput, Innovation, Inputs, OperatorCommand,
    Permission, RangeEnd, Resume, State, TRANSITIONS_KEPT, Why,
};
use pb3dp_servo::{HoldReason, Mode};

use super::bench::{Bench, STEP_S, at, config, with};

/// A change of the inputs.
type Lie = Box<dyn Fn(&mut Inputs)>;
/// The change of the inputs that causes a condition from this time on.
type Trouble = fn(f64) -> Lie;

/// Each condition, the inputs that cause it, and its value unless the value grows with time.
fn troubles() -> Vec<(Condition, Trouble, Option<f64>)> {
    vec![
        (Condition::EmergencyStop, |_| Box::new(|i| i.arms[1].state = ArmCondition::EmergencyStop), Some(0.0)),
        (Condition::ArmFault, |_| Box::new(|i| i.arms[0].state = ArmCondition::Fault), Some(0.0)),
        (Condition::ArmDisabled, |_| Box::new(|i| i.arms[1].state = ArmCondition::Disabled), Some(0.0)),
        (Condition::ClockStepped, |t| Box::new(move |i| i.arms[0].measured_at = Some(at(t + 60.0))), None),
        (Condition::OperatorSilent, |t| Box::new(move |i| i.operator.heartbeat_at = Some(at(t))), None),
        (Condition::JointsStale, |t| Box::new(move |i| i.arms[1].measured_at = Some(at(t))), None),
        (Condition::TargetChanged, |_| Box::new(|i| i.estimate.as_mut().unwrap().target = 8), Some(0.0)),
        (
            Condition::FrameStale,
            |t| {
                Box::new(move |i| i.frame = Some(FrameInput { sequence: (t * 1e3) as u64 + 1, at: at(t), skew_s: 0.0 }))
            },
            None,
        ),
        (Condition::FrameOrder, |_| Box::new(|i| i.frame.as_mut().unwrap().sequence = 5), Some(0.0)),
        (
            Condition::Miscalibrated,
            |_| Box::new(|i| i.estimate.as_mut().unwrap().confidence = Confidence::Miscalibrated),
            Some(0.0),
        ),
        (Condition::EstimateStale, |t| Box::new(move |i| i.estimate.as_mut().unwrap().at = at(t)), None),
        (
            Condition::LowConfidence,
            |_| Box::new(|i| i.estimate.as_mut().unwrap().confidence = Confidence::Doubtful),
            Some(0.0),
        ),
        (
            Condition::PositionJump,
            |_| Box::new(|i| i.innovation = Innovation::Jump { position_m: 0.3, orientation_rad: 0.0 }),
            Some(0.3),
        ),
        (
            Condition::OrientationJump,
            |_| Box::new(|i| i.innovation = Innovation::Jump { position_m: 0.0, orientation_rad: 0.9 }),
            Some(0.9),
        ),
        (Condition::Outlier, |_| Box::new(|i| i.innovation = Innovation::Outlier { sigmas: 9.0 }), Some(9.0)),
        (Condition::PositionUncertain, |_| deviating(0, [0.003, 0.004, 0.012]), Some(0.013)),
        (Condition::OrientationUncertain, |_| deviating(3, [0.12, 0.03, 0.04]), Some(0.13)),
        (Condition::CameraSkew, |_| Box::new(|i| i.frame.as_mut().unwrap().skew_s = -0.007), Some(0.007)),
        (
            Condition::LimitNear,
            |_| Box::new(|i| i.range_end = Some(RangeEnd { joint: 5, distance_rad: 0.01 })),
            Some(0.01),
        ),
        (Condition::Singularity, |_| Box::new(|i| i.smallest_singular_value = Some(0.012)), Some(0.012)),
        (
            Condition::ControllerRests,
            |_| Box::new(|i| i.controller = Mode::Holding(HoldReason::JointRange { joint: 2 })),
            Some(0.0),
        ),
        (Condition::LateImages, |_| Box::new(|i| i.images_late_s = Some(0.125)), Some(0.125)),
    ]
}

/// Covariance with these standard deviations for three components of the pose, from index `first`.
fn deviating(first: usize, sigmas: [f64; 3]) -> Lie {
    let mut covariance = Matrix6::zeros();
    for (index, sigma) in sigmas.into_iter().enumerate() {
        covariance[(first + index, first + index)] = sigma * sigma;
    }
    Box::new(move |i| i.estimate.as_mut().unwrap().covariance = Some(covariance))
}

/// All conditions except the loss, which is detected only after a stale estimate.
#[test]
fn each_condition_does_what_its_policy_says_when_it_has_lasted() {
    let troubles = troubles();
    assert_eq!(troubles.len() + 1, Condition::COUNT);
    for (condition, trouble, value) in troubles {
        let policy = *config().policies.get(condition);
        let name = condition.key();
        let mut bench = Bench::following(config());
        let (begun_s, found_before) = (bench.now_s, bench.steps_found[condition as usize]);
        bench.lie = trouble(bench.now_s);
        let mut moved_steps: u32 = 0;
        while bench.steps_found[condition as usize] == found_before && !bench.state().is_latched() {
            assert!(bench.now_s - begun_s < 1.5, "{name} is not detected");
            moved_steps += 1;
            let decision = bench.step();
            let is_effective = decision.permission != Permission::Move { share: 1.0 };
            let is_found = bench.steps_found[condition as usize] > found_before || decision.state.is_latched();
            assert!(!is_effective || is_found, "{name}: {}", decision.why);
        }
        let lasted_s = f64::from(moved_steps - 1) * STEP_S;
        assert!(lasted_s > policy.for_s - 1e-9, "{name} acted after {lasted_s} s");
        let decision = bench.decision();
        match policy.action {
            Action::Note => assert_eq!(decision.permission, Permission::Move { share: 1.0 }, "{name}"),
            Action::Slow(share) => assert_eq!(decision.permission, Permission::Move { share }, "{name}"),
            Action::Hold => assert_eq!((decision.permission, decision.state), (Permission::Hold, State::Holding)),
            Action::Stop => assert_eq!((decision.permission, decision.state), (Permission::Stop, State::Stopped)),
            Action::Fault => assert_eq!((decision.permission, decision.state), (Permission::Stop, State::Fault)),
        }
        assert_eq!(decision.rearm, policy.action.is_rest(), "{name}: each hold or stop drops the set-points");
        let Some(transition) = decision.transition else {
            assert!(!policy.action.is_rest(), "{name}");
            continue;
        };
        let cause = transition.cause.unwrap();
        assert_eq!((transition.from, cause.condition), (State::Tracking, condition), "{name}: {transition:?}");
        if let Some(value) = value {
            assert!((cause.value - value).abs() < 1e-9, "{name}: {cause:?}");
        }
        if condition.rule().threshold.is_some() && condition != Condition::ClockStepped {
            assert_eq!(cause.threshold, policy.threshold);
            assert!(cause.value > policy.threshold, "{cause:?}");
        }
    }
}

/// The loop of late images must not grow while the supervisor waits.
#[test]
fn late_images_slow_the_hand_at_once_and_hold_it_then() {
    let late = with(Condition::LateImages, |policy| policy.for_s = 0.1);
    let mut bench = Bench::following(late);
    bench.lie(|i| i.images_late_s = Some(0.125));
    let decision = bench.step();
    assert_eq!(decision.permission, Permission::Move { share: 0.3 }, "{}", decision.why);
    assert!(bench.why().contains("125 ms"), "{}", bench.why());
    bench.run(0.15);
    assert_eq!(bench.state(), State::Holding);
    // A policy that only notes it does not slow the hand either.
    let mut bench = Bench::following(with(Condition::LateImages, |policy| policy.action = Action::Note));
    bench.lie(|i| i.images_late_s = Some(0.125));
    bench.run(0.2);
    assert_eq!(bench.decision().permission, Permission::Move { share: 1.0 });
}

/// After the cause is gone, motion resumes automatically only if the policy allows it.
#[test]
fn each_rest_ends_as_its_policy_says() {
    for (condition, trouble, _) in troubles() {
        let policy = *config().policies.get(condition);
        if policy.action != Action::Hold {
            continue;
        }
        let name = condition.key();
        let mut bench = Bench::following(config());
        bench.lie = trouble(bench.now_s);
        bench.run(0.6);
        assert_eq!(bench.state(), State::Holding, "{name}");
        bench.truth();
        let moved = bench.run(3.0);
        assert_eq!(moved, policy.resume == Resume::ByItself, "{name}: {}", bench.why());
        if !moved {
            assert_eq!(bench.state(), State::Holding, "{name}");
            assert!(bench.decision().is_ready, "{name}: {}", bench.why());
            let decision = bench.say(OperatorCommand::Resume);
            assert_eq!(decision.state, State::Approaching, "{name}: {}", decision.why);
        }
    }
}

#[test]
fn a_cause_that_comes_and_goes_within_its_time_does_nothing() {
    let mut bench = Bench::following(config());
    for _ in 0..20 {
        bench.lie(|i| i.frame.as_mut().unwrap().skew_s = 0.02);
        bench.run(0.06);
        bench.truth();
        bench.run(0.06);
    }
    assert_eq!(bench.state(), State::Tracking);
    assert_eq!(bench.steps_found[Condition::CameraSkew as usize], 0);
}

#[test]
fn an_invisible_target_is_stale_first_and_lost_later() {
    let mut bench = Bench::following(config());
    let begun_s = bench.now_s;
    bench.lie(|i| i.estimate.as_mut().unwrap().confidence = Confidence::NoPose);
    let mut transitions = Vec::new();
    for _ in 0..150 {
        if let Some(transition) = bench.step().transition {
            let cause = transition.cause.unwrap();
            transitions.push((transition.to, transition.event, cause.condition));
            let age_s = transition.at.as_secs_f64() - begun_s;
            let allowed_s = cause.threshold;
            assert!((age_s - allowed_s).abs() < 0.06 && cause.value > allowed_s && cause.value < allowed_s + 0.02);
        }
    }
    let expected = [
        (State::Holding, Event::HoldFound, Condition::EstimateStale),
        (State::Lost, Event::LossFound, Condition::TargetLost),
    ];
    assert_eq!(transitions, expected);
}

#[test]
fn the_most_severe_action_counts_and_the_smallest_share() {
    let mut bench = Bench::following(config());
    bench.lie(|i| {
        i.range_end = Some(RangeEnd { joint: 0, distance_rad: 0.02 });
        i.estimate.as_mut().unwrap().confidence = Confidence::Doubtful;
    });
    bench.run(0.2);
    let decision = bench.decision();
    assert_eq!(decision.permission, Permission::Move { share: 0.3 });
    let Why::Slowed { cause, .. } = decision.why else { panic!("{}", decision.why) };
    assert_eq!((cause.condition, cause.detail), (Condition::LimitNear, Detail::Joint(0)));
    bench.lie(|i| {
        i.range_end = Some(RangeEnd { joint: 0, distance_rad: 0.02 });
        i.arms[0].measured_at = None;
        i.arms[1].state = ArmCondition::Fault;
    });
    let decision = bench.step();
    assert_eq!((decision.state, decision.permission), (State::Fault, Permission::Stop));
    assert_eq!(decision.transition.unwrap().cause.unwrap().condition, Condition::ArmFault);
}

/// Both arms are stopped, but only one of them reports the fault.
#[test]
fn the_arm_that_failed_is_named_and_not_the_one_that_stopped_with_it() {
    for failed in 0..2 {
        let mut bench = Bench::following(config());
        bench.lie(move |i| {
            i.arms[failed].state = ArmCondition::Fault;
            i.arms[1 - failed].state = ArmCondition::StoppedByOther;
        });
        let cause = bench.step().transition.unwrap().cause.unwrap();
        assert_eq!((cause.condition, cause.detail), (Condition::ArmFault, Detail::Arm(failed)));
    }
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[1].state = ArmCondition::StoppedByOther);
    assert_eq!(bench.step().state, State::Fault, "whatever the other arm reports");
}

#[test]
fn a_policy_may_be_stricter_than_it_has_to() {
    let strict = with(Condition::CameraSkew, |policy| (policy.action, policy.for_s) = (Action::Fault, 0.0));
    let mut bench = Bench::following(strict);
    bench.lie(|i| i.frame.as_mut().unwrap().skew_s = 0.006);
    bench.run(0.05);
    assert_eq!(bench.state(), State::Fault);
    let strict = with(Condition::TargetLost, |policy| policy.action = Action::Stop);
    let mut bench = Bench::following(strict);
    bench.lie(|i| i.estimate = None);
    bench.run(1.5);
    assert_eq!((bench.state(), bench.decision().permission), (State::Stopped, Permission::Stop));
}

#[test]
fn numbers_that_are_none_count_as_the_worst() {
    let mut nan = Matrix6::from_diagonal_element(1e-8);
    nan[(4, 4)] = f64::NAN;
    let mut negative = Matrix6::from_diagonal_element(1e-8);
    negative[(1, 1)] = -1e-9;
    let lies: [(Condition, Lie); 5] = [
        (Condition::OrientationUncertain, Box::new(move |i| i.estimate.as_mut().unwrap().covariance = Some(nan))),
        (Condition::PositionUncertain, Box::new(move |i| i.estimate.as_mut().unwrap().covariance = Some(negative))),
        (Condition::CameraSkew, Box::new(|i| i.frame.as_mut().unwrap().skew_s = f64::NAN)),
        (Condition::LimitNear, Box::new(|i| i.range_end = Some(RangeEnd { joint: 1, distance_rad: f64::NAN }))),
        (Condition::Singularity, Box::new(|i| i.smallest_singular_value = Some(f64::NAN))),
    ];
    for (condition, lie) in lies {
        let mut bench = Bench::following(config());
        bench.lie = lie;
        bench.run(0.5);
        assert!(bench.steps_found[condition as usize] > 0, "{}", condition.key());
    }
}

/// An occluded target does not make its last pose more accurate. Regression: the hand kept moving until this pose was stale.
#[test]
fn a_pose_that_is_too_uncertain_stays_so_until_there_is_another_one() {
    for first in [0, 3] {
        let mut bench = Bench::following(config());
        bench.lie(move |i| i.estimate.as_mut().unwrap().covariance = Some(deviating_by(first, 2.0)));
        bench.run(0.2);
        assert_eq!(bench.state(), State::Holding, "{}", bench.why());
        bench.lie(|i| {
            let estimate = i.estimate.as_mut().unwrap();
            (estimate.confidence, estimate.covariance) = (Confidence::NoPose, None);
        });
        assert!(!bench.run(2.0), "{}", bench.why());
        bench.truth();
        assert!(bench.run(0.3), "{}", bench.why());
    }
}

/// Pairs that are late by almost the age at which an estimate is stale, and then uncertain, or of exposures that are apart: their time
/// does not add to the age of the last usable pose.
#[test]
fn doubts_about_late_poses_hold_the_hand_once_the_last_usable_pose_is_stale() {
    const LATE_S: f64 = 0.2;
    let late = |i: &mut Inputs| {
        let estimate = i.estimate.as_mut().unwrap();
        estimate.at = estimate.at - Duration::from_secs_f64(LATE_S);
        i.frame.as_mut().unwrap().at = estimate.at;
    };
    let lasting = |condition: Condition| {
        let mut config = config();
        config.policies.get_mut(condition).for_s = 0.4;
        config
    };
    type Doubt = fn(&mut Inputs);
    let cases: [(Condition, Doubt); 3] = [
        (Condition::PositionUncertain, |i| i.estimate.as_mut().unwrap().covariance = Some(deviating_by(0, 0.05))),
        (Condition::OrientationUncertain, |i| i.estimate.as_mut().unwrap().covariance = Some(deviating_by(3, 0.4))),
        (Condition::CameraSkew, |i| i.frame.as_mut().unwrap().skew_s = 0.02),
    ];
    for (condition, doubt) in cases {
        let mut bench = Bench::following(lasting(condition));
        bench.lie(late);
        bench.run(1.0);
        assert_eq!(bench.state(), State::Tracking, "{}", bench.why());
        let since_s = bench.now_s;
        bench.lie(move |i| {
            late(i);
            if i.frame.unwrap().at > at(since_s - LATE_S) {
                doubt(i);
            }
        });
        while bench.state() == State::Tracking {
            assert!(bench.now_s < since_s + 1.0, "{condition:?}");
            bench.step();
        }
        let held_after_s = bench.now_s - since_s;
        let stale_s = config().policies.get(Condition::EstimateStale).threshold;
        assert!(held_after_s <= stale_s - LATE_S + 0.05, "{condition:?}: {held_after_s} s");
        assert!(bench.decision().found.contains(condition), "{condition:?}: {}", bench.why());
    }
}

fn deviating_by(first: usize, sigma: f64) -> Matrix6<f64> {
    let mut covariance = Matrix6::from_diagonal_element(1e-8);
    covariance[(first, first)] = sigma * sigma;
    covariance
}

/// A method without a covariance reports no uncertainty: only the other conditions apply.
#[test]
fn a_method_without_covariance_is_not_held_for_it() {
    let mut bench = Bench::new(config());
    bench.lie(|i| i.estimate.as_mut().unwrap().covariance = None);
    bench.begin();
    assert!(bench.run(1.0));
    assert_eq!(bench.supervisor.log().total(), 3);
}

#[test]
fn transitions_are_kept_in_order_and_the_oldest_go() {
    let mut bench = Bench::following(config());
    let first = bench.supervisor.log().iter().map(|t| (t.from, t.to, t.event)).collect::<Vec<_>>();
    let expected = [
        (State::Idle, State::Selecting, Event::Select),
        (State::Selecting, State::Approaching, Event::Start),
        (State::Approaching, State::Tracking, Event::Reached),
    ];
    assert_eq!(first, expected);
    for _ in 0..40 {
        bench.say(OperatorCommand::Hold);
        bench.run(0.2);
        bench.say(OperatorCommand::Resume);
        bench.run(0.1);
    }
    let log = bench.supervisor.log();
    assert!(log.total() >= 83 && log.iter().count() == TRANSITIONS_KEPT);
    let times: Vec<_> = log.iter().map(|transition| transition.at).collect();
    assert!(times.is_sorted() && log.newest() == log.iter().last().copied());
    assert!(log.iter().zip(log.iter().skip(1)).all(|(one, next)| one.to == next.from));
}
