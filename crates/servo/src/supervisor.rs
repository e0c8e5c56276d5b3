//! The supervisor: whether the arm may move, and if not, why and what to do.
//!
//! It stands between the controller and the arm. In each step [`Supervisor::step`] looks at everything that is known
//! ([`Inputs`]), at its [`Policies`] and at the operator's word, and says what is permitted ([`Decision`]). The
//! [`table`](mod@table) of states is its whole memory of what was permitted before; a latched state ends with the operator's
//! reset only, and leads to [`State::Idle`] and no further.
//!
//! The arm goes on only from what is measured: with each rest, stop, fault, reset and selection [`Decision::rearm`] tells the
//! controller to drop its set-points, and nothing is permitted before it has new ones.

mod codes;
mod findings;
mod inputs;
mod log;
mod policy;
pub mod table;
mod words;

use pb3dp_geometry::MonotonicTime;
use pb3dp_safeguards::{Safeguard, is_off};

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
pub use self::words::{Refusal, RefusedFor, Then, Why};

use self::findings::Findings;
use self::table::outcome;
use crate::controller::Mode;

/// What the arm may do until the next step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Permission {
    /// Go as the controller says, with this share of its velocity, above 0 to 1.
    Move {
        /// The share.
        share: f64,
    },
    /// Come to rest and stay; brakes stay open.
    Hold,
    /// Both arms are to be stopped, and stay so.
    Stop,
}

/// The outcome of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// What the arm may do.
    pub permission: Permission,
    /// Where the supervisor is.
    pub state: State,
    /// One line: why the arm does not move, and what to do.
    pub why: Why,
    /// The controller is to drop its set-points and target ([`crate::Controller::acquire`]).
    pub rearm: bool,
    /// The controller may look for the target that was lost ([`crate::Controller::permit_search`]).
    pub search: bool,
    /// What is wrong, in motion or at rest after it, and has lasted.
    pub found: ConditionSet,
    /// No arm may move by itself, the one that carries the target included: its joints, its drives, the clock or the operator are not
    /// what they must be for that, in whatever state.
    pub no_arm_may_move: bool,
    /// Whether `start`, or after a rest `resume`, would be obeyed now.
    pub is_ready: bool,
    /// The change of state in this step.
    pub transition: Option<Transition>,
    /// The word that was not obeyed in this step.
    pub refused: Option<Refusal>,
}

/// The supervisor of both arms of a cell.
#[derive(Clone, Debug)]
pub struct Supervisor {
    config: SupervisorConfig,
    state: State,
    /// When the state was entered; a word that was said before was said to another state.
    entered_at: Option<MonotonicTime>,
    findings: Findings,
    /// What led to the state; none if the operator's word did.
    cause: Option<Cause>,
    /// Since when nothing has spoken against motion.
    clear_since: Option<MonotonicTime>,
    /// What spoke against it last, since the target was selected.
    spoke: Option<Cause>,
    /// The operator has said hold since the last motion.
    held_by_operator: bool,
    /// Something was found since the last motion after which only the operator's word leads on.
    needs_word: bool,
    /// The same, other than that the target is lost.
    needs_word_for_more: bool,
    /// What became of the search for the target since the last motion.
    search: SearchRight,
    log: TransitionLog,
}

impl Supervisor {
    /// A supervisor at [`State::Idle`].
    ///
    /// # Errors
    /// The first setting that is out of its range, or weaker than its condition allows.
    pub fn new(config: SupervisorConfig) -> Result<Self, SupervisorError> {
        config.validate()?;
        Ok(Self {
            config,
            state: State::Idle,
            entered_at: None,
            findings: Findings::new(),
            cause: None,
            clear_since: None,
            spoke: None,
            held_by_operator: false,
            needs_word: false,
            needs_word_for_more: false,
            search: SearchRight::Unused,
            log: TransitionLog::new(),
        })
    }

    /// The last transitions.
    pub fn log(&self) -> &TransitionLog {
        &self.log
    }

