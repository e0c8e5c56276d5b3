//! Operator console: commands are read on one thread and answers written on another, so the thread that moves the arms waits for neither.

mod options;

use std::io::{BufRead, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::{ImageSize, MonotonicTime};
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Condition, Decision, OperatorCommand, OperatorInput, OperatorRequest, Transition};
use pb3dp_setup::region_spec::{RegionSpec, load_region};
use rtrb::{Consumer, Producer, RingBuffer};

use self::options::Drawn;
pub use self::options::{ConsoleOptions, ConsoleTargets};
use super::operator::Operator;
use super::person::{KeyRequest, cautious_command_of, command_of};
use super::selection::{Selection, Selections};
use super::terminal::without_escape_sequences;

/// Commands that no control step has taken yet; `stop`, `hold` and `hold hand` need no space in this queue.
const WORDS_MAX: usize = 16;
/// Answers that are not written yet.
const ANSWERS_MAX: usize = 64;
/// Longest accepted line, bytes: a polygon with a hundred corners.
const LINE_MAX: u64 = 1024;
/// Time between two read attempts on a non-blocking input.
const READ_AGAIN: Duration = Duration::from_millis(10);
/// Time between two checks for results of commands; an operator does not notice it.
const RESULTS_EVERY: Duration = Duration::from_millis(50);

/// Pause between two control steps after which the commands that wait were typed blind, while this program was suspended: the limit of
/// `clock_stepped` in `configs`. At half of it a loaded machine discards commands; at double a fault can come and be cleared unseen.
const SUSPENDED_AFTER: Duration = Duration::from_millis(200);
/// Time after such a pause in which commands are discarded. The reading thread takes all waiting lines within milliseconds; at double an
/// operator would notice it.
const DISCARDS_FOR: Duration = Duration::from_millis(300);

/// Part of the answer to an unknown command.
const WORDS: &str = "use select, start, hold, hold hand, resume, stop, reset, status, help or quit";

/// Part of a line that is too long which is read again with the next part: no word of a command is cut.
const LINE_OVERLAP: usize = 64;

/// Question to an operator who types nothing while an arm may move.
const ASK: &str = "are you there? press Enter now, or the arms hold (operator_silent)";

/// Answer to commands that were typed while this program was suspended.
const DISCARDED: &str = "this program was suspended, or its clock stepped: commands typed meanwhile are discarded (not stop and hold); \
                         type them again";

/// Answer to `help`.
const HELP: &str = "\
select     initialise the marked target; select REGION marks another one, for instance select rect:345,200,90,80
start      follow the target with the hand
hold       hold both arms; resume continues
hold hand  hold the camera arm; the arm with the target continues
resume     continue after a hold
stop       stop both arms and close the brakes; reset leaves this state
reset      clear a stop or a fault after its cause is gone
status     show the state and what inhibits motion
quit       stop both arms, write the report, exit
help       show this list";

/// Operator commands from a console, one on each line. The end of the input ends the run, as `quit` does.
pub struct Console {
    /// Each command with its number.
    words: Consumer<(u64, OperatorRequest)>,
    shared: Arc<Shared>,
    heard_at: Option<MonotonicTime>,
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
    /// The command that this control step obeys or refuses.
    commanded: Option<OperatorCommand>,
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
    /// A control step has discarded commands; the answering thread reports it.
    has_discarded: AtomicBool,
    shown: Mutex<Shown>,
}

/// Slot for a command that is never refused for lack of space; holds its last request.
#[derive(Default)]
struct Urgent {
    /// Number of the command; 0 after it was taken.
    number: AtomicU64,
    said_nanos: AtomicU64,
}

impl Urgent {
    fn say(&self, number: u64, at: MonotonicTime) {
        self.said_nanos.store(at.as_nanos(), Ordering::SeqCst);
        self.number.store(number, Ordering::SeqCst);
    }

