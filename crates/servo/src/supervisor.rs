//! The supervisor: decides whether the arm may move, and if not, states the reason and the remedy.
//!
//! The supervisor is between the controller and the arm. In each step [`Supervisor::step`] checks all measurements ([`Inputs`])
//! against its [`Policies`], takes the operator's command, and returns a [`Decision`]. Its only memory is the state of the
//! [`table`](mod@table) and timers. Only the operator's reset leaves a latched state, and it leads to [`State::Idle`].
//!
//! Motion always starts from new measurements: at each hold, stop, fault, reset and selection, [`Decision::rearm`] makes the
//! controller drop its set-points, and motion is inhibited until new ones exist. Only a hold for a part that stood still for a moment
//! keeps the target, while its predicted pose is certain enough.

mod codes;
mod findings;
mod inputs;
mod log;
mod policy;
mod stall;
pub mod table;
mod wording;

use pb3dp_geometry::MonotonicTime;

pub use self::findings::{Cause, Detail};
pub use self::inputs::{
    ARM_NAMES, ArmCondition, ArmInput, Confidence, EstimateInput, FrameInput, Innovation, Inputs, OperatorCommand,
    OperatorInput, OperatorRequest, RangeEnd,
};
pub use self::log::{TRANSITIONS_KEPT, Transition, TransitionLog};
pub use self::policy::{
    Action, Condition, ConditionSet, Policies, Policy, Resume, Rule, SupervisorConfig, SupervisorError, ThresholdRule,
};
pub use self::table::{Event, Order, Outcome, State};
pub use self::wording::{Refusal, RefusedFor, Then, Why};

use self::findings::Findings;
use self::stall::{Stalls, is_only_stalled};
use self::table::outcome;
use crate::controller::Mode;

/// What the arm may do until the next step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Permission {
    /// Move as the controller commands, with this share of the velocity, above 0 to 1.
    Move {
        /// The share.
        share: f64,
    },
    /// Decelerate and hold, with open brakes.
    Hold,
    /// Both arms are stopped and latched.
    Stop,
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Permission for the arm.
    pub permission: Permission,
    /// State of the supervisor.
    pub state: State,
    /// One line: why the arm does not move, and the remedy.
    pub why: Why,
    /// The controller must drop its set-points and its target ([`crate::Controller::acquire`]).
    pub rearm: bool,
    /// The controller may search for the lost target ([`crate::Controller::permit_search`]).
    pub search: bool,
    /// Conditions that have been active for the `for_s` of their policy, during motion or a hold.
    pub found: ConditionSet,
    /// No arm may move, including the one that carries the target: the state is latched, the operator holds both arms, or joints,
    /// drives, clock or operator inhibit motion in any state.
    pub no_arm_may_move: bool,
    /// Whether `start` (after a hold `resume`) would be accepted now.
    pub is_ready: bool,
    /// The change of state in this step.
    pub transition: Option<Transition>,
    /// The command that was refused in this step.
    pub refused: Option<Refusal>,
}

/// Share of the velocity while images seem to be late, until the hold. Chosen: a loop with a third of its gain bears three times the delay.
const LATE_IMAGES_SHARE: f64 = 0.3;

/// Supervisor of both arms.
#[derive(Clone, Debug)]
pub struct Supervisor {
    config: SupervisorConfig,
    state: State,
    /// Time at which the state was entered.
    entered_at: Option<MonotonicTime>,
    /// Time at which the state was entered, or at which the operator ended motion last, also where the state did not change by that;
    /// older commands refer to something else.
    commands_since: Option<MonotonicTime>,
    findings: Findings,
    /// Condition that led to the state; `None` if a command did.
    cause: Option<Cause>,
    /// Time since which no condition inhibits motion.
    clear_since: Option<MonotonicTime>,
    /// The last condition that inhibited motion since the target was selected.
    last_inhibit: Option<Cause>,
    /// The operator has commanded a hold since the last motion.
    held_by_operator: bool,
    /// The arm that carries the target also waits for `start` or `resume`: the operator has commanded `hold`, or a condition that holds
    /// every arm needs the operator.
    holds_every_arm: bool,
    /// A condition since the last motion needs the operator's `resume`.
    needs_operator: bool,
    /// The same, for conditions that a lost target does not cause.
    needs_operator_beyond_loss: bool,
    /// State of the search for the target since the last motion.
    search: SearchRight,
    stalls: Stalls,
    log: TransitionLog,
}

