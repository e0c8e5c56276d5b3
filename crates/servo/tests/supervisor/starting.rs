//! Wrong starts and resumes that the supervisor can detect, one test each. Each test shows that no motion is permitted, or that
//! no motion starts without a command.

use pb3dp_servo::supervisor::{
    ArmCondition, Condition, Confidence, Event, OperatorCommand, OperatorRequest, Permission, RefusedFor, State, Why,
};
use pb3dp_servo::{HoldReason, Mode};

use super::bench::{Bench, at, config, good, with};

/// A bench with a selected target and no active inhibit.
fn selected() -> Bench {
    let mut bench = Bench::new(config());
    bench.say(OperatorCommand::Select);
    bench.run(0.5);
    assert!(bench.decision().is_ready && bench.decision().why == Why::Ready, "{}", bench.why());
    bench
}

/// Commands `start`: it must be refused because of this condition, and no motion follows.
fn start_is_refused_for(bench: &mut Bench, condition: Condition) {
    let decision = bench.say(OperatorCommand::Start);
    let because = decision.refused.unwrap().because;
    assert!(matches!(because, RefusedFor::Cause(cause) if cause.condition == condition), "{because:?}");
    stays_at_rest(bench);
}

fn stays_at_rest(bench: &mut Bench) {
    assert!(!bench.run(2.0), "motion is permitted: {}", bench.why());
}

/// A bench in the state fault, after the cause is gone.
fn faulted() -> Bench {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[0].state = ArmCondition::Fault);
    bench.run(0.1);
    bench.truth();
    bench.run(0.1);
    assert_eq!(bench.state(), State::Fault);
    bench
}

#[test]
fn nothing_moves_before_the_operators_command() {
    let mut bench = Bench::new(config());
    stays_at_rest(&mut bench);
    assert_eq!(bench.state(), State::Idle);
}

#[test]
fn start_without_a_selected_target() {
    let mut bench = Bench::new(config());
    bench.run(0.5);
    let decision = bench.say(OperatorCommand::Start);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::State(State::Idle));
    stays_at_rest(&mut bench);
}

#[test]
fn select_alone_moves_nothing() {
    stays_at_rest(&mut selected());
}

#[test]
fn start_before_the_target_was_observed() {
    let mut bench = selected();
    bench.lie(|i| i.estimate = None);
    bench.say(OperatorCommand::Select);
    bench.run(0.5);
    start_is_refused_for(&mut bench, Condition::TargetLost);
    // No motion starts when the target comes into view.
    bench.truth();
    stays_at_rest(&mut bench);
}

#[test]
fn start_on_a_target_that_was_observed_before_it_was_selected() {
    let mut bench = Bench::new(config());
    bench.run(0.5);
    let old = good(bench.now_s).estimate;
    bench.lie(move |i| i.estimate = old);
    bench.say(OperatorCommand::Select);
    start_is_refused_for(&mut bench, Condition::TargetLost);
}

#[test]
fn start_on_a_target_that_was_observed_too_long_ago() {
    let mut bench = selected();
    let old = good(bench.now_s).estimate;
    bench.lie(move |i| i.estimate = old);
    bench.run(0.4);
    start_is_refused_for(&mut bench, Condition::EstimateStale);
}

#[test]
fn start_on_one_image_shown_again_and_again() {
    let mut bench = selected();
    let old = good(bench.now_s);
    bench.lie(move |i| (i.frame, i.estimate) = (old.frame, old.estimate));
    bench.run(0.5);
    start_is_refused_for(&mut bench, Condition::FrameStale);
}

#[test]
fn start_on_an_old_image_with_a_new_number() {
    let mut bench = selected();
    let old = good(bench.now_s).frame.unwrap();
    bench.lie(move |i| i.frame.as_mut().unwrap().at = old.at);
    bench.run(0.1);
    start_is_refused_for(&mut bench, Condition::FrameOrder);
}

#[test]
fn start_on_an_estimate_from_the_future() {
    let mut bench = selected();
    bench.lie(|i| i.estimate.as_mut().unwrap().at = at(1e4));
    bench.run(0.1);
    start_is_refused_for(&mut bench, Condition::ClockStepped);
}

#[test]
fn start_on_a_pose_that_the_estimator_does_not_stand_by() {
    let mut bench = Bench::new(config());
    bench.lie(|i| i.estimate.as_mut().unwrap().confidence = Confidence::Doubtful);
    bench.say(OperatorCommand::Select);
    bench.run(0.5);
    start_is_refused_for(&mut bench, Condition::TargetLost);
}

