//! Operator console: commands are read on one thread and answers written on another, so the thread that moves the arms waits for neither.

mod answering;
mod options;
mod reading;

use std::io::{BufRead, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, TryLockError};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Condition, Decision, OperatorCommand, OperatorInput, OperatorRequest, Transition};
use rtrb::{Consumer, Producer, RingBuffer};

use self::answering::write_all;
pub use self::options::{ConsoleOptions, ConsoleTargets};
use self::reading::Reading;
use super::operator::Operator;
use super::person::KeyRequest;
use super::selection::Selections;

/// Commands that no control step has taken yet; `stop`, `hold` and `hold hand` need no space in this queue.
const COMMANDS_MAX: usize = 16;
/// Answers that are not written yet.
const ANSWERS_MAX: usize = 64;
/// Results of commands that are not written yet.
const RESULTS_MAX: usize = 64;
/// Pause between two control steps after which the commands that wait were typed blind, while this program was suspended: the limit of
/// `clock_stepped` in `configs`. At half of it a loaded machine discards commands; at double a fault can come and be cleared unseen.
const SUSPENDED_AFTER: Duration = Duration::from_millis(200);
/// Time after such a pause in which commands are discarded. The reading thread takes all waiting lines within milliseconds; at double an
/// operator would notice it.
const DISCARDS_FOR: Duration = Duration::from_millis(300);

/// Operator commands from a console, one on each line. The end of the input ends the run, as `quit` does.
pub struct Console {
    commands: Consumer<GivenCommand>,
    shared: Arc<Shared>,
    heartbeat_at: Option<MonotonicTime>,
    /// Longest time without a key; `None` if the open console is the sign of life.
    key_within: Option<Duration>,
    key_request: KeyRequest,
    /// Time at which commands were first accepted; commands queued before are stamped with it.
    begun_at: Option<MonotonicTime>,
    /// Time of the last control step.
    listened_at: Option<MonotonicTime>,
    /// Commands read before are discarded, except `stop` and the holds: they were typed while this program was suspended, and dated when
    /// they were read.
    discarded_until: MonotonicTime,
    /// Commands up to this number precede a `stop` or `hold` that was taken, and are dropped.
    overtaken: u64,
    /// The last of these.
    overtaken_by: OperatorCommand,
    /// The command that this control step obeys or refuses, with the number of its selection.
    commanded: Option<(OperatorCommand, Option<u64>)>,
    /// Targets for the estimation.
    selections: Option<Selections>,
    /// In the previous step, the estimation had not passed on an estimate of the selected target.
    was_awaited: bool,
    /// Results of commands, for the answering thread.
    results: Producer<CommandResult>,
    /// Trouble not shown yet because the reader held the lock.
    untold: Option<Option<String>>,
}

/// The result of a command, for the answering thread.
#[allow(clippy::large_enum_variant, reason = "the control thread must not allocate for the result of a step")]
enum CommandResult {
    /// Of the control step that obeyed or refused it.
    Step(OperatorCommand, Decision),
    /// Of a command that took longer.
    Late(String),
    /// A command that a later `stop` or `hold` removed.
    Overtaken(OperatorCommand, OperatorCommand),
    /// A `start` while the estimation still follows the target before.
    Awaited,
}

/// A command on its way to the control thread.
#[derive(Clone, Copy, Debug, PartialEq)]
struct GivenCommand {
    /// Number of the command, in the order of typing.
    number: u64,
    request: OperatorRequest,
    /// Number of the selection that travels with a `select`.
    offer: Option<u64>,
}

/// State shared by the threads of a console.
#[derive(Default)]
struct Shared {
    is_closed: AtomicBool,
    /// Commands are accepted: both arms are enabled.
    has_begun: AtomicBool,
    stop: Urgent,
    hold: Urgent,
    hold_hand: Urgent,
    /// Time of the last line, nanoseconds.
    typed_nanos: AtomicU64,
    /// The operator must press a key; the answering thread asks for it.
    asks_for_key: AtomicBool,
    /// Something other than Enter was typed.
    has_typed: AtomicBool,
    /// The operator must know that `start` is needed; the answering thread reports it.
    has_no_start: AtomicBool,
    /// The `select` whose file is being read; 0: none.
    reading: AtomicU64,
    /// A control step has discarded commands; the answering thread reports it.
    has_discarded: AtomicBool,
    shown: Mutex<Shown>,
}