impl Supervisor {
    /// A supervisor in [`State::Idle`].
    ///
    /// # Errors
    /// The first setting that is out of range, or weaker than its condition allows.
    pub fn new(config: SupervisorConfig) -> Result<Self, SupervisorError> {
        config.validate()?;
        Ok(Self {
            config,
            state: State::Idle,
            entered_at: None,
            commands_since: None,
            findings: Findings::new(),
            cause: None,
            clear_since: None,
            last_inhibit: None,
            held_by_operator: false,
            holds_every_arm: false,
            needs_operator: false,
            needs_operator_beyond_loss: false,
            search: SearchRight::Unused,
            stalls: Stalls::default(),
            log: TransitionLog::new(),
        })
    }

    /// The last transitions.
    pub fn log(&self) -> &TransitionLog {
        &self.log
    }

    /// One control cycle: never blocks, never allocates. The state changes at most once per step.
    ///
    /// Detected conditions take precedence over operator commands, except `stop`, `hold` and `hold hand`, which are always obeyed. `start` and
    /// `resume` are refused while a condition inhibits motion, even before its `for_s` has passed, and until it has been inactive
    /// for [`SupervisorConfig::go_after_s`]. `reset` is refused while an arm reports a fault or an emergency stop. Every command is
    /// refused if it is too old or older than the state.
    pub fn step(&mut self, inputs: &Inputs, now: MonotonicTime) -> Decision {
        self.findings.look(inputs, &self.config.policies, now);
        // After the clock stepped back, new commands must not be refused as older than the state.
        self.entered_at = self.entered_at.map(|entered| entered.min(now));
        self.commands_since = self.commands_since.map(|since| since.min(now));
        let blocking = self.findings.first_at_least(&self.config.policies, Action::Hold);
        self.clear_since = match (blocking, self.clear_since) {
            (None, Some(since)) if since <= now => Some(since),
            (None, _) => Some(now),
            (Some(_), _) => None,
        };
        self.last_inhibit = blocking.or(self.last_inhibit);
        let request = inputs.operator.request;
        let command = request.map(|request| (request.command, self.refusal(request, blocking, now)));
        let transition = self.change(inputs, command, now);
        if matches!(transition, Some((Event::Hold, _))) {
            // Conditions from before did not cause this hold.
            self.last_inhibit = blocking;
        }
        let rearm = transition.is_some_and(|(_, order)| order != Order::None);
        let mut blocking = blocking;
        if rearm {
            self.findings.rearm();
            self.clear_since = None;
            if self.state == State::Selecting {
                // Measurements of another target, or from before this selection, do not count.
                self.findings.look(inputs, &self.config.policies, now);
                blocking = self.findings.first_at_least(&self.config.policies, Action::Hold);
            }
        }
        let found = self.note(now);
        let search = self.permits_search(now);
        let refused =
            command.and_then(|(command, refused)| self.refused(command, refused, transition.map(|(event, _)| event)));
        Decision {
            permission: self.permission(inputs, search, now),
            state: self.state,
            why: if search && inputs.controller == Mode::Searching { Why::Searching } else { self.why(blocking, now) },
            rearm,
            search,
            found,
            no_arm_may_move: self.state.is_latched() || self.holds_every_arm || self.inhibits_every_arm(now),
            is_ready: self.is_clear() && !rearm && (self.state == State::Selecting || self.state.is_resting()),
            transition: transition.and_then(|_| self.log.newest()),
            refused,
        }
    }

    /// The most severe active condition (of several the first), with its event.
    fn alarm(&self, now: MonotonicTime) -> Option<(Event, Cause)> {
        let follows = self.state.is_moving() || self.state.is_resting();
        let counts = |condition: Condition| follows || condition.rule().counts_always;
        let mut worst: Option<(Cause, Action)> = None;
        let mut is_lost = false;
        for (cause, action) in self.findings.lasting(&self.config.policies, now) {
            if !counts(cause.condition) || !action.is_rest() {
                continue;
            }
            is_lost |= cause.condition == Condition::TargetLost;
            if worst.is_none_or(|(_, so_far)| action > so_far) {
                worst = Some((cause, action));
            }
        }
        let (cause, action) = worst?;
        let event = match action {
            Action::Fault => Event::FaultFound,
            Action::Stop => Event::StopFound,
            _ if is_lost => Event::LossFound,
            _ => Event::HoldFound,
        };
        Some((event, cause))
    }

