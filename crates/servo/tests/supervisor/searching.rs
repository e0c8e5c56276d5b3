//! The search for a lost target: permitted in one state only, for a time, and while nothing else is wrong.

use pb3dp_servo::Mode;
use pb3dp_servo::supervisor::{Confidence, Inputs, Permission, State, SupervisorConfig, Word};

use super::bench::{Bench, config};

/// The target is gone, pictures come on, and the hand would look for it.
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
    // Not in any other state either, whatever the policy.
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
    assert!(bench.why().starts_with("lost: the hand looks for the target"), "{}", bench.why());
    bench.run(4.0);
    assert!(!bench.decision().search && !bench.run(2.0), "{}", bench.why());
}

#[test]
fn the_operator_and_everything_else_that_is_wrong_end_a_search() {
    let wrong: [fn(&mut Inputs); 4] = [
        |inputs| inputs.frame = None,
        |inputs| inputs.arms[0].measured_at = None,
        |inputs| inputs.range_end.iter_mut().for_each(|end| end.distance_rad = 0.01),
        |inputs| inputs.operator.heard_at = None,
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
    let mut bench = lost(30.0);
    bench.say(Word::Hold);
    assert!(!bench.decision().search && !bench.run(1.0), "{}", bench.why());
}