    /// One control cycle: never blocks, does not allocate. In one step the state changes at most once.
    ///
    /// What is found goes before what is said, but for `stop` and `hold`, which are always obeyed. `start` and `resume` are
    /// refused while a condition inhibits motion, even if it has not lasted yet, and until it has been gone for
    /// [`SupervisorConfig::go_after_s`]; `reset` as long as a fault of an arm or an emergency stop is still there; and every word that
    /// was said too long ago, or before the state was entered.
    pub fn step(&mut self, inputs: &Inputs, now: MonotonicTime) -> Decision {
        self.findings.look(inputs, &self.config.policies, now);
        // A clock that was set back must not keep the operator's words out until it has caught up.
        self.entered_at = self.entered_at.map(|entered| entered.min(now));
        let blocking = self.findings.first_at_least(&self.config.policies, Action::Hold);
        self.clear_since = match (blocking, self.clear_since) {
            (None, Some(since)) if since <= now => Some(since),
            (None, _) => Some(now),
            (Some(_), _) => None,
        };
        self.spoke = blocking.or(self.spoke);
        let said = inputs.operator.said;
        let word = said.map(|said| (said.word, self.refusal(said, blocking, now)));
        let transition = self.change(inputs, word, now);
        let rearm = transition.is_some_and(|(_, order)| order != Order::None);
        let mut blocking = blocking;
        if rearm {
            self.findings.rearm();
            self.clear_since = None;
            if self.state == State::Selecting {
                // What was known of another target, or of the same one before, speaks for nothing any more.
                self.findings.look(inputs, &self.config.policies, now);
                blocking = self.findings.first_at_least(&self.config.policies, Action::Hold);
            }
        }
        let found = self.note(now);
        let search = self.permits_search(now);
        let refused = word.and_then(|(word, refused)| self.refused(word, refused, transition.map(|(event, _)| event)));
        Decision {
            permission: self.permission(inputs, search, now),
            state: self.state,
            why: if search && inputs.controller == Mode::Searching { Why::Searching } else { self.why(blocking, now) },
            rearm,
            search,
            found,
            no_arm_may_move: self.state.is_latched() || self.holds_every_arm(now),
            is_ready: self.is_clear() && !rearm && (self.state == State::Selecting || self.state.is_resting()),
            transition: transition.and_then(|_| self.log.newest()),
            refused,
        }
    }

    /// The most telling of the most severe things that are wrong, with the event that it makes.
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