    /// The first event, by severity, that leads to another state.
    fn change(
        &mut self,
        inputs: &Inputs,
        command: Option<(OperatorCommand, Option<RefusedFor>)>,
        now: MonotonicTime,
    ) -> Option<(Event, Order)> {
        let alarm = self.alarm(now);
        let of_alarm =
            |wanted: Event| alarm.filter(|(event, _)| *event == wanted).map(|(event, cause)| (event, Some(cause)));
        let obeyed = command.filter(|(_, refused)| refused.is_none()).map(|(command, _)| command);
        let commanded = |wanted: OperatorCommand| (obeyed == Some(wanted)).then_some((event_of(wanted), None));
        if matches!(obeyed, Some(OperatorCommand::Hold | OperatorCommand::HoldHand)) {
            self.held_by_operator = true;
            self.holds_every_arm |= obeyed == Some(OperatorCommand::Hold);
        }
        if obeyed.is_some_and(OperatorCommand::ends_motion) {
            self.commands_since = Some(now);
        }
        let candidates = [
            of_alarm(Event::FaultFound),
            commanded(OperatorCommand::Stop),
            of_alarm(Event::StopFound),
            commanded(OperatorCommand::Hold),
            commanded(OperatorCommand::HoldHand),
            of_alarm(Event::LossFound),
            self.stall(inputs, alarm, now),
            of_alarm(Event::HoldFound),
            commanded(OperatorCommand::Select),
            commanded(OperatorCommand::Start),
            commanded(OperatorCommand::Resume),
            commanded(OperatorCommand::Realign),
            commanded(OperatorCommand::Reset),
            self.by_itself(inputs).map(|event| (event, None)),
        ];
        for (event, cause) in candidates.into_iter().flatten() {
            if let Outcome::To(to, order) = outcome(self.state, event) {
                self.enter(Transition { at: now, from: self.state, to, event, cause });
                return Some((event, order));
            }
        }
        None
    }

    /// Time without an active inhibit, seconds, up to the newest confident estimate: nothing is known after it.
    fn clear_for_s(&self) -> f64 {
        let (Some(since), Some(until)) = (self.clear_since, self.findings.confirmed_at) else { return 0.0 };
        until.seconds_since(since).max(0.0)
    }

    /// Whether this time is long enough for a command: an intermittent cause must not count as gone between two images.
    fn is_clear(&self) -> bool {
        self.clear_since.is_some() && self.clear_for_s() >= self.config.go_after_s
    }

    /// Begin and end of a hold for a part that stands still for a moment.
    fn stall(
        &self,
        inputs: &Inputs,
        alarm: Option<(Event, Cause)>,
        now: MonotonicTime,
    ) -> Option<(Event, Option<Cause>)> {
        let is_stalled = !self.held_by_operator
            && !self.needs_operator
            && is_only_stalled(&self.findings, &self.config.policies, inputs);
        if self.stalls.since.is_none() {
            let (event, cause) = alarm?;
            let begins =
                event == Event::HoldFound && self.state.is_moving() && is_stalled && self.stalls.may_begin(now);
            return begins.then_some((Event::StallFound, Some(cause)));
        }
        if !is_stalled || !self.stalls.is_short(now) {
            return Some((Event::StallFailed, self.cause));
        }
        // Every part has worked since the step before.
        self.clear_since.is_some().then_some((Event::StallOver, None))
    }

    /// Automatic transitions.
    fn by_itself(&self, inputs: &Inputs) -> Option<Event> {
        let may_resume =
            !self.held_by_operator && !self.needs_operator && self.clear_for_s() >= self.config.resume_after_s;
        match (self.state, inputs.controller) {
            (State::Approaching, Mode::Tracking) => Some(Event::Reached),
            (State::Tracking, Mode::Approaching) => Some(Event::Left),
            (State::Holding, _) if may_resume => Some(Event::CauseGone),
            (State::Lost, _) if may_resume => Some(Event::TargetFound),
            _ => None,
        }
    }

    fn enter(&mut self, transition: Transition) {
        let Transition { at, to, event, cause, .. } = transition;
        if !to.is_resting() {
            self.held_by_operator = false;
            self.needs_operator = false;
            self.needs_operator_beyond_loss = false;
            self.search = SearchRight::Unused;
        }
        if matches!(event, Event::Start | Event::Resume) {
            self.holds_every_arm = false;
        }
        self.stalls.end(at);
        match event {
            Event::Select => {
                self.findings.begin(at);
                self.last_inhibit = None;
            }
            Event::Start => self.findings.start(),
            Event::StallFound => self.stalls.since = Some(at),
            _ => {}
        }
        self.state = to;
        (self.entered_at, self.commands_since) = (Some(at), Some(at));
        self.cause = cause;
        self.log.push(transition);
    }

    /// Whether a reset is passed on to the arms: the state is latched, and the command neither too old nor older than the state.
    /// A fault or an emergency stop of an arm does not prevent it.
    pub fn would_reset(&self, request: OperatorRequest, now: MonotonicTime) -> bool {
        request.command == OperatorCommand::Reset && self.state.is_latched() && self.untimely(request, now).is_none()
    }

