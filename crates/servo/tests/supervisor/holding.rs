//! Which arms hold, and until when: the command `hold` holds both arms, `hold hand` the camera arm alone.

use super::bench::{Bench, at, config, with};
use pb3dp_servo::supervisor::{Action, Condition, OperatorCommand, Permission, RefusedFor, State};

/// The hand holds; returns whether the arm with the target holds too, in all steps of a second.
fn both_hold(bench: &mut Bench) -> bool {
    let held = (0..100).map(|_| bench.step()).map(|decision| {
        assert_eq!(decision.permission, Permission::Hold, "{}", decision.why);
        decision.no_arm_may_move
    });
    let held: Vec<bool> = held.collect();
    assert!(held.iter().all(|holds| *holds == held[0]));
    held[0]
}

#[test]
fn hold_holds_both_arms_until_resume() {
    let mut bench = Bench::following(config());
    let decision = bench.say(OperatorCommand::Hold);
    assert!(decision.no_arm_may_move && decision.state == State::Holding, "{}", decision.why);
    assert!(both_hold(&mut bench));
    assert_eq!(bench.why(), "holding: both arms held by the operator; use resume");
    let decision = bench.say(OperatorCommand::Resume);
    assert!(!decision.no_arm_may_move && decision.state == State::Approaching, "{}", decision.why);
}

#[test]
fn hold_hand_holds_the_camera_arm_alone() {
    let mut bench = Bench::following(config());
    assert_eq!(bench.say(OperatorCommand::HoldHand).state, State::Holding);
    assert!(!both_hold(&mut bench));
    assert_eq!(bench.why(), "holding: camera arm held by the operator; use resume");
    // `hold` after it holds both arms, and `hold hand` after that releases neither.
    assert!(bench.say(OperatorCommand::Hold).no_arm_may_move);
    assert!(bench.say(OperatorCommand::HoldHand).no_arm_may_move);
    assert!(both_hold(&mut bench));
    assert!(!bench.say(OperatorCommand::Resume).no_arm_may_move);
}

#[test]
fn a_selection_after_a_hold_does_not_release_the_arm_with_the_target() {
    let mut bench = Bench::following(config());
    bench.say(OperatorCommand::Hold);
    assert_eq!(bench.say(OperatorCommand::Select).state, State::Selecting);
    assert!(both_hold(&mut bench));
    assert!(!bench.say(OperatorCommand::Start).no_arm_may_move);
}

/// What concerns the arms, the clock or the operator; what concerns the images holds the camera arm alone.
#[test]
fn conditions_that_hold_both_arms_are_those_of_arms_clock_and_operator() {
    let held = Condition::ALL.into_iter().filter(|condition| condition.rule().holds_every_arm);
    let held: Vec<&str> = held.map(Condition::key).collect();
    assert_eq!(held, ["arm_disabled", "clock_stepped", "operator_silent", "joints_stale"]);
}

/// In every state, and without the operator: the condition itself inhibits the arms while it lasts.
#[test]
fn without_fresh_joints_of_either_arm_both_hold_until_they_are_fresh() {
    let begin: [fn() -> Bench; 3] = [
        || Bench::new(config()),
        || {
            let mut bench = Bench::new(config());
            bench.say(OperatorCommand::Select);
            bench
        },
        || Bench::following(config()),
    ];
    for (begin, arm) in begin.into_iter().flat_map(|begin| [(begin, 0), (begin, 1)]) {
        let mut bench = begin();
        bench.run(0.1);
        let (state, stale_s) = (bench.state(), bench.now_s);
        assert!(!bench.decision().no_arm_may_move, "{state:?}");
        bench.lie(move |inputs| inputs.arms[arm].measured_at = Some(at(stale_s)));
        bench.run(0.3);
        assert!(bench.decision().no_arm_may_move, "{state:?}, arm {arm}");
        bench.truth();
        assert!(!bench.step().no_arm_may_move, "{state:?}, arm {arm}");
    }
}

#[test]
fn after_a_silence_or_a_clock_step_the_arm_with_the_target_waits_for_the_operator_too() {
    let mut bench = Bench::following(with(Condition::OperatorSilent, |policy| policy.action = Action::Hold));
    let heartbeat_s = bench.now_s;
    bench.lie(move |inputs| inputs.operator.heartbeat_at = Some(at(heartbeat_s)));
    bench.run(1.1);
    assert!(bench.decision().no_arm_may_move && bench.state() == State::Holding, "{}", bench.why());
    bench.truth();
    assert!(both_hold(&mut bench), "a sign of life alone moves no arm");
    assert!(!bench.say(OperatorCommand::Resume).no_arm_may_move);
    let mut bench = Bench::following(config());
    bench.now_s += 0.5;
    bench.step();
    assert!(both_hold(&mut bench), "the clock stepped");
    assert!(!bench.say(OperatorCommand::Resume).no_arm_may_move);
}

/// A slow line delivers a command after a later one that ends motion, in a state that this one leaves as it is.
#[test]
fn commands_given_before_a_later_hold_or_stop_move_nothing() {
    for hold in [OperatorCommand::Hold, OperatorCommand::HoldHand] {
        let mut bench = Bench::following(config());
        bench.say(OperatorCommand::Hold);
        bench.run(0.5);
        let requested_s = bench.now_s;
        bench.run(0.05);
        bench.say(hold);
        let decision = bench.say_at(OperatorCommand::Resume, requested_s);
        assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanState(State::Holding), "{hold:?}");
        assert!(!bench.run(2.0), "{}", bench.why());
        assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);

        let mut bench = Bench::new(config());
        bench.say(OperatorCommand::Select);
        bench.run(0.5);
        let requested_s = bench.now_s;
        bench.run(0.05);
        bench.say(hold);
        let decision = bench.say_at(OperatorCommand::Start, requested_s);
        assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanState(State::Selecting), "{hold:?}");
        assert!(!bench.run(2.0), "{}", bench.why());
    }
    let mut bench = Bench::following(config());
    bench.say(OperatorCommand::Stop);
    bench.run(0.1);
    let requested_s = bench.now_s;
    bench.run(0.05);
    bench.say(OperatorCommand::Stop);
    let decision = bench.say_at(OperatorCommand::Reset, requested_s);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanState(State::Stopped));
    assert_eq!(bench.state(), State::Stopped);
}