    fn take(&self) -> Option<(u64, MonotonicTime)> {
        match self.number.swap(0, Ordering::SeqCst) {
            0 => None,
            number => Some((number, MonotonicTime::from_nanos(self.said_nanos.load(Ordering::SeqCst)))),
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
        let (give, words) = RingBuffer::new(WORDS_MAX);
        let (say, said) = sync_channel(ANSWERS_MAX);
        let (results, decided) = RingBuffer::new(WORDS_MAX);
        let shared = Arc::new(Shared::default());
        let shown = Arc::clone(&shared);
        let drawn = Arc::new(Mutex::new(None));
        let chosen = targets.as_ref().map(|targets| (targets.selections.clone(), Arc::clone(&drawn)));
        let write = move || write_all(&said, (decided, &shown), chosen, (answers, prompt));
        Builder::new().name("answers".to_owned()).spawn(write).context("no thread for the answers of the console")?;
        let reading = Reading {
            clock,
            give,
            answers: Answers { say, left_out: 0 },
            shared: Arc::clone(&shared),
            interrupt,
            targets: targets.map(|targets| (targets.size, drawn)),
            words: 0,
        };
        let read = move || reading.read(lines);
        Builder::new().name("console".to_owned()).spawn(read).context("no thread for the console")?;
        Ok(Self {
            words,
            shared,
            heard_at: None,
            key_within: None,
            key_request: KeyRequest::default(),
            begun_at: None,
            listened_at: None,
            discarded_until: MonotonicTime::ZERO,
            overtaken: 0,
            commanded: None,
            results,
            untold: None,
        })
    }

    /// The same, but a line at least this often is the sign of life, instead of the open console: for arms that are not emulated.
    pub fn with_keys(self, key_within: Duration) -> Self {
        Self { key_within: Some(key_within), ..self }
    }

    /// The last sign of life.
    fn heard_at(&self, begun_at: MonotonicTime, now: MonotonicTime) -> Option<MonotonicTime> {
        if self.key_within.is_some() {
            let typed_at = MonotonicTime::from_nanos(self.shared.typed_nanos.load(Ordering::SeqCst));
            return Some(typed_at.clamp(begun_at, now.max(begun_at)));
        }
        // An open console counts as a sign of life, even while the operator types nothing.
        if self.shared.is_closed.load(Ordering::SeqCst) { self.heard_at } else { Some(now) }
    }

    /// Asks for a key in time, once after each sign of life, while an arm may move.
    fn ask_for_key(&mut self, decision: &Decision, now: MonotonicTime) {
        let (Some(key_within), Some(heard_at)) = (self.key_within, self.heard_at) else { return };
        let may_move = decision.state.is_moving() || (decision.state.is_resting() && !decision.no_arm_may_move);
        if may_move && self.key_request.is_due(key_within, heard_at, now) {
            self.shared.asks_for_key.store(true, Ordering::SeqCst);
        }
    }

    fn next_word(&mut self) -> Option<OperatorRequest> {
        let Shared { stop, hold, hold_hand, .. } = &*self.shared;
        let urgent =
            [(stop, OperatorCommand::Stop), (hold, OperatorCommand::Hold), (hold_hand, OperatorCommand::HoldHand)];
        for (urgent, word) in urgent {
            if let Some((number, at)) = urgent.take() {
                self.overtaken = self.overtaken.max(number);
                return Some(OperatorRequest { word, at });
            }
        }
        while let Ok((number, said)) = self.words.pop() {
            if number <= self.overtaken {
                continue;
            }
            if said.at >= self.discarded_until {
                return Some(said);
            }
            self.shared.has_discarded.store(true, Ordering::SeqCst);
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
        self.heard_at = self.heard_at(begun_at, now);
        if let Some(last) = last {
            self.ask_for_key(last, now);
        }
        let said = self.next_word().map(|said| OperatorRequest { at: said.at.max(begun_at), ..said });
        self.commanded = said.map(|said| said.word);
        OperatorInput { said, heard_at: self.heard_at, silent_after: self.key_within }
    }

    fn show(&mut self, decision: &Decision) {
        if let Some(command) = self.commanded.take() {
            // More results than anybody reads are dropped; the log has all.
            let _ = self.results.push(CommandResult::Step(command, *decision));
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
        // The log has all.
        let _ = self.results.push(CommandResult::Late(result));
    }

    fn is_person(&self) -> bool {
        true
    }

    fn can_fall_silent(&self) -> bool {
        self.key_within.is_some()
    }
}

/// The result of a command.
fn result_of(command: OperatorCommand, decision: &Decision) -> String {
    match (&decision.refused, &decision.transition) {
        (Some(refused), _) => refused.to_string(),
        (None, Some(transition)) => format!("{}: {}", command.name(), transition.to),
        (None, None) if command == OperatorCommand::Hold && decision.no_arm_may_move => {
            format!("hold: both arms hold, the state is {}", decision.state)
        }
        (None, None) => format!("{}: no change, the state is {}", command.name(), decision.state),
    }
}

/// A refusal with the problem that an arm has reported: it names the arm, the supervisor knows only that the drives are disabled.
fn with_trouble(result: String, decision: &Decision, shared: &Shared) -> String {
    let trouble = || shared.shown.lock().unwrap_or_else(PoisonError::into_inner).trouble.clone();
    match decision.refused.and_then(|_| trouble()) {
        Some(trouble) => format!("{result}\n{trouble}"),
        None => result,
    }
}

/// Writes answers until all senders are dropped; write errors are ignored.
fn write_all(
    said: &Receiver<String>,
    (mut results, shared): (Consumer<CommandResult>, &Shared),
    chosen: Option<(Selections, Drawn)>,
    (mut answers, prompt): (impl Write, &str),
) {
    if !prompt.is_empty() {
        let _ = write!(answers, "type a command; help lists them\n{prompt}").and_then(|()| answers.flush());
    }
    // An operator whose output is not read can still type commands.
    let mut answer = |text: &str| drop(write!(answers, "{text}\n{prompt}").and_then(|()| answers.flush()));
    loop {
        let said = said.recv_timeout(RESULTS_EVERY);
        if let Ok(text) = &said {
            answer(text);
        }
        while let Ok(result) = results.pop() {
            match result {
                CommandResult::Step(command, decision) => {
                    if let (OperatorCommand::Select, Some((selections, drawn))) = (command, &chosen)
                        && let Some(selection) = drawn.lock().unwrap_or_else(PoisonError::into_inner).take()
                        && decision.refused.is_none()
                    {
                        selections.give(selection);
                    }
                    answer(&with_trouble(result_of(command, &decision), &decision, shared));
                }
                CommandResult::Late(text) => answer(&text),
            }
        }
        if shared.asks_for_key.swap(false, Ordering::SeqCst) {
            answer(ASK);
        }
        if shared.has_discarded.swap(false, Ordering::SeqCst) {
            answer(DISCARDED);
        }
        if said == Err(RecvTimeoutError::Disconnected) {
            return;
        }
    }
}

/// Answers on their way to the writing thread.
struct Answers {
    say: SyncSender<String>,
    /// Number of answers dropped so far because the queue was full.
    left_out: u64,
}

impl Answers {
    fn give(&mut self, answer: String) {
        let text = match self.left_out {
            0 => answer,
            left_out => format!("({left_out} earlier answers dropped: the output was not read)\n{answer}"),
        };
        self.left_out = if self.say.try_send(text).is_ok() { 0 } else { self.left_out + 1 };
    }
}

/// The reading thread.
struct Reading {
    clock: Arc<dyn Clock>,
    give: Producer<(u64, OperatorRequest)>,
    answers: Answers,
    shared: Arc<Shared>,
    interrupt: Arc<AtomicBool>,
    /// Size of the left image, and the target of the last `select`; `None` if the target cannot be chosen here.
    targets: Option<(ImageSize, Drawn)>,
    /// Number of commands typed.
    words: u64,
}

impl Drop for Reading {
    /// After the input has ended no operator can command, so both arms stop.
    fn drop(&mut self) {
        self.shared.is_closed.store(true, Ordering::SeqCst);
        self.interrupt.store(true, Ordering::SeqCst);
    }
}

impl Reading {
    /// Reads until the input ends.
    fn read(mut self, mut lines: impl BufRead) {
        let mut line = Vec::new();
        let mut is_rest = false;
        // Obeyed in the line that is too long.
        let mut obeyed = None;
        loop {
            match lines.by_ref().take(LINE_MAX).read_until(b'\n', &mut line) {
                Ok(0) => break,
                Ok(_) => self.shared.typed_nanos.store(self.clock.now().as_nanos(), Ordering::SeqCst),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    std::thread::sleep(READ_AGAIN);
                    continue;
                }
                Err(_) => break,
            }
            let is_end = line.ends_with(b"\n");
            if !is_rest && (is_end || (line.len() as u64) < LINE_MAX) {
                self.take(String::from_utf8_lossy(&line).trim());
                line.clear();
                continue;
            }
            self.take_part(&String::from_utf8_lossy(&line), (is_rest, &mut obeyed));
            is_rest = !is_end;
            if is_rest {
                line.drain(..line.len().saturating_sub(LINE_OVERLAP));
            } else {
                line.clear();
                obeyed = None;
            }
        }
        if !self.interrupt.load(Ordering::SeqCst) {
            self.answers.give("end of input: stopping both arms, then writing the report".to_owned());
        }
    }

    fn take(&mut self, line: &str) {
        let answer = match (command_of(line), without_escape_sequences(line).trim()) {
            (None, text) if text.starts_with("select ") => self.select(text["select ".len()..].trim()),
            (Some(word), _) => self.say(word),
            (None, "status") => Some(self.status()),
            (None, "help" | "?") => Some(HELP.to_owned()),
            (None, "quit") => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("stopping both arms, then writing the report".to_owned())
            }
            (None, "") => None,
            (None, other) => Some(format!("unknown command {other:?}: {WORDS}")),
        };
        if let Some(answer) = answer {
            self.answers.give(answer);
        }
    }

    /// Selects the target in this region.
    fn select(&mut self, region: &str) -> Option<String> {
        let Some((size, drawn)) = &self.targets else {
            return Some("select refused: this run has no images in which a target can be chosen".to_owned());
        };
        let region = region.parse::<RegionSpec>().and_then(|spec| {
            spec.check_inside(*size)?;
            load_region(&spec, *size).map_err(|error| format!("{error:#}"))
        });
        match region {
            Ok(region) => {
                let selection = Selection { region, drawn_on: None };
                *drawn.lock().unwrap_or_else(PoisonError::into_inner) = Some(selection);
                self.say(OperatorCommand::Select)
            }
            Err(why) => Some(format!("select refused: {why}")),
        }
    }

    /// A part of a line that is too long: only `stop` and `hold` are obeyed, once for each line.
    fn take_part(&mut self, part: &str, (is_rest, obeyed): (bool, &mut Option<OperatorCommand>)) {
        let answer = match cautious_command_of(part) {
            Some(word) if *obeyed != Some(word) && *obeyed != Some(OperatorCommand::Stop) => {
                *obeyed = Some(word);
                self.say(word)
            }
            None if !is_rest => Some(format!("the line is longer than {LINE_MAX} bytes: {WORDS}")),
            _ => None,
        };
        if let Some(answer) = answer {
            self.answers.give(answer);
        }
    }

    fn say(&mut self, word: OperatorCommand) -> Option<String> {
        if !self.shared.has_begun.load(Ordering::SeqCst) {
            return self.say_early(word);
        }
        self.give(word)
    }

    /// Handles a command while both arms are being enabled. `stop` aborts enabling and ends the run. Commands that cause no motion are
    /// queued. Commands that could cause motion are refused, because the operator refers to the present state.
    fn say_early(&mut self, word: OperatorCommand) -> Option<String> {
        match word {
            OperatorCommand::Stop => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("enabling aborted: stopping both arms, then writing the report".to_owned())
            }
            OperatorCommand::Select | OperatorCommand::Hold | OperatorCommand::HoldHand => Some(
                self.give(word).unwrap_or_else(|| format!("{} is queued until both arms are enabled", word.name())),
            ),
            OperatorCommand::Start | OperatorCommand::Resume | OperatorCommand::Reset => Some(format!(
                "{} refused: both arms are still being enabled; repeat it when they are enabled",
                word.name()
            )),
        }
    }

    fn give(&mut self, word: OperatorCommand) -> Option<String> {
        let said = OperatorRequest { word, at: self.clock.now() };
        self.words += 1;
        match word {
            OperatorCommand::Stop => self.shared.stop.say(self.words, said.at),
            OperatorCommand::Hold => self.shared.hold.say(self.words, said.at),
            OperatorCommand::HoldHand => self.shared.hold_hand.say(self.words, said.at),
            _ if self.give.push((self.words, said)).is_err() => {
                return Some(format!("{} refused: {WORDS_MAX} commands are waiting; repeat it", word.name()));
            }
            _ => {}
        }
        None
    }

    fn status(&self) -> String {
        let Shown { decision, trouble } = self.shared.shown.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let why = decision.map_or_else(
            || "not started yet: both arms are being enabled".to_owned(),
            |decision| decision.why.to_string(),
        );
        match trouble {
            Some(trouble) => format!("{why}\n{trouble}"),
            None => why,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
