//! What the log must report, and by when, given what each part can detect.

use system_tests::safety::truth::{ARM_NAMES, Injected, Truth};

use crate::faults::{Fault, Kind};

/// A fault that lasts this long and is not hidden is detected, seconds.
const KNOWN_S: f64 = 0.02;
/// A fault that ended longer ago than this stops no arm, seconds: a lost link is detected within that time.
const LATE_S: f64 = 0.1;
/// The log gives the reason of a stop within this time, seconds: the control loop stops both arms before.
const STOPPED_S: f64 = 0.7;
/// And is written within this time, seconds: `log_within_s` of the rules.
const WRITTEN_S: f64 = 1.2;
/// Resetting both arms takes this time, seconds; a control step waits for it.
const RESET_S: f64 = 0.6;
/// Tolerance of comparisons of times, seconds.
const NEAR_S: f64 = 1e-3;

/// Actual time of a fault.
#[derive(Clone, Copy, Debug, Default)]
pub struct Happened {
    /// Start, seconds since the run began; none if it never occurred.
    pub from_s: Option<f64>,
    /// End, seconds.
    pub until_s: Option<f64>,
    /// Whether both arms were enabled and not stopped when it began.
    pub could_stop: bool,
}

impl Happened {
    fn overlaps(&self, from_s: f64, until_s: f64) -> bool {
        self.from_s.is_some_and(|own_s| own_s < until_s) && self.until_s.is_none_or(|own_s| own_s > from_s)
    }
}

/// All faults of a run, with their times.
pub struct Faults<'a> {
    /// The faults.
    pub faults: &'a [Fault],
    /// Their actual times.
    pub times: &'a [Happened],
    /// Times of the operator's resets, seconds.
    pub resets_s: &'a [f64],
    /// When no host ran, because the first one had died, seconds.
    pub absent_s: Option<(f64, f64)>,
}

impl Faults<'_> {
    /// The faults that the log must report.
    pub fn to_be_logged(&self, truth: &Truth) -> Vec<Injected> {
        let logged = (0..self.faults.len()).filter_map(|index| self.one(index, truth));
        let ended_s = truth.steps.last().map_or(0.0, |step| step.t_s);
        logged.map(|injected| Injected { until_s: injected.until_s.min(ended_s), ..injected }).collect()
    }

    fn one(&self, index: usize, truth: &Truth) -> Option<Injected> {
        let (kind, times) = (&self.faults[index].kind, self.times[index]);
        let log_terms = kind.log_terms();
        let began_s = times.from_s.filter(|_| times.could_stop && !log_terms.is_empty())?;
        let known_s = self.known_s(index, began_s)?;
        // An arm that another cause has stopped is not stopped again: a reset reports the conditions that remain.
        // What latched at the time of the fault may be the fault itself; during a late control step the record of a fault begins
        // before that of an earlier latch.
        let stopped_before_s = if known_s > began_s { known_s + NEAR_S } else { began_s - NEAR_S };
        let was_stopped = latched(truth, known_s, stopped_before_s);
        let until_s = if was_stopped || self.is_one_of_several(index, known_s, truth) {
            let reports = |&reset_s: &f64| {
                reset_s > known_s && self.known_s(index, reset_s).is_some_and(|at_s| at_s <= reset_s + NEAR_S)
            };
            self.resets_s.iter().copied().find(reports)? + RESET_S
        } else {
            known_s
        };
        let until_s = self.written_s(known_s, until_s);
        if self.absent_s.is_some_and(|(from_s, to_s)| from_s <= until_s + WRITTEN_S && to_s >= known_s) {
            return None;
        }
        // A latched fault is reported at once, however long its cause lasts.
        let name = self.faults[index].name().to_owned();
        Some(Injected { name, from_s: known_s, until_s, had_effect: true, log_terms })
    }

    /// The log is written as soon as the recorder goes on: this time, or the end of a stall in between.
    fn written_s(&self, from_s: f64, until_s: f64) -> f64 {
        let stalls = self.faults.iter().zip(self.times).filter(|(fault, _)| matches!(fault.kind, Kind::RecorderStalls));
        let late = stalls.filter(|(_, times)| times.overlaps(from_s, until_s + WRITTEN_S));
        late.filter_map(|(_, times)| times.until_s).fold(until_s, f64::max)
    }

    /// The earliest time at which the fault can be detected, from this time on: while a controller has no power, or its
    /// replies are lost, its switches and alarms cannot be read. None if the fault had ended by then.
    fn known_s(&self, index: usize, from_s: f64) -> Option<f64> {
        let fault = &self.faults[index];
        let mut at_s = from_s;
        while fault.kind.is_read_by_controller()
            && let Some(until_s) = self.hidden_until_s(fault.kind.arm(), at_s)
        {
            at_s = until_s?;
        }
        let is_over = fault.kind.ends() && self.times[index].until_s.is_some_and(|own_s| own_s < at_s + KNOWN_S);
        (!is_over).then_some(at_s)
    }

    /// If the faults of an arm, or of both, cannot be detected at this time: until when; it may be for good.
    fn hidden_until_s(&self, arm: Option<usize>, at_s: f64) -> Option<Option<f64>> {
        let hides = |of: usize| {
            self.faults.iter().zip(self.times).find_map(|(other, times)| {
                let is_hidden = other.kind.hides() == Some(of) && times.overlaps(at_s, at_s + KNOWN_S);
                is_hidden.then_some(times.until_s)
            })
        };
        match arm {
            Some(arm) => hides(arm),
            None => hides(0).and_then(|first| hides(1).map(|second| first.zip(second).map(|(a, b)| a.min(b)))),
        }
    }

    /// Whether another fault stopped the arms at the same time, and the log gives the reason of the stop.
    fn is_one_of_several(&self, index: usize, at_s: f64, truth: &Truth) -> bool {
        let others = self.faults.iter().zip(self.times).enumerate().filter(|(other, _)| *other != index);
        let is_there = others
            .filter(|(_, (other, _))| other.kind.may_stop())
            .any(|(_, (_, times))| times.overlaps(at_s - LATE_S, at_s + KNOWN_S));
        let is_logged = truth.log.iter().any(|line| {
            let t_s = line.t_millis as f64 * 1e-3;
            (at_s - NEAR_S..=at_s + KNOWN_S + STOPPED_S).contains(&t_s)
                && ARM_NAMES.iter().any(|name| line.text.contains(name))
        });
        is_there && is_logged
    }
}

