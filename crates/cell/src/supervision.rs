//! Supervisor decisions of a run: share of time in each state, findings and state changes.

use std::collections::BTreeMap;

use pb3dp_record::report::Table;
use pb3dp_servo::supervisor::{Condition, Decision, Event, State, Why};
use serde::Serialize;

/// Time in which a target is initialised, seconds: until then a hand that has not followed yet does not count as one that should.
const INITIALISING_S: f64 = 1.0;

/// Number of transitions shown in the report; `summary.json` has all.
const SHOWN: usize = 40;

/// Time for which a cause must stay away before the log calls it gone, seconds: an intermittent one would fill the log.
const GONE_FOR_S: f64 = 0.5;

/// Supervisor decisions of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Supervision {
    /// Share of the control steps in each state, 0 to 1.
    pub share_by_state: BTreeMap<&'static str, f64>,
    /// Number of steps with each condition that was found at least once.
    pub steps_found: BTreeMap<&'static str, u64>,
    /// Changes of state.
    pub transitions: Vec<TransitionNote>,
    /// Share of the steps in which the hand followed or approached, 0 to 1; the first second counts from the first such step on.
    #[serde(skip)]
    pub share_following: f64,
}

/// A change of state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TransitionNote {
    /// Time since the start of the experiment, seconds.
    pub t_s: f64,
    /// Previous state.
    pub from: &'static str,
    /// New state.
    pub to: &'static str,
    /// Event that caused the change.
    pub event: &'static str,
    /// Reason given by the supervisor.
    pub why: String,
}

/// Record of the supervisor over the control steps.
#[derive(Clone, Debug, Default)]
pub struct SupervisionLog {
    steps_by_state: [u64; State::ALL.len()],
    steps_found: [u64; Condition::COUNT],
    transitions: Vec<TransitionNote>,
    steps_initialising: u64,
    gone: GoneCause,
    /// Nobody can give the run commands.
    without_console: bool,
}

/// Finds out when the cause of a stop or a hold has gone.
#[derive(Clone, Copy, Debug, Default)]
struct GoneCause {
    since_s: Option<f64>,
    is_reported: bool,
}

impl GoneCause {
    /// The log line of this step, once for each time that a cause goes.
    fn note(&mut self, t_s: f64, decision: &Decision, text_of: impl Fn(&Why) -> String) -> Option<String> {
        let why = decision.why;
        match decision.transition.map(|transition| transition.event) {
            Some(Event::CauseGone) => return Some(format!("the cause of the hold is gone: {}", text_of(&why))),
            Some(Event::TargetFound) => return Some(format!("the target is found again: {}", text_of(&why))),
            Some(Event::Reset) => return Some(format!("the stop is reset: {}", text_of(&why))),
            _ => {}
        }
        if !matches!(why, Why::CauseGone { .. } | Why::Latched { is_gone: true, .. }) {
            *self = Self::default();
            return None;
        }
        let since_s = *self.since_s.get_or_insert(t_s);
        let is_due = !self.is_reported && t_s - since_s >= GONE_FOR_S;
        self.is_reported |= is_due;
        is_due.then(|| text_of(&why))
    }
}

impl SupervisionLog {
    /// Names no commands from now on: nobody can give the run any.
    pub fn leave_out_commands(&mut self) {
        self.without_console = true;
    }

    /// The line of a reason.
    pub fn text_of(&self, why: &Why) -> String {
        text_of(why, self.without_console)
    }

    /// The log line of a step in which the cause of a stop or a hold has gone.
    pub fn gone(&mut self, t_s: f64, decision: &Decision) -> Option<String> {
        let without_console = self.without_console;
        self.gone.note(t_s, decision, |why| text_of(why, without_console))
    }

    /// Records a step; returns the state change, if there is one.
    pub fn note(&mut self, t_s: f64, decision: &Decision) -> Option<&TransitionNote> {
        self.note_state(t_s, decision.state);
        for condition in decision.found.iter() {
            self.steps_found[condition as usize] += 1;
        }
        let transition = decision.transition?;
        self.note_change(TransitionNote {
            t_s,
            from: transition.from.name(),
            to: transition.to.name(),
            event: transition.event.name(),
            why: self.text_of(&decision.why),
        });
        self.transitions.last()
    }

    /// Records the state in a step.
    pub fn note_state(&mut self, t_s: f64, state: State) {
        self.steps_by_state[state as usize] += 1;
        if t_s < INITIALISING_S && self.steps_following() == 0 {
            self.steps_initialising += 1;
        }
    }

    /// Records a change of state.
    pub fn note_change(&mut self, change: TransitionNote) {
        self.transitions.push(change);
    }

    fn steps_following(&self) -> u64 {
        State::ALL.into_iter().filter(|state| state.is_moving()).map(|state| self.steps_by_state[state as usize]).sum()
    }

