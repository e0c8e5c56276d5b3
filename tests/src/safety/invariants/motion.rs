//! Ranges, speeds and accelerations of joints, and joints that move by themselves.

use super::super::rules::{ArmRules, Rules};
use super::super::truth::{ArmTruth, Joints, Step};
use super::{Found, Invariant, Place};

/// Windows for changes of speed, seconds: one shows a jump, the other acceleration.
const WINDOWS_S: [f64; 2] = [0.020, 0.100];
/// Share of the acceleration limit within a window, while no command is lost or late.
const ACCELERATION_SHARE: f64 = 1.3;
/// Number of cycles by which a joint may gain speed beyond its window otherwise. Chosen: as many commands in a row may be late or
/// lost, and the next one contains the accumulated difference. In 200 runs 12.4 ms were needed; with one cycle one of them
/// has a violation.
const CYCLES_MORE: f64 = 2.0;
/// Share of the jerk limit between two cycles.
const JERK_SHARE: f64 = 1.1;
/// Rounding of three commands, of which the middle one counts twice, by the host and again by a gateway that interpolates: each
/// rounds to 1/5000 rad/s, so these are 2 * 4 times half a step, rad/s.
const JERK_MORE_RAD_PER_S: f64 = 8e-4;
/// From this share of the acceleration limit on, a drive that keeps this limit itself may hide its command.
const CLIPPED_SHARE: f64 = 0.95;
/// Number of steps without a disturbance until the jerk counts: the differences, and a cycle.
const JERK_AFTER_STEPS: usize = 20;
/// Tolerance of the speed limit: commands are rounded to 1/5000 rad/s, and the record to 2 ms.
const SPEED_SHARE: f64 = 1.01;
const SPEED_MORE_RAD_PER_S: f64 = 0.001;

pub(super) fn check(rules: &Rules, steps: &[Step], found: &mut Found) {
    for arm in 0..2 {
        for joint in 0..7 {
            let (mut range, mut disobeyed) = (Range::default(), Disobedience::default());
            for (index, step) in steps.iter().enumerate() {
                let before = index.checked_sub(1).map(|before| &steps[before]);
                range.look(rules, (arm, joint, step), found);
                speed(rules, (arm, joint), (step, before), &mut disobeyed, found);
                disobeyed.look(rules, (arm, joint, step), found);
            }
            jerk(rules, (arm, joint), steps, found);
        }
        for window_s in WINDOWS_S {
            acceleration(rules, (arm, steps), window_s, found);
        }
    }
}

/// The range of one joint. A joint that an injected fault moved out, or that fell out without a drive, may be out until it is back; as soon
/// as the limiter controls it again, it goes no farther out.
#[derive(Default)]
struct Range {
    may_be_out: bool,
    /// No farther out than this, radians, since the joint obeys again.
    farthest_rad: Option<f64>,
}

impl Range {
    fn look(&mut self, rules: &Rules, (arm, joint, step): (usize, usize, &Step), found: &mut Found) {
        let (truth, rules) = (&step.arms[arm], (&rules.arms[arm], rules.cycle_s));
        let value = truth.position_rad[joint].abs();
        let limit = self.limit_rad(truth, joint, rules);
        if value > limit {
            let place = Place { invariant: Invariant::Position, arm: Some(arm), joint: Some(joint), t_s: step.t_s };
            found.push(place, (value, limit), "");
        }
    }

    fn limit_rad(&mut self, truth: &ArmTruth, joint: usize, (rules, cycle_s): (&ArmRules, f64)) -> f64 {
        let operating_rad = rules.operating_rad[joint] + rules.operating_margin_rad;
        let position_rad = truth.position_rad[joint].abs();
        if truth.disobeys[joint] || !truth.driven[joint] {
            self.may_be_out = true;
            self.farthest_rad = None;
            return rules.mechanical_rad[joint];
        }
        self.may_be_out &= position_rad > operating_rad;
        if !self.may_be_out {
            self.farthest_rad = None;
            return operating_rad;
        }
        let farthest_rad = *self.farthest_rad.get_or_insert_with(|| {
            let speed = truth.velocity_rad_per_s[joint].abs();
            let braking_rad = 0.5 * speed * speed / rules.acceleration_rad_per_s2[joint];
            position_rad + speed * (rules.reaction_s + rules.lag_s + cycle_s) + braking_rad + rules.operating_margin_rad
        });
        farthest_rad.min(rules.mechanical_rad[joint])
    }
}

/// Additional speed of a joint that moves by itself, or returns from there, until this is detected, for which there is
/// another limit: drives are not exact, and their monitors allow for it (docs/arm-limits.md).
const SPEED_SHARE_BY_ITSELF: f64 = 1.1;