    /// Returns the active conditions, and stores whether one of them needs the operator's `resume`.
    fn note(&mut self, now: MonotonicTime) -> ConditionSet {
        let mut found = ConditionSet::default();
        if !(self.state.is_moving() || self.state.is_resting()) {
            return found;
        }
        for (cause, action) in self.findings.lasting(&self.config.policies, now) {
            found.insert(cause.condition);
            let resume = self.config.policies.get(cause.condition).resume;
            let needs_operator = self.state.is_resting() && action.is_rest() && resume == Resume::ByOperator;
            self.needs_operator |= needs_operator;
            self.holds_every_arm |= needs_operator && cause.condition.rule().holds_every_arm;
            self.needs_operator_beyond_loss |= needs_operator && !comes_with_loss(cause.condition);
        }
        found
    }

    /// Whether a condition inhibits every arm now.
    fn inhibits_every_arm(&self, now: MonotonicTime) -> bool {
        self.findings.lasting(&self.config.policies, now).any(|(cause, _)| cause.condition.rule().holds_every_arm)
    }

    /// Reason to refuse a command, other than the table of states.
    fn refusal(&self, request: OperatorRequest, blocking: Option<Cause>, now: MonotonicTime) -> Option<RefusedFor> {
        if request.command.ends_motion() {
            return None;
        }
        if let Some(untimely) = self.untimely(request, now) {
            return Some(untimely);
        }
        let latched = [Condition::EmergencyStop, Condition::ArmFault].map(|condition| self.findings.cause(condition));
        match (request.command, self.state) {
            (OperatorCommand::Start, State::Selecting) | (OperatorCommand::Resume, State::Holding | State::Lost) => {
                blocking.map(RefusedFor::Cause).or_else(|| self.not_clear())
            }
            (OperatorCommand::Reset, State::Stopped | State::Fault) => {
                latched.into_iter().flatten().next().map(RefusedFor::Cause)
            }
            _ => None,
        }
    }

    /// Refusal because the cause has not been gone for long enough.
    fn not_clear(&self) -> Option<RefusedFor> {
        let (clear_s, wanted_s) = (self.clear_for_s(), self.config.go_after_s);
        (!self.is_clear()).then_some(RefusedFor::NotClear { cause: self.last_inhibit, clear_s, wanted_s })
    }

    /// Reason to refuse a command because of its time.
    fn untimely(&self, request: OperatorRequest, now: MonotonicTime) -> Option<RefusedFor> {
        let age_s = now.seconds_since(request.at);
        let age_max_s = self.config.word_age_max_s;
        if !(-age_max_s..=age_max_s).contains(&age_s) {
            return Some(RefusedFor::Age { age_s, age_max_s });
        }
        // After the clock stepped back, new commands must not be refused as older than the state.
        let is_before = self.commands_since.is_some_and(|since| request.at < since.min(now));
        if is_before {
            return Some(RefusedFor::OlderThanState(self.state));
        }
        // `start` refers to the target that was followed when the command was given.
        let followed_since = self.findings.followed_since().filter(|_| request.command == OperatorCommand::Start);
        let is_other = followed_since.is_some_and(|since| request.at < since.min(now));
        is_other.then_some(RefusedFor::OlderThanTarget)
    }

    /// Result of a command.
    fn refused(
        &self,
        command: OperatorCommand,
        refused: Option<RefusedFor>,
        happened: Option<Event>,
    ) -> Option<Refusal> {
        let own = event_of(command);
        let because = match (refused, happened) {
            (Some(because), _) => because,
            (None, Some(event)) if event == own => return None,
            // A fault fulfils `stop`, and every end of motion fulfils `hold`.
            (None, Some(_)) if command.ends_motion() => return None,
            (None, Some(_)) => RefusedFor::Overtaken(self.state),
            (None, None) if outcome(self.state, own) == Outcome::Refuse => RefusedFor::State(self.state),
            (None, None) => return None,
        };
        Some(Refusal { command, because })
    }

    /// Whether the hand may search for the target: the loss is younger than `search_max_s`, the operator has commanded no hold,
    /// only the loss needs a `resume`, and no condition is active except those that a loss causes.
    fn may_search(&self, now: MonotonicTime) -> bool {
        let since_s = self.entered_at.map_or(f64::INFINITY, |entered| now.seconds_since(entered));
        let of_loss = |cause: Cause| comes_with_loss(cause.condition);
        self.state == State::Lost
            && !self.held_by_operator
            && !self.needs_operator_beyond_loss
            && (0.0..self.config.search_max_s).contains(&since_s)
            && self.findings.all_at_least(&self.config.policies, Action::Slow(1.0)).all(of_loss)
    }

