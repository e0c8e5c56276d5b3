//! The search for a lost target: permitted only in the state lost, for a limited time, and without any other condition.

use std::time::Duration;

use pb3dp_servo::Mode;
use pb3dp_servo::supervisor::{
    ArmCondition, Condition, Confidence, Innovation, Inputs, OperatorCommand, Permission, Resume, State,
    SupervisorConfig,
};

use super::bench::{Bench, config, with};

/// The target is lost, images still arrive, and the controller searches.
fn blind(inputs: &mut Inputs) {
    if let Some(estimate) = &mut inputs.estimate {
        estimate.confidence = Confidence::NoPose;
    }
    inputs.controller = Mode::Searching;
}

fn lost(search_max_s: f64) -> Bench {
    let mut bench = Bench::following(SupervisorConfig { search_max_s, ..config() });
    bench.lie(blind);
    bench.run(1.5);
    assert_eq!(bench.state(), State::Lost, "{}", bench.why());
    bench
}

#[test]
fn a_hand_that_searches_unasked_does_not_move() {
    let mut bench = lost(0.0);
    assert!(!bench.decision().search && !bench.run(3.0));
    // No search in any other state, whatever the policy.
    let mut bench = Bench::following(SupervisorConfig { search_max_s: 30.0, ..config() });
    bench.lie(|inputs| inputs.controller = Mode::Searching);
    bench.run(0.1);
    assert_eq!((bench.state(), bench.run(2.0)), (State::Holding, false));
}

#[test]
fn a_search_is_permitted_for_its_time_and_says_so() {
    let mut bench = lost(4.0);
    assert!(bench.decision().search);
    assert_eq!(bench.decision().permission, Permission::Move { share: 1.0 });
    assert!(bench.why().starts_with("lost: the hand searches for the target"), "{}", bench.why());
    bench.run(4.0);
    assert!(!bench.decision().search && !bench.run(2.0), "{}", bench.why());
}

#[test]
fn the_operator_and_everything_else_that_is_wrong_end_a_search() {
    let wrong: [fn(&mut Inputs); 4] = [
        |inputs| inputs.frame = None,
        |inputs| inputs.arms[0].measured_at = None,
        |inputs| inputs.range_end.iter_mut().for_each(|end| end.distance_rad = 0.01),
        |inputs| inputs.operator.heartbeat_at = None,
    ];
    for wrong in wrong {
        let mut bench = lost(30.0);
        bench.lie(move |inputs| {
            blind(inputs);
            wrong(inputs);
        });
        bench.run(0.5);
        assert!(!bench.run(1.0), "{}", bench.why());
    }
    // An aborted search does not start again for the same loss, even if the cause is gone.
    for wrong in wrong.into_iter().take(3) {
        let mut bench = lost(30.0);
        bench.lie(move |inputs| {
            blind(inputs);
            wrong(inputs);
        });
        bench.run(0.5);
        bench.lie(blind);
        assert_eq!((bench.run(3.0), bench.state()), (false, State::Lost), "{}", bench.why());
        bench.truth();
        bench.run(2.0);
        assert_eq!(bench.state(), State::Tracking, "{}", bench.why());
        bench.lie(blind);
        assert!(bench.run(2.0) && bench.decision().search, "the next loss permits a new search");
    }
    let mut bench = lost(30.0);
    bench.say(OperatorCommand::Hold);
    assert!(!bench.decision().search && !bench.run(1.0), "{}", bench.why());
}

/// A target that jumps and is then lost: a hold that needs `resume` still needs it, and no search starts.
#[test]
fn a_hold_that_waits_for_the_operator_does_not_search() {
    let wrong: [fn(&mut Inputs); 4] = [
        |inputs| inputs.innovation = Innovation::Jump { position_m: 0.3, orientation_rad: 0.0 },
        |inputs| inputs.estimate.iter_mut().for_each(|estimate| estimate.target = 8),
        |inputs| inputs.arms[1].state = ArmCondition::Disabled,
        |inputs| inputs.arms[0].measured_at = inputs.arms[0].measured_at.map(|at| at + Duration::from_secs(5)),
    ];
    for wrong in wrong {
        let mut bench = Bench::following(SupervisorConfig { search_max_s: 30.0, ..config() });
        bench.lie(wrong);
        bench.run(0.2);
        assert_eq!(bench.state(), State::Holding, "{}", bench.why());
        bench.lie(blind);
        assert!(!bench.run(3.0) && !bench.decision().search, "{}", bench.why());
        assert_eq!(bench.state(), State::Lost, "{}", bench.why());
    }
    // If only the loss needs `resume`, the hand searches, and holds where it finds the target.
    let mut config = with(Condition::TargetLost, |policy| policy.resume = Resume::ByOperator);
    config.search_max_s = 30.0;
    let mut bench = Bench::following(config);
    bench.lie(blind);
    assert!(bench.run(1.5) && bench.decision().search, "{}", bench.why());
    bench.truth();
    assert!(!bench.run(2.0) && bench.state() == State::Lost, "{}", bench.why());
}

/// A clock that is set back does not extend the search.
#[test]
fn a_clock_that_steps_ends_a_search_for_good() {
    for step_s in [-3.0, 3.0] {
        let mut bench = lost(4.0);
        bench.run(2.0);
        bench.now_s += step_s;
        bench.step();
        assert!(!bench.run(6.0) && !bench.decision().search, "{}", bench.why());
    }
}
