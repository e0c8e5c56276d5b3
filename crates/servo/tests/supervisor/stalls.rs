//! Stalls: a part stands still for a moment, the target is kept, and the arm goes on without a new initialisation.

use nalgebra::Matrix6;
use pb3dp_servo::supervisor::{
    Action, ArmCondition, Condition, Event, Inputs, OperatorCommand, Permission, Resume, State, SupervisorConfig,
};

use super::bench::{Bench, STEP_S, at, config, with};

/// Joints of the camera arm that are too old, and a target that is certain.
fn stalls(inputs: &mut Inputs) {
    inputs.arms[0].measured_at = inputs.operator.heartbeat_at.map(|now| now - std::time::Duration::from_millis(60));
    certain(inputs);
}

fn certain(inputs: &mut Inputs) {
    inputs.target_covariance = Some(Matrix6::from_diagonal_element(1e-6));
}

fn following(config: SupervisorConfig) -> Bench {
    let mut bench = Bench::following(config);
    bench.lie(certain);
    bench.run(1.0);
    bench
}

fn event(bench: &Bench) -> Option<Event> {
    bench.decision().transition.map(|transition| transition.event)
}

#[test]
fn a_part_that_stood_still_for_a_moment_costs_a_step_and_not_the_target() {
    let mut bench = following(config());
    bench.lie(stalls);
    let decision = bench.step();
    assert_eq!(
        (event(&bench), decision.permission, decision.rearm),
        (Some(Event::StallFound), Permission::Hold, false)
    );
    assert!(bench.why().contains("resumes by itself as soon as the cause is gone"), "{}", bench.why());
    bench.lie(certain);
    let decision = bench.step();
    assert_eq!((event(&bench), decision.state), (Some(Event::StallOver), State::Approaching));
    assert_eq!((decision.permission, decision.rearm), (Permission::Move { share: 1.0 }, false));
    bench.step();
    assert_eq!(bench.state(), State::Tracking, "the hand need not approach again");
}

#[test]
fn a_stall_of_more_than_300_ms_is_a_hold() {
    let mut bench = following(config());
    bench.lie(stalls);
    let mut dropped_s = None;
    for step in 0..50 {
        let rearms = bench.step().rearm;
        dropped_s = dropped_s.or(rearms.then_some(f64::from(step) * STEP_S));
    }
    assert!(dropped_s.is_some_and(|dropped_s| (0.29..0.32).contains(&dropped_s)), "{dropped_s:?}");
    bench.lie(certain);
    assert!(!bench.run(0.19), "it resumes after 0.2 s, as after every hold");
    assert!(bench.run(0.1));
}

#[test]
fn a_second_stall_within_a_second_is_a_hold() {
    let mut bench = following(config());
    for (pause_s, first) in [(0.5, Event::HoldFound), (1.5, Event::StallFound)] {
        bench.lie(stalls);
        bench.step();
        assert_eq!(event(&bench), Some(Event::StallFound));
        bench.lie(certain);
        bench.run(pause_s);
        bench.lie(stalls);
        bench.step();
        assert_eq!(event(&bench), Some(first), "{pause_s} s after the first one");
        bench.lie(certain);
        bench.run(2.0);
    }
}

#[test]
fn a_target_that_is_no_longer_certain_is_dropped() {
    let mut bench = following(config());
    for sigma_m in [0.0, 0.02] {
        bench.lie(move |inputs| {
            stalls(inputs);
            inputs.target_covariance = (sigma_m > 0.0).then(|| Matrix6::from_diagonal_element(sigma_m * sigma_m));
        });
        assert!(bench.step().rearm, "{sigma_m} m");
        assert_eq!(event(&bench), Some(Event::HoldFound));
        bench.lie(certain);
        bench.run(2.0);
    }
}

#[test]
fn a_policy_that_needs_the_operator_is_obeyed_after_a_stall() {
    let mut bench = following(with(Condition::JointsStale, |policy| policy.resume = Resume::ByOperator));
    bench.lie(stalls);
    assert!(bench.step().rearm);
    bench.lie(certain);
    assert!(!bench.run(2.0));
    let mut bench = following(with(Condition::JointsStale, |policy| policy.action = Action::Stop));
    bench.lie(stalls);
    assert_eq!(bench.step().state, State::Stopped);
}

#[test]
fn whatever_else_inhibits_motion_during_a_stall_ends_it() {
    let others: [fn(&mut Inputs); 3] = [
        |inputs| inputs.arms[1].state = ArmCondition::Disabled,
        |inputs| inputs.estimate.as_mut().unwrap().target += 1,
        |inputs| inputs.frame.as_mut().unwrap().sequence = 1,
    ];
    for other in others {
        let mut bench = following(config());
        bench.lie(stalls);
        bench.step();
        bench.lie(move |inputs| {
            stalls(inputs);
            other(inputs);
        });
        // A new image comes at most three steps later.
        let failed = (0..3).any(|_| bench.step().rearm && event(&bench) == Some(Event::StallFailed));
        assert!(failed, "{}", bench.why());
        bench.lie(certain);
        assert!(!bench.run(0.19), "{}", bench.why());
    }
}

#[test]
fn a_hold_of_the_operator_during_a_stall_drops_the_target() {
    for command in [OperatorCommand::Hold, OperatorCommand::HoldHand] {
        let mut bench = following(config());
        bench.lie(stalls);
        bench.step();
        let decision = bench.say(command);
        assert!(decision.rearm && event(&bench) == Some(Event::StallFailed), "{}", decision.why);
        bench.lie(certain);
        assert!(!bench.run(2.0));
        assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
    }
}

#[test]
fn a_clock_that_steps_during_a_stall_ends_it() {
    let mut bench = following(config());
    bench.lie(stalls);
    bench.step();
    bench.now_s += 0.25;
    bench.lie(certain);
    assert!(bench.step().rearm);
    assert!(!bench.run(2.0), "the operator is needed");
    assert!(at(bench.now_s) > at(100.0));
}