/// Slot for a command that is never refused for lack of space; holds its last request.
#[derive(Default)]
struct Urgent {
    /// Number of the command; 0 after it was taken.
    number: AtomicU64,
    requested_nanos: AtomicU64,
}

impl Urgent {
    fn say(&self, number: u64, at: MonotonicTime) {
        self.requested_nanos.store(at.as_nanos(), Ordering::SeqCst);
        self.number.store(number, Ordering::SeqCst);
    }

    fn take(&self) -> Option<(u64, MonotonicTime)> {
        match self.number.swap(0, Ordering::SeqCst) {
            0 => None,
            number => Some((number, MonotonicTime::from_nanos(self.requested_nanos.load(Ordering::SeqCst)))),
        }
    }
}

#[derive(Clone, Default)]
struct Shown {
    decision: Option<Decision>,
    trouble: Option<String>,
}

impl Console {
    /// Reads `lines` on one thread and writes to `answers` on another, each answer followed by `prompt`. The command `quit` and the end of
    /// the input set `interrupt`.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start(
        clock: Arc<dyn Clock>,
        lines: impl BufRead + Send + 'static,
        answers: impl Write + Send + 'static,
        ConsoleOptions { interrupt, prompt, targets }: ConsoleOptions,
    ) -> Result<Self> {
        let (give, commands) = RingBuffer::new(COMMANDS_MAX);
        let (say, answer_lines) = sync_channel(ANSWERS_MAX);
        let (results, decided) = RingBuffer::new(RESULTS_MAX);
        let shared = Arc::new(Shared::default());
        let shown = Arc::clone(&shared);
        let selections = targets.as_ref().map(|targets| targets.selections.clone());
        let write = move || write_all(&answer_lines, (decided, &shown), (answers, prompt));
        Builder::new().name("answers".to_owned()).spawn(write).context("no thread for the answers of the console")?;
        let reading = Reading::new((clock, Arc::clone(&shared)), (give, say), (interrupt, targets));
        let read = move || reading.read(lines);
        Builder::new().name("console".to_owned()).spawn(read).context("no thread for the console")?;
        Ok(Self {
            commands,
            shared,
            heartbeat_at: None,
            key_within: None,
            key_request: KeyRequest::default(),
            begun_at: None,
            listened_at: None,
            discarded_until: MonotonicTime::ZERO,
            overtaken: 0,
            overtaken_by: OperatorCommand::Stop,
            commanded: None,
            selections,
            was_awaited: false,
            results,
            untold: None,
        })
    }

    /// The same, but a line at least this often is the sign of life, instead of the open console: for arms that are not emulated.
    pub fn with_keys(self, key_within: Duration) -> Self {
        Self { key_within: Some(key_within), ..self }
    }

    /// The last sign of life.
    fn heartbeat_at(&self, begun_at: MonotonicTime, now: MonotonicTime) -> Option<MonotonicTime> {
        if self.key_within.is_some() {
            let typed_at = MonotonicTime::from_nanos(self.shared.typed_nanos.load(Ordering::SeqCst));
            return Some(typed_at.clamp(begun_at, now.max(begun_at)));
        }
        // An open console counts as a sign of life, even while the operator types nothing.
        if self.shared.is_closed.load(Ordering::SeqCst) { self.heartbeat_at } else { Some(now) }
    }

    /// Asks for a key in time, once after each sign of life, while an arm may move.
    fn ask_for_key(&mut self, decision: &Decision, now: MonotonicTime) {
        let (Some(key_within), Some(heartbeat_at)) = (self.key_within, self.heartbeat_at) else { return };
        let may_move = decision.state.is_moving() || (decision.state.is_resting() && !decision.no_arm_may_move);
        if may_move && self.key_request.is_due(key_within, heartbeat_at, now) {
            self.shared.asks_for_key.store(true, Ordering::SeqCst);
        }
    }

    /// Whether something other than Enter was typed.
    pub(crate) fn has_typed(&self) -> bool {
        self.shared.has_typed.load(Ordering::SeqCst)
    }

    /// Reports that the run goes on only after the command `start`.
    pub(crate) fn say_no_start(&self) {
        self.shared.has_no_start.store(true, Ordering::SeqCst);
    }

    /// More results than anybody reads are dropped; the log has all.
    fn report(&mut self, result: CommandResult) {
        let _ = self.results.push(result);
    }

    /// Drops a selection whose command is not obeyed.
    fn drop_offer(&self, offer: Option<u64>) {
        if let (Some(selections), Some(offer)) = (&self.selections, offer) {
            selections.drop_offer(offer);
        }
    }

    /// Whether the estimation still follows the target before the selected one. The step after its estimate counts as well, because the
    /// control thread may not have the estimate yet.
    fn awaits_target(&mut self) -> bool {
        let is_awaited = self.selections.as_ref().is_some_and(Selections::is_awaited);
        std::mem::replace(&mut self.was_awaited, is_awaited) || is_awaited
    }

    fn next_command(&mut self) -> Option<(OperatorRequest, Option<u64>)> {
        let Shared { stop, hold, hold_hand, .. } = &*self.shared;
        let urgent =
            [(stop, OperatorCommand::Stop), (hold, OperatorCommand::Hold), (hold_hand, OperatorCommand::HoldHand)];
        for (urgent, command) in urgent {
            if let Some((number, at)) = urgent.take() {
                if number > self.overtaken {
                    (self.overtaken, self.overtaken_by) = (number, command);
                }
                return Some((OperatorRequest { command, at }, None));
            }
        }
        while let Ok(GivenCommand { number, request, offer }) = self.commands.pop() {
            if number > self.overtaken && request.at >= self.discarded_until {
                return Some((request, offer));
            }
            self.drop_offer(offer);
            if number > self.overtaken {
                self.shared.has_discarded.store(true, Ordering::SeqCst);
            } else {
                self.report(CommandResult::Overtaken(request.command, self.overtaken_by));
            }
        }
        None
    }

    /// Updates the shown state unless the reader holds the lock; returns whether it was possible.
    fn try_show(&self, change: impl FnOnce(&mut Shown)) -> bool {
        match self.shared.shown.try_lock() {
            Ok(mut shown) => change(&mut shown),
            Err(TryLockError::Poisoned(poisoned)) => change(&mut poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => return false,
        }
        true
    }
}

