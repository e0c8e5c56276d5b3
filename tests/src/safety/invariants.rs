//! The invariants: conditions that hold at every moment of every run.
//!
//! | invariant | condition |
//! |---|---|
//! | record | the record is complete: finite numbers, steps in order and not far apart |
//! | position | each joint is within its operating range, and always within its mechanical stops |
//! | speed | no joint is faster than its limit |
//! | acceleration | the change of a joint's speed within 20 ms, and within 100 ms, is within its limit |
//! | jerk | the commanded acceleration, from the true motion, changes from cycle to cycle within its limit |
//! | rest-after-latch | after a latched fault or emergency stop of either arm both are stationary, until it is cleared |
//! | rest-without-pose | without a fresh, confident pose the hand's arm is stationary |
//! | rest-while-inhibited | while a condition of the supervisor inhibits motion, and until it has been gone for some time, the hand's arm is stationary |
//! | late-images | by images that are older than their stamps the hand moves only for a short time |
//! | search | a hand that searches for its target stays within the search range and speed |
//! | rest-without-word | an arm is stationary unless the operator's last command permits its motion |
//! | latch-cleared | only the operator's reset clears a latch |
//! | disobedience | an arm of which a joint moves by itself is latched |
//! | arms-apart | no part of an arm comes close to the other arm |
//! | target-apart | the hand comes no closer to the target by its own motion |
//! | log | a fault with an effect is reported |
//! | recorder-stall | a recorder that stands still changes no motion |
//! | status-line | the status line says why an arm may not move |
//!
//! An arm must be stationary from the moment at which it could have stopped:
//! [`ArmRules::rests_within_s`](super::rules::ArmRules::rests_within_s) at its speed at the time of the cause.

mod motion;
mod rest;
mod room;
mod search;

use std::fmt;

use super::rules::Rules;
use super::truth::{ARM_NAMES, Truth};

/// The invariants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Invariant {
    /// The record itself is complete.
    Record,
    /// Ranges of joints, radians.
    Position,
    /// Speeds of joints, rad/s.
    Speed,
    /// Changes of speed, rad/s.
    Acceleration,
    /// Changes of commanded acceleration from cycle to cycle, rad/s^2.
    Jerk,
    /// Standstill after a fault or emergency stop of either arm; rad/s, or radians of creep.
    RestAfterLatch,
    /// Standstill without a fresh, confident pose; rad/s, or radians of creep.
    RestWithoutPose,
    /// Standstill of the hand while a condition inhibits motion; rad/s, or radians of creep.
    RestWhileInhibited,
    /// Motion by images that are older than their stamps; seconds.
    LateImages,
    /// The search for a lost target; metres, or m/s.
    Search,
    /// Standstill without the operator's command; rad/s, or radians of creep.
    HoldWithoutCommand,
    /// A latch that was cleared without a reset; number of resets.
    LatchCleared,
    /// A joint that moves by itself; seconds.
    Disobedience,
    /// Distance of both arms, metres.
    ArmsApart,
    /// Approach of the hand to the target by its own motion, metres.
    TargetApart,
    /// A fault without a log line; seconds.
    Log,
    /// Another motion than without the stall of the recorder; radians.
    RecorderStall,
    /// A status line without the reason of a hold.
    StatusLine,
}

impl Invariant {
    /// All invariants.
    pub const ALL: [Self; 18] = [
        Self::Record,
        Self::Position,
        Self::Speed,
        Self::Acceleration,
        Self::Jerk,
        Self::RestAfterLatch,
        Self::RestWithoutPose,
        Self::RestWhileInhibited,
        Self::LateImages,
        Self::Search,
        Self::HoldWithoutCommand,
        Self::LatchCleared,
        Self::Disobedience,
        Self::ArmsApart,
        Self::TargetApart,
        Self::Log,
        Self::RecorderStall,
        Self::StatusLine,
    ];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Record => "record",
            Self::Position => "position",
            Self::Speed => "speed",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
            Self::RestAfterLatch => "rest-after-latch",
            Self::RestWithoutPose => "rest-without-pose",
            Self::RestWhileInhibited => "rest-while-inhibited",
            Self::LateImages => "late-images",
            Self::Search => "search",
            Self::HoldWithoutCommand => "rest-without-word",
            Self::LatchCleared => "latch-cleared",
            Self::Disobedience => "disobedience",
            Self::ArmsApart => "arms-apart",
            Self::TargetApart => "target-apart",
            Self::Log => "log",
            Self::RecorderStall => "recorder-stall",
            Self::StatusLine => "status-line",
        }
    }
}