    /// The figures.
    pub fn summary(&self) -> Supervision {
        let steps: u64 = self.steps_by_state.iter().sum();
        let share = |state: State| self.steps_by_state[state as usize] as f64 / steps as f64;
        let visited = State::ALL.into_iter().filter(|state| self.steps_by_state[*state as usize] > 0);
        let found = Condition::ALL.into_iter().filter(|condition| self.steps_found[*condition as usize] > 0);
        Supervision {
            share_by_state: visited.map(|state| (state.name(), share(state))).collect(),
            steps_found: found.map(|condition| (condition.key(), self.steps_found[condition as usize])).collect(),
            transitions: self.transitions.clone(),
            share_following: self.steps_following() as f64 / (steps - self.steps_initialising).max(1) as f64,
        }
    }
}

fn text_of(why: &Why, without_console: bool) -> String {
    if without_console { why.without_console().to_string() } else { why.to_string() }
}

impl Supervision {
    /// Shares and findings as terminal lines.
    pub fn text_lines(&self) -> String {
        let shares: Vec<String> =
            self.share_by_state.iter().map(|(state, share)| format!("{state} {:.0} %", 100.0 * share)).collect();
        let found: Vec<String> = self.steps_found.iter().map(|(key, steps)| format!("{key} {steps}")).collect();
        let found = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
        format!("{:<34} {}\n{:<34} {found}\n", "supervisor", shares.join(", "), "findings in motion or hold, steps")
    }

    /// Shares and findings as a report paragraph.
    pub fn paragraph(&self) -> String {
        let shares: Vec<String> =
            self.share_by_state.iter().map(|(state, share)| format!("{state} {:.1} %", 100.0 * share)).collect();
        let found: Vec<String> = self.steps_found.iter().map(|(key, steps)| format!("{key} in {steps}")).collect();
        let found = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
        format!(
            "Share of the time in each state: {}. Findings in motion or hold, in control steps: {found}.",
            shares.join(", ")
        )
    }

    /// The state changes as a report table.
    pub fn transition_table(&self) -> Table {
        let headings = Table::new(["time, s", "event", "from", "state, reason and action"]);
        let shown = self.transitions.iter().take(SHOWN).fold(headings, |table, note| {
            table.row([format!("{:.2}", note.t_s), note.event.to_owned(), note.from.to_owned(), note.why.clone()])
        });
        match self.transitions.len().saturating_sub(SHOWN) {
            0 => shown,
            more => shown.row([format!("and {more} more"), String::new(), String::new(), String::new()]),
        }
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_servo::supervisor::{Cause, Detail, Then};

    use super::*;
    use crate::console::tests::decision;

    /// Share of the steps of 10 ms in which the hand followed: `follows` from this time on.
    fn share(duration_s: f64, follows: impl Fn(f64) -> bool) -> f64 {
        let (mut log, resting) = (SupervisionLog::default(), decision());
        for step in 0..(duration_s * 100.0) as u64 {
            let t_s = step as f64 / 100.0;
            let state = if follows(t_s) { State::Tracking } else { State::Selecting };
            log.note(t_s, &Decision { state, transition: None, ..resting });
        }
        log.summary().share_following
    }

    #[test]
    fn a_cause_that_stays_away_is_reported_once_and_an_intermittent_one_is_not() {
        let cause = Cause { condition: Condition::FrameStale, value: 2.0, threshold: 0.5, detail: Detail::None };
        let active = Why::Latched { state: State::Stopped, cause, is_gone: false };
        let gone = Why::Latched { state: State::Stopped, cause, is_gone: true };
        let (mut log, resting) = (SupervisionLog::default(), decision());
        let mut lines_of = |steps: std::ops::Range<u32>, why: &dyn Fn(u32) -> Why| -> Vec<String> {
            let step = |step: u32| {
                log.gone(f64::from(step) / 100.0, &Decision { why: why(step), transition: None, ..resting })
            };
            steps.filter_map(step).collect()
        };
        assert!(lines_of(0..100, &|_| active).is_empty());
        assert!(lines_of(100..500, &|step| if step % 10 == 0 { active } else { gone }).is_empty());
        assert_eq!(
            lines_of(500..900, &|_| gone),
            ["stopped: cleared: the newest frame pair is 2.000 s old, limit 0.500 s; use reset [PB3DP-SUP-008]"]
        );
        assert!(lines_of(900..910, &|_| active).is_empty());
        let held = Why::CauseGone { state: State::Holding, cause, then: Then::Resume };
        let lines = lines_of(910..1000, &|_| held);
        assert!(lines.len() == 1 && lines[0].ends_with("; use resume"), "{lines:?}");
        let mut log = SupervisionLog::default();
        log.leave_out_commands();
        let mut lines = (0..100)
            .filter_map(|step| log.gone(f64::from(step) / 100.0, &Decision { why: held, transition: None, ..resting }));
        assert!(lines.next().is_some_and(|lines| lines.ends_with("; start a new run")) && lines.next().is_none());
    }

    #[test]
    fn initialisation_does_not_count_as_lost() {
        assert_eq!(share(2.0, |t_s| t_s >= 0.305), 1.0);
        assert_eq!(share(2.0, |t_s| (0.305..1.0).contains(&t_s)), 69.0 / 169.0);
        // Only the first second is for initialising.
        assert_eq!(share(2.0, |t_s| t_s >= 1.5), 0.5);
        assert_eq!(share(0.5, |_| false), 0.0);
    }
}