#[test]
fn start_on_a_pose_with_a_large_covariance() {
    let mut bench = selected();
    bench.lie(|i| i.estimate.as_mut().unwrap().covariance.as_mut().unwrap()[(2, 2)] = 4e-4);
    bench.run(0.2);
    start_is_refused_for(&mut bench, Condition::PositionUncertain);
}

#[test]
fn start_while_a_doubt_has_not_yet_lasted() {
    let mut bench = selected();
    bench.lie(|i| i.frame.as_mut().unwrap().skew_s = 0.02);
    bench.run(0.04);
    start_is_refused_for(&mut bench, Condition::CameraSkew);
}

#[test]
fn start_before_the_filter_of_the_controller_is_seeded() {
    for mode in [Mode::Idle, Mode::Locking, Mode::Lost, Mode::Holding(HoldReason::JointsNotFinite)] {
        let mut bench = selected();
        bench.lie(move |i| i.controller = mode);
        start_is_refused_for(&mut bench, Condition::ControllerRests);
    }
}

#[test]
fn start_with_an_arm_that_is_off() {
    for arm in 0..2 {
        let mut bench = selected();
        bench.lie(move |i| i.arms[arm].state = ArmCondition::Disabled);
        start_is_refused_for(&mut bench, Condition::ArmDisabled);
        // No motion starts when the arm is enabled.
        bench.truth();
        stays_at_rest(&mut bench);
    }
}

#[test]
fn start_with_joints_that_nobody_has_measured() {
    for arm in 0..2 {
        let mut bench = selected();
        bench.lie(move |i| i.arms[arm].measured_at = None);
        start_is_refused_for(&mut bench, Condition::JointsStale);
    }
}

#[test]
fn start_without_a_sign_of_the_operators_life() {
    let mut bench = selected();
    bench.lie(|i| i.operator.heartbeat_at = None);
    start_is_refused_for(&mut bench, Condition::OperatorSilent);
}

#[test]
fn start_from_a_zeroed_state() {
    let mut bench = Bench::new(config());
    bench.lie(|i| {
        let request = i.operator.request;
        *i = good(0.0);
        i.operator.request = request;
    });
    bench.say(OperatorCommand::Select);
    assert!(bench.say(OperatorCommand::Start).refused.is_some());
    stays_at_rest(&mut bench);
}

#[test]
fn start_that_was_given_too_long_ago() {
    let mut bench = selected();
    bench.run(2.0);
    let decision = bench.say_at(OperatorCommand::Start, bench.now_s - 0.6);
    let because = decision.refused.unwrap().because;
    assert!(matches!(because, RefusedFor::Age { age_s, age_max_s } if age_s > 0.6 && age_max_s == 0.5), "{because:?}");
    stays_at_rest(&mut bench);
}

#[test]
fn start_with_a_time_in_the_future() {
    let mut bench = selected();
    let decision = bench.say_at(OperatorCommand::Start, bench.now_s + 3.0);
    assert!(matches!(decision.refused.unwrap().because, RefusedFor::Age { age_s, .. } if age_s < -2.0));
    stays_at_rest(&mut bench);
}

#[test]
fn start_that_was_given_for_another_selection() {
    let mut bench = selected();
    let requested_s = bench.now_s;
    bench.say(OperatorCommand::Select);
    bench.run(0.3);
    let decision = bench.say_at(OperatorCommand::Start, requested_s);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanState(State::Selecting));
    stays_at_rest(&mut bench);
}

#[test]
fn a_second_start_has_no_further_effect() {
    let mut bench = Bench::following(config());
    let decision = bench.say(OperatorCommand::Start);
    assert_eq!((decision.state, decision.refused, decision.transition), (State::Tracking, None, None));
}

#[test]
fn another_target_selected_in_motion() {
    let mut bench = Bench::following(config());
    let decision = bench.say(OperatorCommand::Select);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::State(State::Tracking));
    assert_eq!(decision.permission, Permission::Move { share: 1.0 }, "the hand follows the started target");
}

#[test]
fn start_or_resume_in_a_fault() {
    for command in [OperatorCommand::Start, OperatorCommand::Resume, OperatorCommand::Select, OperatorCommand::Hold] {
        let mut bench = faulted();
        bench.say(command);
        stays_at_rest(&mut bench);
        assert_eq!(bench.state(), State::Fault);
    }
}