    /// The first of all events, the most severe one first, that leads to another state.
    fn change(
        &mut self,
        inputs: &Inputs,
        word: Option<(OperatorCommand, Option<RefusedFor>)>,
        now: MonotonicTime,
    ) -> Option<(Event, Order)> {
        let alarm = self.alarm(now);
        let of_alarm =
            |wanted: Event| alarm.filter(|(event, _)| *event == wanted).map(|(event, cause)| (event, Some(cause)));
        let obeyed = word.filter(|(_, refused)| refused.is_none()).map(|(word, _)| word);
        let said = |wanted: OperatorCommand| (obeyed == Some(wanted)).then_some((event_of(wanted), None));
        if obeyed == Some(OperatorCommand::Hold) {
            self.held_by_operator = true;
        }
        let candidates = [
            of_alarm(Event::FaultFound),
            said(OperatorCommand::Stop),
            of_alarm(Event::StopFound),
            said(OperatorCommand::Hold),
            of_alarm(Event::LossFound),
            of_alarm(Event::HoldFound),
            said(OperatorCommand::Select),
            said(OperatorCommand::Start),
            said(OperatorCommand::Resume),
            said(OperatorCommand::Reset),
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

    /// For how long nothing has spoken against motion, seconds, up to the newest confident estimate: while none comes nothing is known.
    fn clear_for_s(&self) -> f64 {
        let (Some(since), Some(until)) = (self.clear_since, self.findings.confirmed_at) else { return 0.0 };
        until.seconds_since(since).max(0.0)
    }

    /// Whether that is long enough for a word to lead on: a cause that comes and goes from image to image is not gone between two.
    fn is_clear(&self) -> bool {
        self.clear_since.is_some() && (self.clear_for_s() >= self.config.go_after_s || is_off(Safeguard::ClearForWords))
    }

    /// What happens without anybody's word.
    fn by_itself(&self, inputs: &Inputs) -> Option<Event> {
        let may_resume = !self.held_by_operator && !self.needs_word && self.clear_for_s() >= self.config.resume_after_s;
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
            self.needs_word = false;
            self.needs_word_for_more = false;
            self.search = SearchRight::Unused;
        }
        match event {
            Event::Select => {
                self.findings.begin(at);
                self.spoke = None;
            }
            Event::Start => self.findings.start(),
            _ => {}
        }
        self.state = to;
        self.entered_at = Some(at);
        self.cause = cause;
        self.log.push(transition);
    }

    /// Whether a reset is to reach the arms: one that is obeyed as soon as no arm has a fault or an emergency stop any more. Nothing but a
    /// latched state is reset, and not by a word that was said too long ago or before the state was entered.
    pub fn would_reset(&self, said: OperatorRequest, now: MonotonicTime) -> bool {
        said.word == OperatorCommand::Reset && self.state.is_latched() && self.untimely(said, now).is_none()
    }

    /// What is wrong; keeps in mind that only a word leads on.
    fn note(&mut self, now: MonotonicTime) -> ConditionSet {
        let mut found = ConditionSet::default();
        if !(self.state.is_moving() || self.state.is_resting()) {
            return found;
        }
        for (cause, action) in self.findings.lasting(&self.config.policies, now) {
            found.insert(cause.condition);
            let resume = self.config.policies.get(cause.condition).resume;
            let needs_word = self.state.is_resting() && action.is_rest() && resume == Resume::ByOperator;
            self.needs_word |= needs_word;
            self.needs_word_for_more |= needs_word && !comes_with_loss(cause.condition);
        }
        found
    }

    fn holds_every_arm(&self, now: MonotonicTime) -> bool {
        self.findings.lasting(&self.config.policies, now).any(|(cause, _)| cause.condition.rule().holds_every_arm)
    }

    /// Why a word may not be obeyed, whatever the table says.
    fn refusal(&self, said: OperatorRequest, blocking: Option<Cause>, now: MonotonicTime) -> Option<RefusedFor> {
        if matches!(said.word, OperatorCommand::Stop | OperatorCommand::Hold) {
            return None;
        }
        if let Some(untimely) = self.untimely(said, now) {
            return Some(untimely);
        }
        let latched = [Condition::EmergencyStop, Condition::ArmFault].map(|condition| self.findings.cause(condition));
        match (said.word, self.state) {
            (OperatorCommand::Start, State::Selecting) | (OperatorCommand::Resume, State::Holding | State::Lost) => {
                blocking.map(RefusedFor::Cause).or_else(|| self.not_clear())
            }
            (OperatorCommand::Reset, State::Stopped | State::Fault) => {
                latched.into_iter().flatten().next().map(RefusedFor::Cause)
            }
            _ => None,
        }
    }

    /// No condition inhibits motion any more, but not yet for long enough.
    fn not_clear(&self) -> Option<RefusedFor> {
        let (clear_s, wanted_s) = (self.clear_for_s(), self.config.go_after_s);
        (!self.is_clear()).then_some(RefusedFor::NotClear { cause: self.spoke, clear_s, wanted_s })
    }

    /// Why a word may not be obeyed because of when it was said.
    fn untimely(&self, said: OperatorRequest, now: MonotonicTime) -> Option<RefusedFor> {
        if is_off(Safeguard::TimelyWords) {
            return None;
        }
        let age_s = now.seconds_since(said.at);
        let age_max_s = self.config.word_age_max_s;
        if !(-age_max_s..=age_max_s).contains(&age_s) {
            return Some(RefusedFor::Age { age_s, age_max_s });
        }
        // A clock that was set back must not keep the operator's words out until it has caught up.
        let is_before = self.entered_at.is_some_and(|entered| said.at < entered.min(now));
        if is_before {
            return Some(RefusedFor::OlderThanState(self.state));
        }
        // Who says start means the target that is followed then.
        let followed_since = self.findings.followed_since().filter(|_| said.word == OperatorCommand::Start);
        let is_other = followed_since.is_some_and(|since| said.at < since.min(now));
        is_other.then_some(RefusedFor::OlderThanTarget)
    }

    /// What became of a word.
    fn refused(&self, word: OperatorCommand, refused: Option<RefusedFor>, happened: Option<Event>) -> Option<Refusal> {
        let own = event_of(word);
        let because = match (refused, happened) {
            (Some(because), _) => because,
            (None, Some(event)) if event == own => return None,
            // `stop` is obeyed by a fault, and `hold` by everything that ends motion.
            (None, Some(_)) if matches!(word, OperatorCommand::Stop | OperatorCommand::Hold) => return None,
            (None, Some(_)) => RefusedFor::Overtaken(self.state),
            (None, None) if outcome(self.state, own) == Outcome::Refuse => RefusedFor::State(self.state),
            (None, None) => return None,
        };
        Some(Refusal { word, because })
    }

    /// Whether the hand may look for the target: it is lost, not for too long, the operator has not said hold, nothing waits for a word
    /// but the loss itself, and nothing is wrong but what a loss brings with it.
    fn may_search(&self, now: MonotonicTime) -> bool {
        let since_s = self.entered_at.map_or(f64::INFINITY, |entered| now.seconds_since(entered));
        let of_loss = |cause: Cause| comes_with_loss(cause.condition);
        self.state == State::Lost
            && !self.held_by_operator
            && !self.needs_word_for_more
            && (0.0..self.config.search_max_s).contains(&since_s)
            && self.findings.all_at_least(&self.config.policies, Action::Slow(1.0)).all(of_loss)
    }

    /// The same, once for each loss: a search that was broken off does not begin again, nor does one after a clock that stepped, by
    /// which nobody knows how long the target has been lost.
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

    /// What slows the arm most.
    fn slowed(&self, now: MonotonicTime) -> Option<(Cause, f64)> {
        let shares = self.findings.lasting(&self.config.policies, now).filter_map(|(cause, action)| match action {
            Action::Slow(share) => Some((cause, share)),
            _ => None,
        });
        shares.reduce(|least, other| if other.1 < least.1 { other } else { least })
    }

    fn why(&self, blocking: Option<Cause>, now: MonotonicTime) -> Why {
        let state = self.state;
        let then = if self.needs_word { Then::Resume } else { Then::ByItself { after_s: self.config.resume_after_s } };
        let wants_word = state == State::Selecting || self.held_by_operator || self.needs_word;
        match (state, blocking) {
            (State::Idle, _) => Why::Idle,
            (State::Selecting | State::Holding | State::Lost, None) if wants_word && !self.is_clear() => {
                Why::Settling { state, cause: self.spoke, for_s: self.config.go_after_s }
            }
            (State::Selecting, None) => Why::Ready,
            (State::Selecting, Some(cause)) => Why::Waiting { cause },
            (State::Approaching | State::Tracking, _) => match self.slowed(now) {
                Some((cause, share)) => Why::Slowed { state, cause, share },
                None => Why::Moving { state },
            },
            (State::Holding | State::Lost, cause) if self.held_by_operator => Why::HeldByOperator { state, cause },
            (State::Holding | State::Lost, Some(cause)) => Why::Resting { state, cause, then },
            (State::Holding | State::Lost, None) => match self.cause {
                Some(cause) => Why::CauseGone { state, cause, then },
                None => Why::HeldByOperator { state, cause: None },
            },
            (State::Stopped | State::Fault, _) => match self.cause {
                Some(cause) => Why::Latched { state, cause, is_gone: self.findings.cause(cause.condition).is_none() },
                None => Why::StoppedByOperator,
            },
        }
    }
}

/// One search for each loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SearchRight {
    /// Not permitted yet.
    Unused,
    /// Permitted now.
    Used,
    /// Was permitted, and is not any more.
    Over,
}

/// Whether this is found because the target is not seen.
fn comes_with_loss(condition: Condition) -> bool {
    matches!(
        condition,
        Condition::TargetLost | Condition::EstimateStale | Condition::ControllerRests | Condition::LowConfidence
    )
}

fn event_of(word: OperatorCommand) -> Event {
    match word {
        OperatorCommand::Select => Event::Select,
        OperatorCommand::Start => Event::Start,
        OperatorCommand::Hold => Event::Hold,
        OperatorCommand::Resume => Event::Resume,
        OperatorCommand::Stop => Event::Stop,
        OperatorCommand::Reset => Event::Reset,
    }
}
