//! Statistics over many runs.

use std::collections::BTreeMap;

use system_tests::safety::rules::Rules;
use system_tests::safety::truth::{ARM_NAMES, HAND_ARM, Step, Truth};

use crate::Judged;
use crate::effects::Became;
use crate::scenario::Draw;

/// Counts of one kind of fault.
#[derive(Clone, Copy, Debug, Default)]
pub struct Count {
    /// Drawn in scenarios.
    pub drawn: u64,
    /// Active while the control loop ran.
    pub begun: u64,
    /// Without effect.
    pub without_effect: u64,
    /// Noticed: a log line, or a counter that rose, during the fault or soon after.
    pub noticed: u64,
}

/// Margin to a limit: the largest share of the limit that was used.
#[derive(Clone, Copy, Debug, Default)]
pub struct Margin {
    /// Largest share; 1 is the limit.
    pub share: f64,
    /// Seed of that run.
    pub seed: u64,
}

impl Margin {
    fn add(&mut self, share: f64, seed: u64) {
        // Of equal shares the smaller seed counts, so that the order of the runs does not matter.
        if share > self.share || (share == self.share && seed < self.seed) {
            *self = Self { share, seed };
        }
    }
}

/// Statistics of many runs.
#[derive(Debug, Default)]
pub struct Figures {
    /// Number of runs.
    pub runs: u64,
    /// Violations: invariant, and the runs that violated it.
    pub violations: BTreeMap<String, Vec<(u64, Draw)>>,
    /// By kind of fault.
    pub faults: BTreeMap<&'static str, Count>,
    /// By kind of fault, and by the state of the supervisor in which it began: number with an effect, and number of these noticed.
    pub states: BTreeMap<&'static str, BTreeMap<&'static str, [u64; 2]>>,
    /// By kind of motion.
    pub motions: BTreeMap<&'static str, u64>,
    /// By property of the workcell, and whether a new host began.
    pub cells: BTreeMap<&'static str, u64>,
    /// Reasons why control loops ended.
    pub ends: BTreeMap<String, u64>,
    /// By limit and arm.
    pub margins: BTreeMap<String, Margin>,
    /// Runs in which the hand may search for a lost target, and the total time of searching, seconds.
    pub searches: (u64, f64),
    /// Hash of all records, independent of their order.
    pub digest: u64,
    /// CPU time, milliseconds.
    pub cpu_millis: f64,
    /// Virtual time in which the control loop ran or the arms were observed after it, seconds.
    pub virtual_s: f64,
}

impl Figures {
    /// Adds a run.
    pub fn add(&mut self, judged: &Judged, rules: &Rules) {
        let Judged { scenario, ran, violations, digest, cpu_millis, .. } = judged;
        self.runs += 1;
        self.digest = self.digest.wrapping_add(digest.wrapping_mul(2 * scenario.seed + 1));
        self.cpu_millis += cpu_millis;
        self.virtual_s += ran.truth.steps.last().map_or(0.0, |step| step.t_s);
        *self.motions.entry(scenario.motion_name).or_default() += 1;
        for property in scenario.workcell.settings.properties() {
            *self.cells.entry(property).or_default() += 1;
        }
        if ran.has_new_host {
            *self.cells.entry("a new host, after the first one died").or_default() += 1;
        }
        self.searches.0 += u64::from(scenario.searches);
        self.searches.1 += searched_s(&ran.truth, rules);
        for violation in violations {
            let seeds = self.violations.entry(violation.invariant.name().to_owned()).or_default();
            seeds.push((scenario.seed, scenario.draw));
            seeds.sort_unstable();
            seeds.dedup();
        }
        for ((fault, became), state) in scenario.faults.iter().zip(&ran.became).zip(&ran.states) {
            let had_effect = matches!(became, Became::Borne | Became::Noticed);
            if let Some(state) = state.filter(|_| had_effect) {
                let [entered, noticed] = self.states.entry(fault.name()).or_default().entry(state).or_default();
                *entered += 1;
                *noticed += u64::from(*became == Became::Noticed);
            }
            let count = self.faults.entry(fault.name()).or_default();
            count.drawn += 1;
            count.begun += u64::from(*became != Became::AfterTheEnd);
            count.without_effect += u64::from(*became == Became::NoEffect);
            count.noticed += u64::from(*became == Became::Noticed);
        }
        *self.ends.entry(ran.ended.as_deref().map_or_else(|| "end of the run".to_owned(), cause)).or_default() += 1;
        self.margins_of(&ran.truth, rules, scenario.seed);
    }