/// Whether an arm was latched at this time, since a time before the other.
fn latched(truth: &Truth, at_s: f64, before_s: f64) -> bool {
    let step = truth.steps.iter().find(|step| step.t_s >= at_s).or(truth.steps.last());
    step.is_some_and(|step| step.arms.iter().any(|arm| arm.latched_since_s.is_some_and(|since_s| since_s <= before_s)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use system_tests::safety::rules::Rules;
    use system_tests::safety::truth::{ArmTruth, LogLine, Placement, Step};

    fn arm(arm: usize, name: &'static str, line: &str, end: Option<&str>) -> Fault {
        Fault::new(Kind::of_arm(arm, name, line, end), 0.0, 0.0)
    }

    fn switch() -> Fault {
        arm(0, "arm: limit switch", "limit-switch open", Some("limit-switch close"))
    }

    fn from_to(from_s: f64, until_s: f64) -> Happened {
        Happened { from_s: Some(from_s), until_s: Some(until_s), could_stop: true }
    }

    /// Ten seconds, latched from 2 s to 8 s, with this log line at the beginning of the latch.
    fn truth(line: &str) -> Truth {
        let step = |k: u32| {
            let t_s = f64::from(k) * 0.01;
            let latched_since_s = (2.01..8.0).contains(&t_s).then_some(2.01);
            let arm = ArmTruth { latched_since_s, ..ArmTruth::resting_at([0.0; 7]) };
            let world_from_target = Placement::IDENTITY;
            Step {
                t_s,
                arms: [arm; 2],
                world_from_target,
                pose_age_s: 0.0,
                may_search: false,
                is_inhibited: false,
                content_late_s: 0.0,
                resets: 0,
                state: "fault",
                says_why: true,
            }
        };
        let log = vec![LogLine { t_millis: 2010, text: line.to_owned() }];
        Truth { steps: (0..1000).map(step).collect(), log, injected: Vec::new() }
    }

    const OTHER_CAUSE: &str = "vs-robot: fault: the gateway stopped the arm";

    fn logged(faults: &[Fault], times: &[Happened], resets_s: &[f64]) -> Vec<(f64, f64)> {
        let found = Faults { faults, times, resets_s, absent_s: None }.to_be_logged(&truth(OTHER_CAUSE));
        found.iter().map(|injected| (injected.from_s, injected.until_s)).collect()
    }

    #[test]
    fn detectable_faults_are_reported_at_once() {
        assert_eq!(logged(&[switch()], &[from_to(2.0, 3.0)], &[5.0]), [(2.0, 2.0)]);
        let never = Happened::default();
        assert!(logged(&[switch()], &[never], &[]).is_empty());
        let late = Happened { could_stop: false, ..from_to(2.0, 3.0) };
        assert!(logged(&[switch()], &[late], &[]).is_empty());
    }

    #[test]
    fn the_log_has_the_time_of_the_rules() {
        assert_eq!(WRITTEN_S, Rules::of_the_rig().log_within_s);
    }

    #[test]
    fn a_process_that_has_died_tells_nothing() {
        let logged = |absent_s| {
            let (faults, times) = ([switch()], [from_to(2.0, 3.0)]);
            let faults = Faults { faults: &faults, times: &times, resets_s: &[], absent_s: Some(absent_s) };
            faults.to_be_logged(&truth(OTHER_CAUSE)).len()
        };
        assert_eq!((logged((2.5, f64::INFINITY)), logged((1.0, 2.5))), (0, 0));
        assert_eq!((logged((3.5, f64::INFINITY)), logged((0.5, 1.5))), (1, 1));
    }

    #[test]
    fn a_recorder_that_stands_still_writes_later() {
        let stalls = Fault::new(Kind::RecorderStalls, 0.0, 0.0);
        let until_s = logged(&[switch(), stalls], &[from_to(2.0, 3.0), from_to(2.5, 5.0)], &[])[0].1;
        assert_eq!(until_s, 5.0);
    }

    #[test]
    fn what_follows_within_a_late_control_step_stops_nothing_again() {
        // Latched since 2.01 s.
        assert_eq!(logged(&[switch()], &[from_to(2.01, 3.0)], &[]), [(2.01, 2.01)]);
        assert!(logged(&[switch()], &[from_to(2.02, 3.0)], &[]).is_empty());
        assert!(logged(&[switch()], &[from_to(2.02, 3.0)], &[5.0]).is_empty());
        assert_eq!(logged(&[switch()], &[from_to(2.02, 6.0)], &[5.0]), [(2.02, 5.6)]);
    }

    #[test]
    fn a_switch_of_a_controller_without_power_is_reported_at_the_reset() {
        let power = || arm(0, "arm: power", "power off", Some("power on"));
        let times = [from_to(2.0, 6.0), from_to(2.0, 4.0)];
        let faults = [switch(), power()];
        let switch_of = |logged: Vec<(f64, f64)>| logged[..logged.len() - 1].to_vec();
        // A reset reports the power, too: another fault was present at the same time.
        assert_eq!(switch_of(logged(&faults, &times, &[3.0, 5.0])), [(4.0, 5.6)]);
        // Not without power, and not after the switch has closed again.
        assert!(switch_of(logged(&faults, &times, &[3.0, 7.0])).is_empty());
        // The switch closed before the power came back: it could never be detected.
        let times = [from_to(2.0, 3.5), from_to(2.0, 4.0)];
        assert!(switch_of(logged(&faults, &times, &[3.0, 4.5])).is_empty());
        // The power of the other arm hides nothing.
        let other = arm(1, "arm: power", "power off", Some("power on"));
        assert_eq!(logged(&[switch(), other], &[from_to(1.0, 3.0), from_to(2.0, 4.0)], &[])[0], (1.0, 1.0));
    }

    #[test]
    fn of_two_simultaneous_stops_one_is_reported_at_once_and_the_other_at_the_reset() {
        let alarm = || arm(1, "arm: servo alarm", "alarm 6 0x05", None);
        let clock = || arm(0, "line: clock of the gateway", "line gateway-clock -0.6s", None);
        let times = [from_to(2.0, 2.1), from_to(2.0, 3.0)];
        // An alarm stays until it is reset, however long the fault was to last.
        assert_eq!(logged(&[alarm(), clock()], &times, &[5.0]), [(2.0, 5.6)]);
        assert!(logged(&[alarm(), clock()], &times, &[]).is_empty());
        // A fault that cannot stop an arm excuses nothing, nor one that ended long ago, nor an arm without a report.
        let blind = Fault::new(Kind::NoPose, 0.0, 0.0);
        assert_eq!(logged(&[alarm(), blind], &times, &[5.0]), [(2.0, 2.0)]);
        assert_eq!(logged(&[alarm(), clock()], &[times[0], from_to(1.0, 1.8)], &[5.0]), [(2.0, 2.0)]);
        let (faults, silent) = ([alarm(), clock()], truth("fault-found fault"));
        let found = Faults { faults: &faults, times: &times, resets_s: &[5.0], absent_s: None }.to_be_logged(&silent);
        assert_eq!((found[0].from_s, found[0].until_s), (2.0, 2.0));
    }
}
