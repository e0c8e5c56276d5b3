//! Failures that are never consecutive, and slow drift: each stops the arms. The whole program in virtual time, with arms that are
//! emulated byte by byte.

use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig};
use system_tests::disturbed::{Disturbance, Ran, run, setup};

/// Both arms are enabled and the hand follows by then, seconds.
const FROM_S: f64 = 4.0;
/// More than any time between two faults, seconds.
const NEVER_AGAIN_S: f64 = 1e3;

fn ran(arm: usize, lines: &'static [&'static str], every_s: f64, for_s: f64) -> Ran {
    let motion = SineConfig {
        channel: Channel::Y,
        amplitude: 0.05,
        period_s: 6.0,
        periods: 100,
        lead_in_s: 0.0,
        axes: ExperimentAxes::TargetAtStart,
    };
    let setup = setup(MotionConfig::Sine(motion)).unwrap();
    run(&setup, Disturbance::Faults { arm, lines, from_s: FROM_S, every_s }, FROM_S + for_s).unwrap()
}

/// The run ended with this text, and within this time after the first fault.
fn stopped(ran: &Ran, text: &str, within_s: f64) {
    let ended = ran.ended.as_deref().unwrap_or("nothing stopped the arms");
    assert!(ended.contains(text), "{ended}");
    let after_s = ran.ended_s - FROM_S;
    println!("{after_s:.2} s: {ended}");
    assert!(after_s <= within_s, "only after {after_s} s: {ended}");
}

#[test]
fn two_replies_of_three_lost_for_ever_latch_within_half_a_second() {
    for arm in [0, 1] {
        stopped(&ran(arm, &["line drop 2"], 0.03, 5.0), "of the last 100 exchanges", 0.5);
        stopped(&ran(arm, &["line corrupt 1"], 0.02, 5.0), "of the last 100 exchanges", 0.6);
    }
}

/// One reply of ten: the arm goes on, as an arm at a noisy line should.
#[test]
fn one_reply_of_ten_lost_for_ever_stops_nothing() {
    let ran = ran(0, &["line drop 1"], 0.1, 5.0);
    assert_eq!(ran.ended, None);
}

#[test]
fn every_second_encoder_sample_wrong_latches_within_a_quarter_of_a_second() {
    for arm in [0, 1] {
        let ran = ran(arm, &["jump 3 0.1rad", "jump 3 -0.1rad"], 0.01, 5.0);
        stopped(&ran, "axis 3 seems to have moved", 0.25);
    }
}

/// The arm with the target holds.
#[test]
fn a_creep_of_an_arm_that_holds_is_found() {
    for (line, within_s) in [(&["runaway 2 0.001rad/s"], 60.0), (&["runaway 2 0.0015rad/s"], 20.0)] {
        stopped(&ran(1, line, NEVER_AGAIN_S, 40.0), "although the arm is commanded to hold", within_s);
    }
    let ran = ran(1, &["runaway 2 0.0002rad/s"], NEVER_AGAIN_S, 60.0);
    assert_eq!(ran.ended, None, "half of what is forgotten");
}
