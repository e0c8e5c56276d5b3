//! An operator at the panel: resumes where possible, and at times gives another command, too late, or none at all.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_cell::operator::{ByCommand, Operator};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest, State};

use crate::faults::Kind;
use crate::program_log::ProgramLog;
use crate::recorder::{Shared, lock};
use crate::scenario::{Dice, PROOF, Scenario};

/// Reaction time of the operator, seconds.
const THINKS_S: (f64, f64) = (0.1, 1.0);

/// Gives the next useful command after a while, and the commands of the scenario.
pub struct Speaker {
    scenario: Scenario,
    clock: Arc<dyn Clock>,
    recorder: Shared,
    log: ProgramLog,
    dice: Dice,
    /// Which commands of the scenario were given.
    request: Vec<bool>,
    /// State for which the next command is meant, and its time.
    next: Option<(State, MonotonicTime)>,
    heartbeat_at: Option<MonotonicTime>,
    /// The command of this step is a reset.
    resets: bool,
}

impl Speaker {
    /// The operator of this scenario.
    pub fn new(scenario: &Scenario, clock: Arc<dyn Clock>, (recorder, log): (Shared, ProgramLog)) -> Self {
        let from_s = lock(&recorder).t_s(clock.now());
        Self {
            log,
            // A new host gets no command that was given to the one before.
            request: scenario.faults.iter().map(|fault| fault.from_s < from_s).collect(),
            dice: Dice::new(scenario.seed ^ 0x5eed),
            scenario: scenario.clone(),
            clock,
            recorder,
            next: None,
            heartbeat_at: None,
            resets: false,
        }
    }

    /// A command of the scenario that is due, and how long ago it was given, seconds.
    fn of_scenario(&mut self, t_s: f64) -> Option<(OperatorCommand, f64)> {
        for (index, (fault, request)) in self.scenario.faults.iter().zip(&mut self.request).enumerate() {
            if let (Kind::OperatorCommand(command, late_s), false) = (&fault.kind, *request)
                && t_s >= fault.from_s
            {
                *request = true;
                lock(&self.recorder).touched(index);
                return Some((*command, *late_s));
            }
        }
        None
    }

    /// A command of a client that sends them in any order, while it does.
    fn of_chatter(&mut self, t_s: f64) -> Option<(OperatorCommand, f64)> {
        /// Share of the control steps with a command.
        const SHARE: f64 = 0.2;
        for (index, fault) in self.scenario.faults.iter().enumerate().filter(|(_, fault)| fault.is_on(t_s)) {
            if let Kind::Chatter(late_s) = fault.kind
                && self.dice.unit() < SHARE
            {
                lock(&self.recorder).touched(index);
                return Some((self.dice.pick(&OperatorCommand::ALL), self.dice.within(0.0, late_s)));
            }
        }
        None
    }

    /// The command that leads on from this state.
    fn leads_on(last: &Decision) -> Option<OperatorCommand> {
        match last.state {
            State::Idle => Some(OperatorCommand::Select),
            State::Selecting => last.is_ready.then_some(OperatorCommand::Start),
            State::Holding | State::Lost => last.is_ready.then_some(OperatorCommand::Resume),
            State::Stopped | State::Fault => Some(OperatorCommand::Reset),
            State::Approaching | State::Tracking => None,
        }
    }

    /// The same command, after the reaction time.
    fn by_itself(&mut self, last: Option<&Decision>, at: MonotonicTime) -> Option<OperatorCommand> {
        let Some(last) = last else { return Some(OperatorCommand::Select) };
        let command = Self::leads_on(last)?;
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
        Some(command)
    }
}

impl Operator for Speaker {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let at = self.clock.now();
        let t_s = lock(&self.recorder).t_s(at);
        let is_silent =
            self.scenario.faults.iter().any(|fault| matches!(fault.kind, Kind::Silence) && fault.is_on(t_s));
        if is_silent {
            return OperatorInput { heartbeat_at: self.heartbeat_at, ..OperatorInput::default() };
        }
        self.heartbeat_at = Some(now);
        let given = self.of_scenario(t_s).or_else(|| self.of_chatter(t_s));
        let command = given.or_else(|| self.by_itself(last, at).map(|command| (command, 0.0)));
        self.resets = command.is_some_and(|(command, _)| command == OperatorCommand::Reset);
        let mut recorder = lock(&self.recorder);
        recorder.heartbeat(now);
        let request = command.map(|(command, late_s)| {
            let late = Duration::from_secs_f64(late_s);
            recorder.commanded(command, now - late, at);
            OperatorRequest { command, at: now - late }
        });
        OperatorInput { request, heartbeat_at: self.heartbeat_at, silent_after: None }
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, trouble: Option<String>) {
        let Some(trouble) = trouble else { return };
        if self.resets {
            lock(&self.recorder).reset_failed();
        }
        // A refused command: the driver brakes the arm from this step on.
        if trouble.contains("the arm holds") {
            lock(&self.recorder).holds(self.clock.now());
        }
        self.log.push(trouble);
    }

    fn is_person(&self) -> bool {
        true
    }

    fn can_fall_silent(&self) -> bool {
        true
    }
}

/// The operator of a run without a person: the program itself.
pub struct Overheard {
    /// No `start` is given before, seconds: with disabled safeguards the supervisor would accept it before there are poses.
    starts_at_s: f64,
    clock: Arc<dyn Clock>,
    recorder: Shared,
}

impl Overheard {
    /// The same commands as [`ByCommand`], recorded.
    pub fn new(scenario: &Scenario, clock: Arc<dyn Clock>, recorder: Shared) -> Self {
        Self { starts_at_s: if scenario.motion_name == PROOF { 0.8 } else { 0.0 }, clock, recorder }
    }
}

impl Operator for Overheard {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let mut input = ByCommand.listen(last, now);
        let mut recorder = lock(&self.recorder);
        let is_early = recorder.t_s(self.clock.now()) < self.starts_at_s;
        input.request = input.request.filter(|request| request.command != OperatorCommand::Start || !is_early);
        recorder.heartbeat(now);
        if let Some(request) = input.request {
            recorder.commanded(request.command, request.at, self.clock.now());
        }
        input
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, _trouble: Option<String>) {}

    fn is_person(&self) -> bool {
        ByCommand.is_person()
    }

    fn can_fall_silent(&self) -> bool {
        ByCommand.can_fall_silent()
    }
}
