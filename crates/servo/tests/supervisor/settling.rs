//! Intermittent conditions of single images: a command between two of these images is refused.

use pb3dp_servo::supervisor::{
    Condition, Confidence, Innovation, Inputs, OperatorCommand, RefusedFor, State, SupervisorConfig,
};

use super::bench::{Bench, FRAME_EVERY, STEP_S, at, config};

/// One image in three is an outlier.
fn outliers(inputs: &mut Inputs) {
    let is_one = inputs.frame.is_some_and(|frame| (frame.sequence / 30).is_multiple_of(3));
    if inputs.innovation == Innovation::Agrees && is_one {
        inputs.innovation = Innovation::Outlier { sigmas: 60.0 };
    }
}

/// Gives the command in every step for 1 s: no motion may start. Counts the refusals for too short a time without an inhibit.
fn is_refused(bench: &mut Bench, command: OperatorCommand) -> usize {
    let mut too_short = 0;
    for _ in 0..100 {
        let decision = bench.say(command);
        assert!(!decision.state.is_moving(), "{}", decision.why);
        match decision.refused.map(|refusal| refusal.because) {
            Some(RefusedFor::NotClear { cause, clear_s, wanted_s }) => {
                too_short += 1;
                assert!(clear_s < wanted_s && wanted_s == 0.1, "{clear_s} {wanted_s}");
                let why = bench.why();
                assert!(why.contains("; ready to ") && why.ends_with(" in 0.1 s"), "{why}");
                assert!(
                    why.contains("standard deviations") == cause.is_some_and(|c| c.condition == Condition::Outlier)
                );
            }
            Some(RefusedFor::Cause(_)) => {}
            other => panic!("{other:?}"),
        }
        assert!(!bench.decision().is_ready, "{}", bench.why());
    }
    too_short
}

#[test]
fn resume_between_two_outliers() {
    let mut bench = Bench::following(config());
    bench.say(OperatorCommand::Hold);
    bench.lie(outliers);
    bench.run(0.3);
    assert!(is_refused(&mut bench, OperatorCommand::Resume) > 30);
    bench.truth();
    bench.run(0.15);
    assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching, "{}", bench.why());
}

#[test]
fn start_between_two_outliers() {
    let mut bench = Bench::new(config());
    bench.say(OperatorCommand::Select);
    bench.lie(outliers);
    bench.run(0.3);
    assert!(is_refused(&mut bench, OperatorCommand::Start) > 30);
    bench.truth();
    bench.run(0.15);
    assert_eq!(bench.say(OperatorCommand::Start).state, State::Approaching, "{}", bench.why());
}

#[test]
fn resume_after_a_hold_is_obeyed_as_soon_as_the_controller_has_been_at_it_for_that_time() {
    for go_after_s in [0.05, 0.1, 0.2] {
        let mut bench = Bench::following(SupervisorConfig { go_after_s, ..config() });
        bench.say(OperatorCommand::Hold);
        let held_s = bench.now_s;
        while !bench.decision().is_ready {
            bench.step();
        }
        // The controller initialises the target in 50 ms; the confirming image arrives with the frame period.
        let (waited_s, image_s) = (bench.now_s - held_s - go_after_s, FRAME_EVERY as f64 * STEP_S);
        assert!((0.05..=0.05 + image_s + 2.0 * STEP_S + 1e-9).contains(&waited_s), "{waited_s}");
        assert_eq!(bench.say(OperatorCommand::Resume).state, State::Approaching);
    }
}

#[test]
fn start_that_was_given_before_another_target_was_followed() {
    let mut bench = Bench::new(config());
    bench.say(OperatorCommand::Select);
    bench.run(0.5);
    let requested_s = bench.now_s;
    bench.lie(|inputs| inputs.estimate.as_mut().unwrap().target = 8);
    bench.run(0.2);
    assert!(bench.decision().is_ready, "{}", bench.why());
    let decision = bench.say_at(OperatorCommand::Start, requested_s);
    assert_eq!(decision.refused.unwrap().because, RefusedFor::OlderThanTarget);
    assert!(!bench.run(2.0));
    assert_eq!(bench.say(OperatorCommand::Start).state, State::Approaching);
}

/// One of several scattered poses agrees by chance, and no pose follows: the time without a pose does not count.
#[test]
fn one_image_that_agrees_and_none_behind_it() {
    let mut bench = Bench::following(config());
    bench.lie(|inputs| {
        if inputs.innovation == Innovation::Agrees {
            inputs.innovation = Innovation::Outlier { sigmas: 60.0 };
        }
    });
    bench.run(0.5);
    assert_eq!(bench.state(), State::Holding);
    let last = bench.now_s;
    bench.lie(move |inputs| {
        // Only the next image still has a pose.
        if inputs.estimate.is_some_and(|estimate| estimate.at > at(last + 0.03)) {
            let estimate = inputs.estimate.as_mut().unwrap();
            estimate.confidence = Confidence::NoPose;
            inputs.innovation = Innovation::NoneNew;
        }
    });
    assert!(!bench.run(1.0), "{}", bench.why());
    bench.truth();
    assert!(!bench.run(0.2), "{}", bench.why());
    assert!(bench.run(0.1), "{}", bench.why());
}