/// A violation: one for each invariant, arm and joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// The invariant.
    pub invariant: Invariant,
    /// Index of the arm, if it concerns one.
    pub arm: Option<usize>,
    /// Index of the joint from the base, 0 to 6, if it concerns one.
    pub joint: Option<usize>,
    /// Time of the first violation, seconds.
    pub first_s: f64,
    /// Number of steps.
    pub steps: usize,
    /// Time of the worst violation, seconds.
    pub worst_s: f64,
    /// The worst value, in the unit of the invariant.
    pub value: f64,
    /// The limit at that time.
    pub limit: f64,
    /// Further information; may be empty.
    pub note: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.invariant.name())?;
        if let Some(arm) = self.arm {
            write!(f, ", {}", ARM_NAMES[arm])?;
        }
        if let Some(joint) = self.joint {
            write!(f, ", axis {}", joint + 1)?;
        }
        let Self { first_s, steps, worst_s, value, limit, note, .. } = self;
        write!(f, ": {value:.6} at {worst_s:.3} s, the limit is {limit:.6}; since {first_s:.3} s, in {steps} steps")?;
        if note.is_empty() { Ok(()) } else { write!(f, "; {note}") }
    }
}

/// Checks a whole run: all violations, in order of the invariants. Empty for a run without violations.
pub fn check(rules: &Rules, truth: &Truth) -> Vec<Violation> {
    let mut found = Found::default();
    record(rules, truth, &mut found);
    if found.0.is_empty() {
        motion::check(rules, &truth.steps, &mut found);
        rest::check(rules, &truth.steps, &mut found);
        rest::late_images(rules, &truth.steps, &mut found);
        search::check(rules, &truth.steps, &mut found);
        room::check(rules, &truth.steps, &mut found);
        status_line(truth, &mut found);
        log(rules, truth, &mut found);
    }
    found.0.sort_by_key(|violation| (violation.invariant, violation.arm, violation.joint));
    found.0
}

/// Compares a run in which the recorder stood still with the same run in which it did not: every joint moves exactly as before, because
/// nothing may wait for the recorder.
pub fn check_recorder_stall(stalled: &Truth, undisturbed: &Truth) -> Option<Violation> {
    let (mut first, mut second) = (stalled.steps.iter(), undisturbed.steps.iter());
    let mut found = Found::default();
    loop {
        let (step, other) = match (first.next(), second.next()) {
            (None, None) => return None,
            (Some(step), Some(other)) => (step, other),
            (Some(step), None) | (None, Some(step)) => {
                let place = Place { invariant: Invariant::RecorderStall, arm: None, joint: None, t_s: step.t_s };
                found.push(place, (stalled.steps.len() as f64, undisturbed.steps.len() as f64), "steps of the record");
                return found.0.pop();
            }
        };
        for (arm, joint) in (0..2).flat_map(|arm| (0..7).map(move |joint| (arm, joint))) {
            let [value, limit] = [step, other].map(|step| step.arms[arm].position_rad[joint]);
            if value.to_bits() != limit.to_bits() {
                let (arm, joint) = (Some(arm), Some(joint));
                let place = Place { invariant: Invariant::RecorderStall, arm, joint, t_s: step.t_s };
                found.push(place, (value, limit), "rad, and without the stall");
                return found.0.pop();
            }
        }
    }
}