/// Checks the recorded speed, and the speed from the distance moved: a joint that jumps is fast. A joint that moves by
/// itself may be faster from that moment, for as long as it takes to detect this and to close the brakes.
fn speed(
    rules: &Rules,
    (arm, joint): (usize, usize),
    (step, before): (&Step, Option<&Step>),
    disobeyed: &mut Disobedience,
    found: &mut Found,
) {
    let truth = &step.arms[arm];
    if !truth.driven[joint] || before.is_some_and(|before| !before.arms[arm].driven[joint]) {
        disobeyed.too_fast_since_s = None;
        return;
    }
    let went = before.map_or(0.0, |before| {
        (truth.position_rad[joint] - before.arms[arm].position_rad[joint]) / (step.t_s - before.t_s)
    });
    let value = truth.velocity_rad_per_s[joint].abs().max(went.abs());
    let by_itself = truth.disobeys[joint];
    let share = if by_itself { SPEED_SHARE_BY_ITSELF } else { SPEED_SHARE };
    let limit = rules.arms[arm].speed_rad_per_s[joint] * share + SPEED_MORE_RAD_PER_S;
    if value <= limit {
        disobeyed.too_fast_since_s = None;
        return;
    }
    let lasts_s = match by_itself {
        true => step.t_s - *disobeyed.too_fast_since_s.get_or_insert(step.t_s),
        false => f64::INFINITY,
    };
    let allowed_s = if truth.commands_disturbed { rules.too_fast_s + rules.unobserved_s } else { rules.too_fast_s };
    if lasts_s >= allowed_s {
        let place = Place { invariant: Invariant::Speed, arm: Some(arm), joint: Some(joint), t_s: step.t_s };
        found.push(place, (value, limit), if by_itself { format!("for {lasts_s:.3} s") } else { String::new() });
    }
}

/// Within a window a joint's speed changes by at most its acceleration limit times the window and [`ACCELERATION_SHARE`], or, if commands
/// were lost or late, the window and [`CYCLES_MORE`]. An arm that was not stopped by commands has other limits: those of its brakes, and
/// those of its watchdog ([`Fade`]).
fn acceleration(rules: &Rules, (arm, steps): (usize, &[Step]), window_s: f64, found: &mut Found) {
    let (mut from, mut commanded_since, mut undisturbed_since) = (0, [0; 7], 0);
    let mut fade = Fade { window_s, ..Fade::default() };
    for (index, step) in steps.iter().enumerate() {
        let truth = &step.arms[arm];
        fade.look((rules, &rules.arms[arm]), step.t_s, truth);
        if truth.commands_disturbed {
            undisturbed_since = index + 1;
        }
        for (joint, since) in commanded_since.iter_mut().enumerate() {
            if !is_commanded(truth, joint) {
                *since = index + 1;
            }
        }
        while step.t_s - steps[from].t_s > window_s + 1e-9 {
            from += 1;
        }
        let passed_s = step.t_s - steps[from].t_s;
        let over_s = match from >= undisturbed_since {
            true => passed_s * ACCELERATION_SHARE,
            false => passed_s + CYCLES_MORE * rules.cycle_s,
        };
        for joint in (0..7).filter(|&joint| from >= commanded_since[joint]) {
            let before = steps[from].arms[arm].velocity_rad_per_s[joint];
            let value = (truth.velocity_rad_per_s[joint] - before).abs();
            let limit = rules.arms[arm].acceleration_rad_per_s2[joint] * over_s + 2.0 * SPEED_MORE_RAD_PER_S;
            let loses_speed = truth.velocity_rad_per_s[joint].abs() < before.abs();
            let limit = if loses_speed { limit + fade.loss_rad_per_s(joint, window_s / rules.fade_s) } else { limit };
            if value > limit {
                let t_s = step.t_s;
                let place = Place { invariant: Invariant::Acceleration, arm: Some(arm), joint: Some(joint), t_s };
                found.push(place, (value, limit), format!("within {:.0} ms", window_s * 1e3));
            }
        }
    }
}

/// Whether commands alone determine the motion of this joint.
fn is_commanded(truth: &ArmTruth, joint: usize) -> bool {
    let is_stopped = truth.brakes_closed || truth.stops_by_itself || truth.latched_since_s.is_some();
    truth.driven[joint] && !truth.disobeys[joint] && !is_stopped
}

/// Number of steps of the record in a cycle.
const CYCLE_STEPS: usize = 5;