    /// The same, once per loss: an aborted search does not start again. No search starts after a clock step, because the time
    /// since the loss is unknown.
    fn permits_search(&mut self, now: MonotonicTime) -> bool {
        let has_stepped = self.state == State::Lost && self.findings.cause(Condition::ClockStepped).is_some();
        self.search = match (self.search, self.may_search(now)) {
            (SearchRight::Over, _) => SearchRight::Over,
            _ if has_stepped => SearchRight::Over,
            (_, true) => SearchRight::Used,
            (SearchRight::Used, false) => SearchRight::Over,
            (SearchRight::Unused, false) => SearchRight::Unused,
        };
        self.search == SearchRight::Used
    }

    fn permission(&self, inputs: &Inputs, search: bool, now: MonotonicTime) -> Permission {
        if self.state.is_latched() {
            return Permission::Stop;
        }
        if search && inputs.controller == Mode::Searching {
            return Permission::Move { share: 1.0 };
        }
        if !self.state.is_moving() {
            return Permission::Hold;
        }
        Permission::Move { share: self.slowed(now).map_or(1.0, |(_, share)| share) }
    }

    /// The action that slows the arm most. Late images slow it before they have been found for long enough for their action.
    fn slowed(&self, now: MonotonicTime) -> Option<(Cause, f64)> {
        let shares = self.findings.lasting(&self.config.policies, now).filter_map(|(cause, action)| match action {
            Action::Slow(share) => Some((cause, share)),
            _ => None,
        });
        let holds = self.config.policies.get(Condition::LateImages).action >= Action::Hold;
        let late = self.findings.cause(Condition::LateImages).filter(|_| holds);
        let shares = shares.chain(late.map(|cause| (cause, LATE_IMAGES_SHARE)));
        shares.reduce(|least, other| if other.1 < least.1 { other } else { least })
    }

    fn why(&self, blocking: Option<Cause>, now: MonotonicTime) -> Why {
        let state = self.state;
        let after_s = if self.stalls.since.is_some() { 0.0 } else { self.config.resume_after_s };
        let then = if self.needs_operator { Then::Resume } else { Then::ByItself { after_s } };
        let wants_operator = state == State::Selecting || self.held_by_operator || self.needs_operator;
        match (state, blocking) {
            (State::Idle, _) => Why::Idle,
            (State::Selecting | State::Holding | State::Lost, None) if wants_operator && !self.is_clear() => {
                Why::Settling { state, cause: self.last_inhibit, for_s: self.config.go_after_s }
            }
            (State::Selecting, None) => Why::Ready,
            (State::Selecting, Some(cause)) => Why::Waiting { cause },
            (State::Approaching | State::Tracking, _) => match self.slowed(now) {
                Some((cause, share)) => Why::Slowed { state, cause, share },
                None => Why::Moving { state },
            },
            (State::Holding | State::Lost, cause) if self.held_by_operator => {
                Why::HeldByOperator { state, every_arm: self.holds_every_arm, cause }
            }
            (State::Holding | State::Lost, Some(cause)) => Why::Resting { state, cause, then },
            (State::Holding | State::Lost, None) => match self.cause {
                Some(cause) => Why::CauseGone { state, cause, then },
                None => Why::HeldByOperator { state, every_arm: self.holds_every_arm, cause: None },
            },
            (State::Stopped | State::Fault, _) => match self.cause {
                Some(cause) => Why::Latched { state, cause, is_gone: self.findings.cause(cause.condition).is_none() },
                None => Why::StoppedByOperator,
            },
        }
    }
}

/// Search state: at most one search per loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SearchRight {
    /// Not yet permitted.
    Unused,
    /// Permitted.
    Used,
    /// Was permitted and has ended.
    Over,
}

/// Whether a loss of the target causes this condition.
fn comes_with_loss(condition: Condition) -> bool {
    matches!(
        condition,
        Condition::TargetLost | Condition::EstimateStale | Condition::ControllerRests | Condition::LowConfidence
    )
}

fn event_of(command: OperatorCommand) -> Event {
    match command {
        OperatorCommand::Select => Event::Select,
        OperatorCommand::Start => Event::Start,
        OperatorCommand::Hold | OperatorCommand::HoldHand => Event::Hold,
        OperatorCommand::Resume => Event::Resume,
        OperatorCommand::Realign => Event::Realign,
        OperatorCommand::Stop => Event::Stop,
        OperatorCommand::Reset => Event::Reset,
    }
}