/// Where a violation occurred.
#[derive(Clone, Copy, Debug)]
struct Place {
    invariant: Invariant,
    arm: Option<usize>,
    joint: Option<usize>,
    t_s: f64,
}

#[derive(Default)]
struct Found(Vec<Violation>);

impl Found {
    /// Adds a violation: the largest excess over the limit is the worst. NaN is worse than any number.
    fn push(&mut self, place: Place, (value, limit): (f64, f64), note: impl Into<String>) {
        let Place { invariant, arm, joint, t_s } = place;
        let same =
            |earlier: &&mut Violation| (earlier.invariant, earlier.arm, earlier.joint) == (invariant, arm, joint);
        // Two faults without a log line are two violations.
        match self.0.iter_mut().find(same).filter(|_| invariant != Invariant::Log) {
            Some(earlier) => {
                earlier.steps += 1;
                let worse = |beyond: f64, before: f64| beyond.is_nan() || beyond > before;
                if worse((value - limit).abs(), (earlier.value - earlier.limit).abs()) {
                    (earlier.worst_s, earlier.value, earlier.limit, earlier.note) = (t_s, value, limit, note.into());
                }
            }
            None => {
                let note = note.into();
                self.0.push(Violation {
                    invariant,
                    arm,
                    joint,
                    first_s: t_s,
                    steps: 1,
                    worst_s: t_s,
                    value,
                    limit,
                    note,
                });
            }
        }
    }
}

/// A record with gaps proves nothing.
fn record(rules: &Rules, truth: &Truth, found: &mut Found) {
    let place = |t_s| Place { invariant: Invariant::Record, arm: None, joint: None, t_s };
    if truth.steps.len() < 2 {
        found.push(place(0.0), (truth.steps.len() as f64, 2.0), "too few steps");
    }
    for pair in truth.steps.windows(2) {
        let gap_s = pair[1].t_s - pair[0].t_s;
        if !(gap_s > 0.0 && gap_s <= rules.step_max_s + 1e-9) {
            found.push(place(pair[1].t_s), (gap_s, rules.step_max_s), "gap between two steps");
        }
    }
    for step in &truth.steps {
        let angles = step.arms.iter().flat_map(|arm| arm.position_rad.iter().chain(&arm.velocity_rad_per_s));
        let places = step.world_from_target.rotation.iter().flatten().chain(&step.world_from_target.translation_m);
        if let Some(&number) = angles.chain(places).find(|number| !number.is_finite()) {
            found.push(place(step.t_s), (number, 0.0), "not a finite number");
        }
        if step.pose_age_s.is_nan() {
            found.push(place(step.t_s), (step.pose_age_s, 0.0), "age of the pose");
        }
    }
}

fn status_line(truth: &Truth, found: &mut Found) {
    for step in truth.steps.iter().filter(|step| !step.says_why && !matches!(step.state, "approaching" | "tracking")) {
        let place = Place { invariant: Invariant::StatusLine, arm: None, joint: None, t_s: step.t_s };
        found.push(place, (0.0, 1.0), step.state);
    }
}

fn log(rules: &Rules, truth: &Truth, found: &mut Found) {
    let ended_s = truth.steps.last().map_or(0.0, |step| step.t_s);
    for fault in truth.injected.iter().filter(|fault| fault.had_effect) {
        let until_s = fault.until_s + rules.log_within_s;
        let logged = truth.log.iter().any(|line| {
            let t_s = line.t_millis as f64 / 1e3;
            (fault.from_s - 1e-3..=until_s).contains(&t_s)
                && fault.log_terms.iter().any(|term| line.text.contains(term))
        });
        // The log had no time to report what ended the run.
        if !logged && until_s <= ended_s {
            let place = Place { invariant: Invariant::Log, arm: None, joint: None, t_s: until_s };
            let note = format!("{} since {:.3} s: no log line with {:?}", fault.name, fault.from_s, fault.log_terms);
            found.push(place, (until_s - fault.from_s, rules.log_within_s), note);
        }
    }
}

#[cfg(test)]
mod tests;
