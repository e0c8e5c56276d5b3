//! Images that are older than their time stamps: the hand follows itself. It is slowed and held before it swings. The whole program in
//! virtual time, with arms that are emulated byte by byte.

use pb3dp_servo::supervisor::{Condition, Resume, State, Why};
use pb3dp_setup::setup::{Setup, read_setup};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig};
use system_tests::disturbed::{Decided, Disturbance, Ran, run, setup};
use system_tests::repository;

/// The target begins to move, seconds.
const MOVES_S: f64 = 3.0;

/// The experiment of Fig. 7, with 100 mm within 2 s; after an oscillation the operator is needed.
fn fig7() -> Setup {
    let mut setup = setup(read_setup(&repository().join("configs/hil.toml")).unwrap().experiment.motion).unwrap();
    setup.supervisor.policies.get_mut(Condition::Oscillation).resume = Resume::ByOperator;
    setup
}

fn condition(step: &Decided) -> Option<Condition> {
    match step.why {
        Why::Slowed { cause, .. } | Why::Resting { cause, .. } | Why::CauseGone { cause, .. } => Some(cause.condition),
        _ => None,
    }
}

fn first(ran: &Ran, wanted: impl Fn(&Decided) -> bool) -> Option<&Decided> {
    ran.decided.iter().find(|step| condition(step) == Some(Condition::Oscillation) && wanted(step))
}

/// When the hand is slowed and held for an oscillation, seconds after the target begins to move, and its largest error until 0.3 s after that.
fn noticed(ran: &Ran) -> (Option<f64>, Option<f64>, f64) {
    let since_s = |step: &Decided| step.t_s - MOVES_S;
    let slowed_s = first(ran, |step| step.state.is_moving()).map(since_s);
    let held_s = first(ran, |step| step.state == State::Holding).map(since_s);
    // The hand needs some time to stop.
    let until_s = held_s.map_or(20.0, |held_s| MOVES_S + held_s + 0.3);
    (slowed_s, held_s, ran.error_mm(0.0, until_s))
}

#[test]
fn images_that_are_late_under_fresh_stamps_hold_the_hand() {
    for late_s in [0.2, 0.12, 0.08] {
        let ran = run(&fig7(), Disturbance::BufferedPairs(late_s), 20.0).unwrap();
        let (slowed_s, held_s, error_mm) = noticed(&ran);
        println!(
            "{late_s} s: slowed after {slowed_s:.2?} s, held after {held_s:.2?} s, largest error until it rests {error_mm:.1} mm"
        );
        let last = ran.decided.last().unwrap();
        assert!(held_s.is_some_and(|held_s| held_s < 2.0), "{late_s} s: {held_s:?}");
        // With the shorter delays the target has moved on when the hand rests.
        assert!(late_s < 0.2 || error_mm < 30.0, "{late_s} s: {error_mm} mm");
        assert!(last.why.waits_for_resume(), "{}", last.why);
    }
}

/// What a hand follows is no oscillation: the experiment, and sinusoids with accelerations up to 0.44 m/s^2. With 1 m/s^2 (100 mm, 2 s) the
/// hand is held: there the target cannot be told from one that moves with the hand.
#[test]
fn targets_that_the_hand_follows_hold_nothing() {
    let sine = |channel, period_s, amplitude| {
        setup(MotionConfig::Sine(SineConfig {
            channel,
            amplitude,
            period_s,
            periods: 4,
            lead_in_s: 1.0,
            axes: ExperimentAxes::TargetAtStart,
        }))
    };
    let setups = [
        fig7(),
        sine(Channel::X, 6.0, 0.1).unwrap(),
        sine(Channel::Y, 3.0, 0.1).unwrap(),
        sine(Channel::Z, 2.0, 0.04).unwrap(),
        sine(Channel::Ry, 4.0, 0.35).unwrap(),
        sine(Channel::Rx, 3.0, 0.35).unwrap(),
    ];
    for setup in setups {
        let ran = run(&setup, Disturbance::None, 16.0).unwrap();
        let slowed = ran.decided.iter().filter(|step| condition(step) == Some(Condition::Oscillation)).count();
        println!("{:?}: slowed in {slowed} steps of {}", setup.experiment.motion, ran.decided.len());
        assert!(first(&ran, |step| !step.state.is_moving()).is_none(), "{:?}", setup.experiment.motion);
        assert!(slowed * 20 < ran.decided.len(), "slowed in {slowed} steps: {:?}", setup.experiment.motion);
    }
}
