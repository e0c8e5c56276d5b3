//! Images that are older than their time stamps: the hand follows itself. It is slowed, and held before it swings. The whole program in
//! virtual time, with arms that are emulated byte by byte.

use std::time::Duration;

use pb3dp_servo::supervisor::{Condition, State, Why};
use pb3dp_setup::setup::{Setup, read_setup};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig};
use system_tests::repository;

use crate::disturbed::{Decided, Disturbance, Ran, run, setup};

/// The target begins to move, seconds.
const MOVES_S: f64 = 3.0;
/// From a hold to standstill, seconds.
const STOPS_S: f64 = 0.25;

/// The experiment of Fig. 7: 100 mm within 2 s.
fn fig7() -> Setup {
    setup(read_setup(&repository().join("configs/hil.toml")).unwrap().experiment.motion).unwrap()
}

fn sine(channel: Channel, period_s: f64, amplitude: f64) -> Setup {
    let axes = ExperimentAxes::TargetAtStart;
    setup(MotionConfig::Sine(SineConfig { channel, amplitude, period_s, periods: 6, lead_in_s: MOVES_S, axes }))
        .unwrap()
}

fn is_late(step: &&Decided) -> bool {
    matches!(step.why, Why::Slowed { cause, .. } | Why::Resting { cause, .. } if cause.condition == Condition::LateImages)
}

/// Largest distance of the hand from where it is without a disturbance, until this time, mm.
fn beside_mm(ran: &Ran, undisturbed: &Ran, until_s: f64) -> f64 {
    let pairs = ran.places.iter().zip(&undisturbed.places).filter(|(place, _)| place.t_s <= until_s);
    pairs.map(|(own, other)| (own.hand_mm - other.hand_mm).norm()).fold(0.0, f64::max)
}

/// The hand is held within 2 s of the begin of the motion. At up to 100 mm/s it is less than 30 mm from where it should be then.
#[test]
fn images_that_are_late_under_fresh_stamps_hold_the_hand() {
    for (name, setup, error_max_mm) in [
        ("Fig. 7", fig7(), 30.0),
        ("200 mm in 6 s", sine(Channel::X, 6.0, 0.1), 30.0),
        ("200 mm in 3 s", sine(Channel::Y, 3.0, 0.1), 80.0),
    ] {
        let undisturbed = run(&setup, Disturbance::None, 8.0).unwrap();
        for late_s in [0.05, 0.08, 0.12, 0.2] {
            let ran = run(&setup, Disturbance::LateImages(late_s), 8.0).unwrap();
            let late = |state: fn(State) -> bool| ran.decided.iter().filter(is_late).find(|step| state(step.state));
            let slowed_s = late(State::is_moving).map(|step| step.t_s - MOVES_S);
            let held = late(State::is_resting).unwrap_or_else(|| panic!("{name}, {late_s} s: not held"));
            let held_s = held.t_s - MOVES_S;
            let error_mm = beside_mm(&ran, &undisturbed, held.t_s);
            println!(
                "{name}, {late_s} s late: slowed after {slowed_s:.2?} s, held after {held_s:.2} s; {error_mm:.1} mm beside then, {:.1} mm {STOPS_S} s later; {}",
                beside_mm(&ran, &undisturbed, held.t_s + STOPS_S),
                held.why
            );
            assert!(held_s < 2.0 && error_mm < error_max_mm, "{name}, {late_s} s: {held_s} s, {error_mm} mm");
            let last = ran.decided.last().unwrap();
            assert!(last.why.waits_for_resume(), "{name}, {late_s} s: {}", last.why);
        }
    }
}

/// What a hand follows is no swing: targets at up to 2.6 m/s^2, of which it follows the quickest ones badly.
#[test]
fn targets_that_the_hand_follows_hold_nothing() {
    let setups = [
        fig7(),
        sine(Channel::X, 6.0, 0.1),
        sine(Channel::Y, 3.0, 0.1),
        sine(Channel::Z, 2.0, 0.04),
        sine(Channel::X, 2.0, 0.1),
        sine(Channel::X, 1.5, 0.15),
        sine(Channel::X, 1.0, 0.05),
        sine(Channel::Rx, 3.0, 0.35),
        sine(Channel::Ry, 4.0, 0.35),
        sine(Channel::Rz, 3.0, 0.5),
    ];
    for setup in setups {
        let ran = run(&setup, Disturbance::None, 14.0).unwrap();
        let late = ran.decided.iter().find(is_late);
        assert!(late.is_none(), "{:?}: {late:?}", setup.experiment.motion);
        assert_eq!(ran.ended, None);
    }
}

/// An arm that follows its commands later than the model knows: its guard finds that, or the hand follows within 5 mm.
#[test]
fn an_arm_that_is_later_than_its_model_is_stopped_or_follows() {
    let late_arm = |late_s: f64| {
        let hil = fig7();
        let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
        setup.compared.clear();
        (setup.pace, setup.leader, setup.geometric) = (hil.pace, hil.leader, hil.geometric);
        (setup.experiment.carrier, setup.experiment.motion) = (hil.experiment.carrier, hil.experiment.motion);
        setup.rig.arms.vs.plant.command_delay += Duration::from_secs_f64(late_s);
        run(&setup, Disturbance::None, 10.0).unwrap()
    };
    let undisturbed = late_arm(0.0);
    for late_s in [0.05, 0.08, 0.12, 0.2] {
        let ran = late_arm(late_s);
        let last_s = ran.places.last().unwrap().t_s;
        let error_mm = beside_mm(&ran, &undisturbed, last_s);
        let ended = ran.ended.as_deref().unwrap_or("followed");
        println!("arm {late_s} s late: {error_mm:.1} mm beside in {last_s:.1} s; {ended}");
        let is_stopped = ended.contains("guard") && last_s < MOVES_S + 2.0 && error_mm < 30.0;
        assert!(is_stopped || ran.ended.is_none() && error_mm < 5.0, "{late_s} s: {error_mm} mm; {ended}");
        assert!(is_stopped || late_s < 0.2, "{late_s} s: {ended}");
    }
}