#[test]
fn a_fault_that_is_gone_does_not_clear_itself() {
    let mut bench = faulted();
    stays_at_rest(&mut bench);
    assert_eq!((bench.state(), bench.decision().permission), (State::Fault, Permission::Stop));
}

#[test]
fn reset_while_the_emergency_stop_is_pressed() {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[1].state = ArmCondition::EmergencyStop);
    bench.run(0.1);
    let decision = bench.say(OperatorCommand::Reset);
    assert!(
        matches!(decision.refused.unwrap().because, RefusedFor::Cause(cause) if cause.condition == Condition::EmergencyStop)
    );
    assert_eq!(bench.state(), State::Fault);
}

#[test]
fn reset_that_was_given_before_the_fault() {
    let mut bench = Bench::following(config());
    let requested_s = bench.now_s;
    bench.lie(|i| i.arms[0].state = ArmCondition::Fault);
    bench.run(0.1);
    bench.truth();
    bench.run(0.1);
    let decision = bench.say_at(OperatorCommand::Reset, requested_s);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanState(State::Fault));
    assert_eq!(bench.state(), State::Fault);
}

#[test]
fn reset_in_the_step_in_which_a_fault_is_found() {
    let mut bench = Bench::following(config());
    bench.say(OperatorCommand::Stop);
    bench.run(0.1);
    bench.lie(|i| i.arms[0].state = ArmCondition::Fault);
    let decision = bench.say(OperatorCommand::Reset);
    assert_eq!(decision.state, State::Fault);
    assert!(decision.refused.is_some());
}

#[test]
fn resume_after_an_emergency_stop_with_the_old_set_points() {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[0].state = ArmCondition::EmergencyStop);
    assert!(bench.step().rearm, "the stop drops the set-points");
    bench.truth();
    bench.run(0.2);
    let decision = bench.say(OperatorCommand::Reset);
    assert_eq!((decision.state, decision.rearm), (State::Idle, true));
    for command in [OperatorCommand::Resume, OperatorCommand::Start] {
        assert_eq!(bench.say(command).refused.unwrap().because, RefusedFor::State(State::Idle));
        stays_at_rest(&mut bench);
    }
    // The whole sequence is required: the target is selected, observed again, and started.
    assert!(bench.say(OperatorCommand::Select).rearm);
    assert!(bench.say(OperatorCommand::Start).refused.is_some(), "not with earlier observations");
    bench.run(0.5);
    assert_eq!(bench.say(OperatorCommand::Start).state, State::Approaching);
}

#[test]
fn start_that_was_given_before_a_fault_does_nothing_after_the_reset() {
    let mut bench = faulted();
    let requested_s = bench.now_s;
    bench.say(OperatorCommand::Reset);
    bench.say(OperatorCommand::Select);
    bench.run(0.3);
    let decision = bench.say_at(OperatorCommand::Start, requested_s);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanState(State::Selecting));
    stays_at_rest(&mut bench);
}

#[test]
fn reset_of_what_is_not_latched_changes_nothing() {
    let mut bench = Bench::following(config());
    bench.say(OperatorCommand::Hold);
    bench.run(0.5);
    let decision = bench.say(OperatorCommand::Reset);
    assert_eq!((decision.state, decision.transition), (State::Holding, None));
    stays_at_rest(&mut bench);
}

/// The latched state of an arm is cleared only by a command that the supervisor would accept.
#[test]
fn a_reset_reaches_the_arms_only_in_a_latched_state_and_in_time() {
    let request = |command, requested_s| OperatorRequest { command, at: at(requested_s) };
    let mut bench = Bench::following(config());
    assert!(!bench.supervisor.would_reset(request(OperatorCommand::Reset, bench.now_s), at(bench.now_s)), "tracking");
    let before_s = bench.now_s;
    bench.lie(|i| i.arms[0].state = ArmCondition::EmergencyStop);
    bench.run(0.1);
    assert_eq!(bench.state(), State::Fault);
    let now_s = bench.now_s;
    let would = |command, requested_s| bench.supervisor.would_reset(request(command, requested_s), at(now_s));
    assert!(would(OperatorCommand::Reset, now_s), "also while the emergency stop is latched in the arm");
    assert!(!would(OperatorCommand::Reset, before_s), "the command is from before the fault");
    assert!(!would(OperatorCommand::Reset, now_s + 1.0), "the command has a future time");
    assert!(!would(OperatorCommand::Select, now_s));
    let later =
        |requested_s| bench.supervisor.would_reset(request(OperatorCommand::Reset, requested_s), at(now_s + 1.0));
    assert!(!later(now_s) && later(now_s + 0.6), "at most 0.5 s old");
    bench.truth();
    bench.run(0.1);
    assert_eq!(bench.say(OperatorCommand::Reset).state, State::Idle);
    assert!(
        !bench.supervisor.would_reset(request(OperatorCommand::Reset, bench.now_s), at(bench.now_s)),
        "nothing is latched"
    );
}