/// The commanded speed of a joint, from its true motion: its drive is a lag of first order, v' = (u - v) / lag, so that
/// u = (v1 - v0 e) / (1 - e) with e = exp(-step / lag). The lag hides the jerk of the true motion, and this does not: between commands that
/// are neither lost nor late, the second difference of u over cycles is at most the jerk limit times the square of the cycle.
///
/// The ramp of the driver, by which it brakes the arm for a hold, has no limit of jerk; neither have its brakes.
///
/// A step in which the command changes gives a value between both. As it has the same phase in each cycle, its second difference is a mean
/// of two, and within the same limit.
fn jerk(rules: &Rules, (arm, joint): (usize, usize), steps: &[Step], found: &mut Found) {
    let limits = &rules.arms[arm];
    // Each of the four speeds of a second difference may be off by the friction.
    let more_rad_per_s = JERK_MORE_RAD_PER_S + 4.0 * limits.friction_rad_per_s;
    let limit = limits.jerk_rad_per_s3[joint] * JERK_SHARE * rules.cycle_s + more_rad_per_s / rules.cycle_s;
    let mut commanded = [0.0; 2 * CYCLE_STEPS + 1];
    let mut known = 0;
    for (index, pair) in steps.windows(2).enumerate() {
        let [before, now] = [&pair[0].arms[arm], &pair[1].arms[arm]];
        // Without samples of one arm, or once it is latched, the coupling holds the other one.
        let is_held = |arm: &ArmTruth| arm.commands_disturbed || arm.latched_since_s.is_some();
        let is_undisturbed = !pair[1].arms.iter().any(is_held) && now.command_age_s <= rules.fades_after_s;
        let [v0, v1] = [before, now].map(|arm| arm.velocity_rad_per_s[joint]);
        let (passed_s, most_rad_per_s2) = (pair[1].t_s - pair[0].t_s, limits.acceleration_rad_per_s2[joint]);
        let is_clipped = limits.drives_clip && (v1 - v0).abs() > CLIPPED_SHARE * most_rad_per_s2 * passed_s;
        let is_clear = is_commanded(now, joint) && is_undisturbed && !now.ramps && !is_clipped;
        known = if is_clear { known + 1 } else { 0 };
        let left = (-passed_s / limits.lag_s).exp();
        commanded[index % commanded.len()] = (v1 - v0 * left) / (1.0 - left);
        if known < JERK_AFTER_STEPS {
            continue;
        }
        let ago = |steps: usize| commanded[(index - steps) % commanded.len()];
        let change = ((ago(0) - ago(CYCLE_STEPS)) - (ago(CYCLE_STEPS) - ago(2 * CYCLE_STEPS))).abs() / rules.cycle_s;
        // A latch takes effect within a step of the record.
        let goes_on = |next: &Step| is_commanded(&next.arms[arm], joint) && !next.arms.iter().any(is_held);
        if change > limit && steps.get(index + 2).is_some_and(goes_on) {
            let place = Place { invariant: Invariant::Jerk, arm: Some(arm), joint: Some(joint), t_s: pair[1].t_s };
            found.push(place, (change, limit), "rad/s^2 of change of acceleration from cycle to cycle");
        }
    }
}

/// An arm that its watchdog slows down, because the control loop is late.
///
/// The watchdog takes the same time from any speed, so its deceleration grows with the speed: at 0.6 rad/s it is ten times the
/// limit of S1. The drives are a linear filter of the commanded speeds with a gain of 1 and a positive impulse response, so the true
/// speed loses no more within a window than the commanded one: its share of the time of the fade, times the speed before it.
#[derive(Default)]
struct Fade {
    /// Length of the windows, seconds.
    window_s: f64,
    /// Until this time a window may contain a moment at which the drives still followed the fade.
    until_s: f64,
    /// Speeds before it.
    speeds_rad_per_s: Joints,
}

impl Fade {
    fn look(&mut self, (rules, arm): (&Rules, &ArmRules), t_s: f64, truth: &ArmTruth) {
        /// Time constants of a drive after which less than 1 % of a change is left.
        const LAGS: f64 = 5.0;
        let is_late = truth.command_age_s > rules.fades_after_s;
        if t_s > self.until_s {
            self.speeds_rad_per_s = [0.0; 7];
        }
        if is_late {
            // A window that begins by then contains a part of the fade.
            self.until_s = t_s + arm.reaction_s + LAGS * arm.lag_s + self.window_s;
        }
        if is_late || t_s <= self.until_s {
            for (speed, now) in self.speeds_rad_per_s.iter_mut().zip(&truth.velocity_rad_per_s) {
                *speed = speed.max(now.abs());
            }
        }
    }

    /// Speed that a joint may lose by the fade within this share of its time, rad/s.
    fn loss_rad_per_s(&self, joint: usize, share: f64) -> f64 {
        self.speeds_rad_per_s[joint] * share.min(1.0)
    }
}

/// A joint that moves by itself.
#[derive(Default)]
struct Disobedience {
    since_s: Option<f64>,
    /// Time since which it is too fast.
    too_fast_since_s: Option<f64>,
}

impl Disobedience {
    fn look(&mut self, rules: &Rules, (arm, joint, step): (usize, usize, &Step), found: &mut Found) {
        let truth = &step.arms[arm];
        // A stuck or braked joint does not move; the other limits check the reaction of its arm.
        let moves = truth.by_itself[joint] && truth.velocity_rad_per_s[joint].abs() > rules.rest_rad_per_s;
        if !moves {
            self.since_s = None;
            return;
        }
        let lasts_s = step.t_s - *self.since_s.get_or_insert(step.t_s);
        if truth.latched_since_s.is_none() && lasts_s > rules.disobedience_s {
            let place = Place { invariant: Invariant::Disobedience, arm: Some(arm), joint: Some(joint), t_s: step.t_s };
            found.push(place, (lasts_s, rules.disobedience_s), "");
        }
    }
}
