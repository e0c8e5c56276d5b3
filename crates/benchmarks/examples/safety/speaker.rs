//! A person at the panel: who goes on where that is possible, and at times says something else, too late, or nothing at all.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_cell::operator::Operator;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest, State};

use crate::faults::Kind;
use crate::recorder::{Shared, lock};
use crate::scenario::{Dice, Scenario};

/// How long this person thinks, seconds.
const THINKS_S: (f64, f64) = (0.1, 1.0);

/// Says the next word that leads on, after a while, and what the scenario has.
pub struct Speaker {
    scenario: Scenario,
    clock: Arc<dyn Clock>,
    recorder: Shared,
    dice: Dice,
    /// Which words of the scenario were said.
    said: Vec<bool>,
    /// For which state the next word is thought of, and when it comes.
    next: Option<(State, MonotonicTime)>,
    heard_at: Option<MonotonicTime>,
}

impl Speaker {
    /// The person of this scenario.
    pub fn new(scenario: &Scenario, clock: Arc<dyn Clock>, recorder: Shared) -> Self {
        Self {
            said: vec![false; scenario.faults.len()],
            dice: Dice::new(scenario.seed ^ 0x5eed),
            scenario: scenario.clone(),
            clock,
            recorder,
            next: None,
            heard_at: None,
        }
    }

    /// A word of the scenario that is due, and how long ago it was said, seconds.
    fn of_scenario(&mut self, t_s: f64) -> Option<(OperatorCommand, f64)> {
        for (index, (fault, said)) in self.scenario.faults.iter().zip(&mut self.said).enumerate() {
            if let (Kind::OperatorCommand(word, late_s), false) = (&fault.kind, *said)
                && t_s >= fault.from_s
            {
                *said = true;
                lock(&self.recorder).touched(index);
                return Some((*word, *late_s));
            }
        }
        None
    }

    /// What leads on from there.
    fn leads_on(last: &Decision) -> Option<OperatorCommand> {
        match last.state {
            State::Idle => Some(OperatorCommand::Select),
            State::Selecting => last.is_ready.then_some(OperatorCommand::Start),
            State::Holding | State::Lost => last.is_ready.then_some(OperatorCommand::Resume),
            State::Stopped | State::Fault => Some(OperatorCommand::Reset),
            State::Approaching | State::Tracking => None,
        }
    }

    /// The same, once this person has thought about it.
    fn by_itself(&mut self, last: Option<&Decision>, at: MonotonicTime) -> Option<OperatorCommand> {
        let Some(last) = last else { return Some(OperatorCommand::Select) };
        let word = Self::leads_on(last)?;
        let due = match self.next {
            Some((state, due)) if state == last.state => due,
            _ => {
                let thinks_s = self.dice.within(THINKS_S.0, THINKS_S.1);
                let due = at + Duration::from_secs_f64(thinks_s);
                self.next = Some((last.state, due));
                due
            }
        };
        if at < due {
            return None;
        }
        self.next = None;
        Some(word)
    }
}

impl Operator for Speaker {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let at = self.clock.now();
        let t_s = lock(&self.recorder).t_s(at);
        let is_silent =
            self.scenario.faults.iter().any(|fault| matches!(fault.kind, Kind::Silence) && fault.is_on(t_s));
        if is_silent {
            return OperatorInput { said: None, heard_at: self.heard_at };
        }
        self.heard_at = Some(now);
        let word = self.of_scenario(t_s).or_else(|| self.by_itself(last, at).map(|word| (word, 0.0)));
        let mut recorder = lock(&self.recorder);
        recorder.heard(at);
        let said = word.map(|(word, late_s)| {
            let late = Duration::from_secs_f64(late_s);
            recorder.told(word, at - late, at);
            OperatorRequest { word, at: now - late }
        });
        OperatorInput { said, heard_at: self.heard_at }
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, trouble: Option<String>) {
        if let Some(trouble) = trouble {
            lock(&self.recorder).say(self.clock.now(), format!("to the operator: {trouble}"));
        }
    }

    fn is_person(&self) -> bool {
        true
    }
}
