//! Supervisor decisions of a run: share of time in each state, findings and state changes.

use std::collections::BTreeMap;

use pb3dp_record::report::Table;
use pb3dp_servo::supervisor::{Condition, Decision, State};
use serde::Serialize;

/// Time in which a target is initialised, seconds: until then a hand that has not followed yet does not count as one that should.
const INITIALISING_S: f64 = 1.0;

/// Number of transitions shown in the report; `summary.json` has all.
const SHOWN: usize = 40;

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
}

impl SupervisionLog {
    /// Records a step; returns the state change, if there is one.
    pub fn note(&mut self, t_s: f64, decision: &Decision) -> Option<&TransitionNote> {
        self.steps_by_state[decision.state as usize] += 1;
        if t_s < INITIALISING_S && self.steps_following() == 0 {
            self.steps_initialising += 1;
        }
        for condition in decision.found.iter() {
            self.steps_found[condition as usize] += 1;
        }
        let transition = decision.transition?;
        self.transitions.push(TransitionNote {
            t_s,
            from: transition.from.name(),
            to: transition.to.name(),
            event: transition.event.name(),
            why: decision.why.to_string(),
        });
        self.transitions.last()
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

impl Supervision {
    /// Shares and findings as terminal lines.
    pub fn text_lines(&self) -> String {
        let shares: Vec<String> =
            self.share_by_state.iter().map(|(state, share)| format!("{state} {:.0} %", 100.0 * share)).collect();
        let found: Vec<String> = self.steps_found.iter().map(|(key, steps)| format!("{key} {steps}")).collect();
        let found = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
        format!("{:<34} {}\n{:<34} {found}\n", "supervisor", shares.join(", "), "findings, steps")
    }

    /// Shares and findings as a report paragraph.
    pub fn paragraph(&self) -> String {
        let shares: Vec<String> =
            self.share_by_state.iter().map(|(state, share)| format!("{state} {:.1} %", 100.0 * share)).collect();
        let found: Vec<String> = self.steps_found.iter().map(|(key, steps)| format!("{key} in {steps}")).collect();
        let found = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
        format!("Share of the time in each state: {}. Findings, in control steps: {found}.", shares.join(", "))
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
    fn the_time_of_initialising_is_no_time_without_following() {
        assert_eq!(share(2.0, |t_s| t_s >= 0.305), 1.0);
        assert_eq!(share(2.0, |t_s| (0.305..1.0).contains(&t_s)), 69.0 / 169.0);
        // Only the first second is for initialising.
        assert_eq!(share(2.0, |t_s| t_s >= 1.5), 0.5);
        assert_eq!(share(0.5, |_| false), 0.0);
    }
}