#[test]
fn the_operators_stop_ends_every_state_and_stays() {
    for hold in [false, true] {
        let mut bench = Bench::following(config());
        if hold {
            bench.say(OperatorCommand::Hold);
        }
        let decision = bench.say(OperatorCommand::Stop);
        assert_eq!((decision.state, decision.permission), (State::Stopped, Permission::Stop));
        stays_at_rest(&mut bench);
        assert_eq!(bench.say(OperatorCommand::Start).refused.unwrap().because, RefusedFor::State(State::Stopped));
    }
    let mut bench = selected();
    assert_eq!(bench.say(OperatorCommand::Stop).state, State::Stopped);
    // Regardless of the age of the command.
    let mut bench = Bench::following(config());
    assert_eq!(bench.say_at(OperatorCommand::Stop, bench.now_s - 30.0).state, State::Stopped);
    let mut bench = Bench::following(config());
    assert_eq!(bench.say_at(OperatorCommand::Hold, bench.now_s - 30.0).state, State::Holding);
}

#[test]
fn lease_lost_and_regained() {
    let mut bench = Bench::following(config());
    let heartbeat_at = Some(at(bench.now_s));
    bench.lie(move |i| i.operator.heartbeat_at = heartbeat_at);
    bench.run(1.2);
    assert_eq!(bench.state(), State::Stopped);
    bench.truth();
    stays_at_rest(&mut bench);
    // A policy with the action hold also waits for the operator.
    let mut bench = Bench::following(with(Condition::OperatorSilent, |policy| {
        policy.action = pb3dp_servo::supervisor::Action::Hold;
    }));
    let heartbeat_at = Some(at(bench.now_s));
    bench.lie(move |i| i.operator.heartbeat_at = heartbeat_at);
    bench.run(1.2);
    assert_eq!(bench.state(), State::Holding);
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

#[test]
fn clock_stepped_forward() {
    let mut bench = Bench::following(config());
    bench.now_s += 0.5;
    let decision = bench.step();
    let cause = decision.transition.unwrap().cause.unwrap();
    assert_eq!((decision.state, cause.condition), (State::Holding, Condition::ClockStepped));
    assert!((cause.value - 0.51).abs() < 1e-6, "{cause:?}");
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

#[test]
fn clock_stepped_back() {
    let mut bench = Bench::following(config());
    let fresh = bench.now_s;
    bench.now_s -= 40.0;
    let decision = bench.step();
    let cause = decision.transition.unwrap().cause.unwrap();
    assert_eq!((decision.state, cause.condition), (State::Lost, Condition::ClockStepped));
    assert!((cause.value + 39.99).abs() < 1e-6, "{cause:?}");
    // Measurements from before the step have future times and do not count.
    bench.lie(move |i| i.estimate = good(fresh).estimate);
    bench.run(0.5);
    assert!(bench.say(OperatorCommand::Resume).refused.is_some());
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

/// After the clock is set back, commands are still accepted, above all `reset`.
#[test]
fn commands_after_the_clock_stepped_back() {
    let mut bench = faulted();
    bench.now_s -= 40.0;
    bench.run(0.5);
    assert_eq!(bench.say(OperatorCommand::Reset).state, State::Idle);
    bench.begin();
    bench.say(OperatorCommand::Stop);
    bench.say(OperatorCommand::Reset);
    bench.say(OperatorCommand::Select);
    bench.now_s -= 20.0;
    bench.run(0.5);
    assert_eq!(bench.say(OperatorCommand::Start).state, State::Approaching, "{}", bench.why());
}

#[test]
fn estimator_restarted_with_another_target() {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.estimate.as_mut().unwrap().target = 1);
    bench.run(0.1);
    assert_eq!(bench.state(), State::Holding);
    let because = bench.say(OperatorCommand::Resume).refused.unwrap().because;
    assert!(matches!(because, RefusedFor::Cause(cause) if cause.condition == Condition::TargetChanged));
    stays_at_rest(&mut bench);
    // The operator must select the new target.
    bench.say(OperatorCommand::Select);
    bench.run(0.3);
    assert_eq!(bench.say(OperatorCommand::Start).state, State::Approaching);
}

#[test]
fn another_target_found_after_a_loss() {
    let mut bench = lost();
    bench.lie(|i| i.estimate.as_mut().unwrap().target = 8);
    stays_at_rest(&mut bench);
    assert_eq!(bench.state(), State::Lost);
}

fn lost() -> Bench {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.estimate.as_mut().unwrap().confidence = Confidence::NoPose);
    bench.run(1.3);
    assert_eq!(bench.state(), State::Lost);
    bench
}

#[test]
fn the_same_target_found_after_a_loss_is_followed_again_if_the_policy_says_so() {
    let mut bench = lost();
    bench.truth();
    assert!(!bench.run(0.2), "not at once");
    assert!(bench.run(0.5));
    let found = bench.supervisor.log().iter().find(|transition| transition.event == Event::TargetFound).unwrap();
    assert_eq!((found.from, found.to), (State::Lost, State::Approaching));
}

#[test]
fn after_a_loss_it_waits_for_the_operator_if_the_policy_says_so() {
    let wait = with(Condition::TargetLost, |policy| policy.resume = pb3dp_servo::supervisor::Resume::ByOperator);
    let mut bench = Bench::following(wait);
    bench.lie(|i| i.estimate = None);
    bench.run(1.3);
    assert_eq!(bench.state(), State::Lost);
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

#[test]
fn resume_while_the_target_is_lost() {
    let mut bench = lost();
    let because = bench.say(OperatorCommand::Resume).refused.unwrap().because;
    assert!(matches!(because, RefusedFor::Cause(cause) if cause.condition == Condition::TargetLost));
    stays_at_rest(&mut bench);
}

#[test]
fn a_hold_of_the_operator_is_ended_by_nobody_else() {
    let mut bench = Bench::following(config());
    bench.say(OperatorCommand::Hold);
    stays_at_rest(&mut bench);
    // A loss of the target that ends does not end the hold either.
    bench.lie(|i| i.estimate = None);
    bench.run(1.5);
    assert_eq!(bench.state(), State::Lost);
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

#[test]
fn a_hold_command_during_a_hold_keeps_it() {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[0].measured_at = None);
    bench.run(0.1);
    bench.say(OperatorCommand::Hold);
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

#[test]
fn a_second_cause_during_a_rest_counts_as_well() {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[0].measured_at = None);
    bench.run(0.1);
    assert_eq!(bench.state(), State::Holding);
    bench.lie(|i| i.arms[1].state = ArmCondition::Disabled);
    bench.run(0.1);
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
}

#[test]
fn a_cause_that_flickers_keeps_the_arm_at_rest() {
    let mut bench = Bench::following(config());
    for _ in 0..30 {
        bench.lie(|i| i.arms[1].measured_at = None);
        bench.step();
        bench.truth();
        assert!(!bench.run(0.19));
    }
    assert!(bench.run(0.1), "0.2 s without the cause are enough");
}

#[test]
fn a_rest_does_not_end_before_the_controller_has_locked_on_anew() {
    let mut bench = Bench::following(config());
    bench.lie(|i| {
        i.arms[0].measured_at = None;
        i.controller = Mode::Locking;
    });
    assert!(bench.step().rearm);
    bench.lie(|i| i.controller = Mode::Locking);
    stays_at_rest(&mut bench);
    let because = bench.say(OperatorCommand::Resume).refused.unwrap().because;
    assert!(matches!(because, RefusedFor::Cause(cause) if cause.condition == Condition::ControllerRests));
}

#[test]
fn an_arm_that_was_moved_meanwhile_goes_on_from_where_it_is() {
    // For example homed: its drives were disabled meanwhile, and the old set-points are dropped.
    let mut bench = Bench::following(config());
    bench.lie(|i| i.arms[0].state = ArmCondition::Disabled);
    assert!(bench.step().rearm);
    bench.run(3.0);
    bench.truth();
    stays_at_rest(&mut bench);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching, "at the speed of the approach");
}

#[test]
fn a_restarted_camera_holds_the_arm() {
    let mut bench = Bench::following(config());
    bench.lie(|i| i.frame.as_mut().unwrap().sequence -= 100_000);
    let mut held = false;
    for _ in 0..5 {
        held |= bench.step().state == State::Holding;
    }
    assert!(held);
}
