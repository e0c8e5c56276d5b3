//! A part that stands still for a moment: the target is kept, and the hand goes on. The whole program in virtual time, with arms that are
//! emulated byte by byte.

use pb3dp_servo::supervisor::{Resume, State};
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig};

use crate::disturbed::{Disturbance, Part, Ran, Stall, run, setup};

/// The target moves at 100 mm/s around this time, seconds: after two periods of 2 pi seconds.
const AT_S: f64 = 12.56;
const HALF_A_CYCLE_S: f64 = 0.005;
/// A hand is back within this distance of the undisturbed run, mm.
const BACK_MM: f64 = 2.0;

fn following() -> Setup {
    let motion = SineConfig {
        channel: Channel::X,
        amplitude: 0.1,
        period_s: std::f64::consts::TAU,
        periods: 3,
        lead_in_s: 0.0,
        axes: ExperimentAxes::TargetAtStart,
    };
    setup(MotionConfig::Sine(motion)).unwrap()
}

fn ran(setup: &Setup, disturbance: Disturbance) -> Ran {
    run(setup, disturbance, AT_S + 2.0).unwrap()
}

fn stall(part: Part, from_s: f64, millis: u32) -> Disturbance {
    Disturbance::Stall(Stall { part, from_s, for_s: f64::from(millis) * 1e-3 })
}

/// 40 ms: at most 8 mm beside the undisturbed run, averaged over the times in the control cycle at which they begin, and back within 0.3 s of
/// their end. A stall of the host that begins just before a step costs 8.5 mm: the driver has faded the velocity to nothing then, and the
/// limiter allows no quicker start. Before, each stall of the host cost 38 mm and 0.97 s, because the target was dropped.
#[test]
fn a_stall_of_40_ms_costs_less_than_8_mm_on_average() {
    let setup = following();
    let undisturbed = ran(&setup, Disturbance::None);
    const PHASES_MILLIS: [u32; 5] = [1, 3, 5, 7, 9];
    // Without a newer pair the hand follows the prediction.
    for (part, limit_mm) in [(Part::Host, 9.0), (Part::Estimator, 0.5), (Part::Camera, 0.5)] {
        let mut sum_mm = 0.0;
        for phase_millis in PHASES_MILLIS {
            let stalled = ran(&setup, stall(part, AT_S + f64::from(phase_millis) * 1e-3, 40));
            let (most_mm, back_s) = stalled.beside(&undisturbed, (AT_S, BACK_MM));
            let back_s = back_s - 0.04;
            println!("{part:?}, {phase_millis} ms after a step: {most_mm:.1} mm, back {back_s:.2} s after its end");
            assert_eq!(stalled.ended, None, "{part:?}, {phase_millis} ms after a step");
            assert!(most_mm < limit_mm && back_s < 0.3, "{part:?}, {phase_millis} ms: {most_mm} mm, {back_s} s");
            sum_mm += most_mm;
        }
        assert!(sum_mm / f64::from(PHASES_MILLIS.len() as u32) < 8.0, "{part:?}: {sum_mm} mm in all");
    }
}

/// What a stall costs by its part and length, from the middle of a control cycle on: the largest distance from the undisturbed run, mm. The
/// table stands in docs/servo.md.
#[test]
fn longer_stalls_cost_more_and_the_longest_of_host_and_line_latch() {
    const LENGTHS_MILLIS: [u32; 5] = [20, 31, 40, 80, 160];
    // Largest distance, mm; `None` if the arm latches.
    let limits_mm = [
        (Part::Host, [Some(3.0), Some(9.0), Some(9.0), None, None]),
        (Part::Estimator, [Some(0.5), Some(0.5), Some(0.5), Some(0.5), Some(5.0)]),
        (Part::Camera, [Some(0.5), Some(0.5), Some(0.5), Some(0.5), Some(5.0)]),
        (Part::Link, [Some(2.0), None, None, None, None]),
    ];
    let setup = following();
    let undisturbed = ran(&setup, Disturbance::None);
    for (part, limits_mm) in limits_mm {
        for (millis, limit_mm) in LENGTHS_MILLIS.into_iter().zip(limits_mm) {
            let stalled = ran(&setup, stall(part, AT_S + HALF_A_CYCLE_S, millis));
            let (most_mm, back_s) = stalled.beside(&undisturbed, (AT_S + HALF_A_CYCLE_S, BACK_MM));
            let back_s = (back_s - f64::from(millis) * 1e-3).max(0.0);
            match &stalled.ended {
                None => println!("{part:?}, {millis} ms: {most_mm:.1} mm, back {back_s:.2} s after its end"),
                Some(ended) => println!("{part:?}, {millis} ms: {ended}"),
            }
            assert_eq!(stalled.ended.is_none(), limit_mm.is_some(), "{part:?}, {millis} ms: {:?}", stalled.ended);
            let Some(limit_mm) = limit_mm else { continue };
            assert!(most_mm < limit_mm && back_s < 0.6, "{part:?}, {millis} ms: {most_mm} mm, {back_s} s");
        }
    }
}

/// A host that is silent for longer than the watchdog of the arm allows is no stall: the arm is stopped and latched, as before. That is
/// also so if it stands still for 40 ms within a step, between the readings and the command.
#[test]
fn a_host_that_is_silent_for_50_ms_still_latches_the_arm() {
    for millis in [40, 60] {
        let stalled = ran(&following(), stall(Part::Host, AT_S, millis));
        let ended = stalled.ended.as_deref().unwrap_or_default();
        assert!(ended.contains("the watchdog allows 50ms"), "{millis} ms: {ended:?}");
    }
}

/// With a policy that needs the operator, a stall is a hold as any other.
#[test]
fn a_policy_that_needs_the_operator_keeps_needing_him_after_a_stall() {
    let mut setup = following();
    let stale = pb3dp_servo::supervisor::Condition::ControllerRests;
    setup.supervisor.policies.get_mut(stale).resume = Resume::ByOperator;
    let stalled = ran(&setup, stall(Part::Host, AT_S, 30));
    let held = stalled.held_at(AT_S).unwrap();
    assert_eq!(held.state, State::Holding, "{}", held.why);
    let last = stalled.decided.last().unwrap();
    assert!(last.state == State::Holding && last.why.waits_for_resume(), "{}", last.why);
}