    /// Share of their limits that the joints used, while they obeyed.
    fn margins_of(&mut self, truth: &Truth, rules: &Rules, seed: u64) {
        /// 20 ms.
        const WINDOW: usize = 10;
        /// Time for which drives follow a fade after a late command, seconds.
        const FADED_S: f64 = 0.2;
        let fades_after_s = rules.fades_after_s;
        for (arm, rules) in rules.arms.iter().enumerate() {
            let mut late_s = f64::NEG_INFINITY;
            let (mut range, mut speed, mut acceleration) = (0.0f64, 0.0f64, 0.0f64);
            for (index, step) in truth.steps.iter().enumerate() {
                let now = &step.arms[arm];
                let is_free = !now.obeys() || !now.servo_on || now.brakes_closed || now.stops_by_itself;
                if now.command_age_s > fades_after_s || is_free {
                    late_s = step.t_s;
                }
                if !now.obeys() || !now.servo_on {
                    continue;
                }
                for joint in 0..7 {
                    range = range.max(now.position_rad[joint].abs() / rules.operating_rad[joint]);
                    speed = speed.max(now.velocity_rad_per_s[joint].abs() / rules.speed_rad_per_s[joint]);
                    if let Some(before) = index.checked_sub(WINDOW).map(|before| &truth.steps[before]) {
                        let then = &before.arms[arm];
                        let changed = (now.velocity_rad_per_s[joint] - then.velocity_rad_per_s[joint]).abs();
                        if step.t_s > late_s + FADED_S && now.latched_since_s.is_none() {
                            let per_s2 = changed / (step.t_s - before.t_s);
                            acceleration = acceleration.max(per_s2 / rules.acceleration_rad_per_s2[joint]);
                        }
                    }
                }
            }
            for (name, share) in [("range", range), ("speed", speed), ("acceleration over 20 ms", acceleration)] {
                self.margins.entry(format!("{}, {name}", ARM_NAMES[arm])).or_default().add(share, seed);
            }
        }
    }

    /// Number of runs that violated an invariant, summed over the invariants.
    pub fn broken(&self) -> usize {
        self.violations.values().map(Vec::len).sum()
    }

    /// Simulated seconds per second of one core; each run counts with its actual length.
    pub fn times_real_time(&self) -> f64 {
        self.virtual_s / (self.cpu_millis * 1e-3).max(1e-9)
    }
}

/// How long the hand moved in search of its target, seconds.
fn searched_s(truth: &Truth, rules: &Rules) -> f64 {
    let moves = |step: &Step| step.arms[HAND_ARM].velocity_rad_per_s.iter().any(|v| v.abs() > rules.rest_rad_per_s);
    let searches = |pair: &&[Step]| pair[1].may_search && pair[1].pose_age_s > rules.pose_age_max_s && moves(&pair[1]);
    truth.steps.windows(2).filter(searches).map(|pair| pair[1].t_s - pair[0].t_s).sum()
}

/// A cause without its numbers, so that equal causes are counted together.
fn cause(text: &str) -> String {
    let text = text.split(';').next().unwrap_or(text).replace(" (pa10 at emulated in virtual time)", "");
    let text: String = text.chars().map(|c| if c.is_ascii_digit() { '#' } else { c }).collect();
    let mut short = String::new();
    for part in text.split('#').filter(|part| !part.is_empty() && *part != ".") {
        if !short.is_empty() {
            short.push('#');
        }
        short.push_str(part);
    }
    short.chars().take(140).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_counted_without_their_numbers() {
        assert_eq!(cause("age 0.123 s, allowed 0.3 s; look"), cause("age 0.456 s, allowed 0.3 s; look"));
        assert_ne!(cause("the link is gone"), cause("emergency stop"));
    }
}
