//! The limits that the servo must meet.

use pb3dp_benchmarks::limit::Check;
use pb3dp_cell::figures::RmsMax;

use crate::cases::Approached;
use crate::runs::{Fig7, Response, Step};
use crate::setups::{DELAYS_MILLIS, TARGETS, Who};
use crate::ways::Way;

/// Position error in motion, rms, mm: for the colourful and the crab-like card, at each delay.
const MOVING_MM: [[f64; 2]; 2] = [[1.2, 2.0], [1.8, 2.8]];
/// Position error while holding, rms, mm: for both cards.
const HOLD_MM: [f64; 2] = [0.3, 0.6];
/// Orientation error in motion and while holding, rms, degrees.
const MOVING_DEG: f64 = 0.25;
const HOLD_DEG: f64 = 0.1;
/// Lag by cross-correlation, seconds.
const LAG_S: f64 = 0.010;
/// Gain above or below 0, dB, and phase lag, degrees.
const GAIN_DB: f64 = 1.0;
const PHASE_LAG_DEG: f64 = 5.0;
/// Overshoot of the step, percent.
const OVERSHOOT_PERCENT: f64 = 5.0;

/// The limits of one run of the experiment of Fig. 7; none for runs that are only reported.
pub fn of_fig7(run: &Fig7) -> Vec<Check> {
    let delay = DELAYS_MILLIS.iter().position(|delay| *delay == run.delay_millis);
    let target = TARGETS[..2].iter().position(|(name, _)| *name == run.target);
    let (Some(delay), Some(target), true) = (delay, target, run.who == Who::Ours.name()) else { return Vec::new() };
    let check = |what: &str, found: Option<f64>, most: f64, unit: &'static str| {
        let what = format!("{}, {:.0} ms: {what}", run.target, run.delay_millis);
        Check { what, found, most, unit }
    };
    let rms = |error: Option<RmsMax>| error.map(|error| error.rms);
    let locked = &run.summary.locked;
    // A channel without a measured lag is not followed.
    let lags: Option<Vec<f64>> = run.summary.channels.iter().map(|channel| channel.lag_s.map(f64::abs)).collect();
    let lag_s = lags.and_then(|lags| lags.into_iter().reduce(f64::max));
    vec![
        check("position error in motion, rms", rms(locked.moving_mm), MOVING_MM[delay][target], "mm"),
        check("orientation error in motion, rms", rms(locked.moving_deg), MOVING_DEG, "deg"),
        check("position error while holding, rms", rms(locked.hold_mm), HOLD_MM[target], "mm"),
        check("orientation error while holding, rms", rms(locked.hold_deg), HOLD_DEG, "deg"),
        check("largest lag of the axes", lag_s.map(|lag_s| lag_s * 1e3), LAG_S * 1e3, "ms"),
    ]
}

/// The limits of the frequency response of one channel: over all periods that the arm could follow without lag.
pub fn of_responses(channel: &str, responses: &[Response]) -> Vec<Check> {
    let ours = |response: &&Response| response.who == Who::Ours.name() && response.channel == channel;
    let possible: Vec<&Response> = responses.iter().filter(ours).filter(|response| response.is_possible()).collect();
    let shortest_s = possible.iter().map(|response| response.period_s).fold(f64::INFINITY, f64::min);
    let worst = |pick: fn(&Response) -> Option<f64>| -> Option<f64> {
        let figures: Option<Vec<f64>> = possible.iter().map(|response| pick(response)).collect();
        figures.and_then(|figures| figures.into_iter().reduce(f64::max))
    };
    let what = |figure: &str| format!("sinusoids of {channel} from {shortest_s} s on: {figure}");
    vec![
        Check {
            what: what("largest gain error"),
            found: worst(|r| r.gain_db.map(f64::abs)),
            most: GAIN_DB,
            unit: "dB",
        },
        Check {
            what: what("largest phase lag"),
            found: worst(|r| r.phase_deg.map(|p| -p)),
            most: PHASE_LAG_DEG,
            unit: "deg",
        },
    ]
}

/// The limits of one step.
pub fn of_step(step: &Step) -> Vec<Check> {
    if step.who != Who::Ours.name() {
        return Vec::new();
    }
    let (channel, summary) = (&step.summary.channel, &step.summary);
    // Without settling the overshoot has no meaning.
    let found = summary.settled_after_s.and(summary.overshoot_percent);
    let what = format!("step of {channel}: settles to 1 mm and 0.3 deg, overshoot");
    vec![Check { what, found, most: OVERSHOOT_PERCENT, unit: "%" }]
}

/// Tolerance for speeds and accelerations over the limit: they are differences of rounded angles.
const SHARE_MOST: f64 = 1.02;

/// Tolerance for angles, which are rounded as well.
const BEYOND_MOST_DEG: f64 = 0.001;

/// No path exceeds a limit of the arm.
fn of_arm(way: &Way) -> Vec<Check> {
    let check = |what: &str, found: f64, most: f64, unit: &'static str| Check {
        what: format!("{}: {what}", way.name),
        found: Some(found),
        most,
        unit,
    };
    vec![
        check("largest joint speed, share of the limit", way.used.speed.0, SHARE_MOST, ""),
        check("largest joint acceleration, share of the limit", way.used.acceleration.0, SHARE_MOST, ""),
        check("largest excess over an end of the range", -way.used.room_deg.0, BEYOND_MOST_DEG, "deg"),
    ]
}

/// An approach arrives, or stops with the reason, and exceeds no limit.
pub fn of_approach(approach: &Approached) -> Vec<Check> {
    let way = &approach.way;
    let mut checks = of_arm(way);
    checks.push(if approach.is_reachable {
        let what = format!("{}: settling time", way.name);
        Check { what, found: way.there_after_s, most: APPROACH_MOST_S, unit: "s" }
    } else {
        let has_reason = way.mode.starts_with("holding: ");
        let what = format!("{}: stops without a reason", way.name);
        Check { what, found: Some(f64::from(u8::from(!has_reason))), most: 0.0, unit: "" }
    });
    checks
}

/// Largest settling time of an approach, seconds.
const APPROACH_MOST_S: f64 = 15.0;
/// Largest error at the end of a path through or to a singular pose, mm and degrees, and most joint reversals.
const SINGULAR_LEFT: (f64, f64) = (1.0, 0.3);
const SINGULAR_TURNS: f64 = 30.0;

/// A path through a singular pose does not halt or oscillate; an unreachable one stops with the reason. Both return.
pub fn of_singular(way: &Way, is_reachable: bool) -> Vec<Check> {
    let mut checks = of_arm(way);
    let mut push = |what: &str, found: f64, most: f64, unit: &'static str| {
        checks.push(Check { what: format!("{}: {what}", way.name), found: Some(found), most, unit });
    };
    push("position error at the end", way.left.0, SINGULAR_LEFT.0, "mm");
    push("orientation error at the end", way.left.1, SINGULAR_LEFT.1, "deg");
    push("joint reversals", way.used.turns as f64, SINGULAR_TURNS, "");
    if is_reachable {
        push("share of time on hold", way.held.0, 0.0, "");
    } else {
        let names = way.held.1.as_deref().is_some_and(|reason| reason.starts_with("holding: "));
        push("stops without a reason", f64::from(u8::from(!names)), 0.0, "");
    }
    checks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_response_that_is_missing_is_a_miss() {
        assert!(of_responses("x", &[]).iter().all(|check| !check.is_kept()));
    }
}