impl Operator for Console {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let begun_at = *self.begun_at.get_or_insert(now);
        self.shared.has_begun.store(true, Ordering::SeqCst);
        let before = self.listened_at.replace(now).unwrap_or(now);
        if now < before || now.saturating_since(before) > SUSPENDED_AFTER {
            self.discarded_until = now + DISCARDS_FOR;
        }
        self.heartbeat_at = self.heartbeat_at(begun_at, now);
        if let Some(last) = last {
            self.ask_for_key(last, now);
        }
        let awaits_target = self.awaits_target();
        let next = self.next_command();
        let (request, offer) = next.map_or((None, None), |(request, offer)| (Some(request), offer));
        let mut request = request.map(|request| OperatorRequest { at: request.at.max(begun_at), ..request });
        if awaits_target && request.is_some_and(|request| request.command == OperatorCommand::Start) {
            request = None;
            self.report(CommandResult::Awaited);
        }
        self.commanded = request.map(|request| (request.command, offer));
        OperatorInput { request, heartbeat_at: self.heartbeat_at, silent_after: self.key_within }
    }

    fn show(&mut self, decision: &Decision) {
        if let Some((command, offer)) = self.commanded.take() {
            // Here, because nobody may read the answers.
            match (&self.selections, offer) {
                (Some(selections), Some(offer)) if decision.refused.is_none() => selections.accept(offer),
                _ => self.drop_offer(offer),
            }
            self.report(CommandResult::Step(command, *decision));
        }
        if let Some(Transition { at, cause: Some(cause), .. }) = decision.transition
            && cause.condition == Condition::ClockStepped
        {
            self.discarded_until = at + DISCARDS_FOR;
        }
        let mut untold = self.untold.take();
        // If the lock is held, the reader gets the state of the previous step.
        self.try_show(|shown| {
            shown.decision = Some(*decision);
            if let Some(trouble) = untold.take() {
                shown.trouble = trouble;
            }
        });
        self.untold = untold;
    }

    fn tell(&mut self, trouble: Option<String>) {
        let mut untold = Some(trouble);
        self.try_show(|shown| shown.trouble = untold.take().flatten());
        // If the lock is held, the next step shows it.
        self.untold = untold;
    }

    fn answer(&mut self, result: String) {
        self.report(CommandResult::Late(result));
    }

    fn is_person(&self) -> bool {
        true
    }

    fn can_fall_silent(&self) -> bool {
        self.key_within.is_some()
    }
}

#[cfg(test)]
pub(crate) mod tests;
