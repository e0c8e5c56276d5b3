//! The thread that reads commands. It waits for no file: `stop` and `hold` are heard while a mask is being read.

use std::io::{BufRead, ErrorKind, Read};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::Builder;
use std::time::Duration;

use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{OperatorCommand, OperatorRequest};
use pb3dp_setup::region_spec::{RegionSpec, load_region};
use rtrb::Producer;

use super::options::ConsoleTargets;
use super::{COMMANDS_MAX, GivenCommand, Shared, Shown};
use crate::person::{cautious_command_of, command_of};
use crate::selection::{Choice, Selection, Selections};
use crate::terminal::without_escape_sequences;

/// Longest accepted line, bytes: a polygon with a hundred corners.
pub(super) const LINE_MAX: u64 = 1024;
/// Time between two read attempts on a non-blocking input.
const READ_AGAIN: Duration = Duration::from_millis(10);
/// Part of a line that is too long which is read again with the next part: no word of a command is cut.
const LINE_OVERLAP: usize = 64;
/// Files that are being read at once, with those that do not answer and that nobody waits for any more.
const FILES_MAX: usize = 4;

/// Part of the answer to an unknown command.
const COMMANDS_HELP: &str = "use select, start, hold, hold hand, resume, re-align, stop, reset, status, help or quit";

/// Answer to `select` without a region, where the setup has no target.
const NO_TARGET: &str = "select refused: the setup names no target (camera.region); mark one in the left image, for instance select \
                         rect:345,200,90,80";

/// Answer to `help`.
const HELP: &str = "\
select     select the target of the setup; select REGION marks another one, for instance select rect:345,200,90,80
start      follow the target with the hand
hold       hold both arms; resume continues
hold hand  hold the camera arm; the arm with the target continues
resume     continue after a hold
re-align   approach the pose again, relative to the surface as it is known by now
stop       stop both arms and close the brakes; reset leaves this state
reset      clear a stop or a fault after its cause is gone
status     show the state and what inhibits motion
quit       stop both arms, write the report, exit
help       show this list";

/// Answers on their way to the writing thread.
#[derive(Clone)]
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

/// Commands to the control thread, from the reading thread and from those that read files.
type Queue = Mutex<Producer<GivenCommand>>;

/// Queues a command with what it selects; returns the answer if it finds no room. Selections are offered in the order of their commands.
fn queue(
    give: &mut Producer<GivenCommand>,
    (number, request): (u64, OperatorRequest),
    chosen: Option<(&Selections, Choice)>,
) -> Option<String> {
    let selections = chosen.as_ref().map(|(selections, _)| *selections);
    let offer = chosen.map(|(selections, choice)| selections.offer(choice));
    if give.push(GivenCommand { number, request, offer }).is_ok() {
        return None;
    }
    if let (Some(selections), Some(offer)) = (selections, offer) {
        selections.withdraw(offer);
    }
    Some(format!("{} refused: {COMMANDS_MAX} commands are waiting; repeat it", request.command.name()))
}

/// The reading thread.
pub(super) struct Reading {
    clock: Arc<dyn Clock>,
    queue: Arc<Queue>,
    answers: Answers,
    shared: Arc<Shared>,
    interrupt: Arc<AtomicBool>,
    /// `None` if the target cannot be chosen here.
    targets: Option<ConsoleTargets>,
    /// Number of commands typed.
    commands: u64,
    /// Number of files that are being read.
    files: Arc<AtomicUsize>,
}

impl Reading {
    pub(super) fn new(
        (clock, shared): (Arc<dyn Clock>, Arc<Shared>),
        (give, say): (Producer<GivenCommand>, SyncSender<String>),
        (interrupt, targets): (Arc<AtomicBool>, Option<ConsoleTargets>),
    ) -> Self {
        let queue = Arc::new(Mutex::new(give));
        let answers = Answers { say, left_out: 0 };
        Self { clock, queue, answers, shared, interrupt, targets, commands: 0, files: Arc::default() }
    }
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
    pub(super) fn read(mut self, mut lines: impl BufRead) {
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
        if !line.is_empty() {
            // Before the command: no step may see the command and believe that nobody has typed.
            self.shared.has_typed.store(true, Ordering::SeqCst);
        }
        let answer = match (command_of(line), without_escape_sequences(line).trim()) {
            (None, text) if text.starts_with("select ") => self.select(text["select ".len()..].trim()),
            (Some(OperatorCommand::Select), _) => self.select_of_setup(),
            (Some(command), _) => self.say(command, None),
            (None, "status") => Some(self.status()),
            (None, "help" | "?") => Some(HELP.to_owned()),
            (None, "quit") => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("stopping both arms, then writing the report".to_owned())
            }
            (None, "") => None,
            (None, other) => Some(format!("unknown command {other:?}: {COMMANDS_HELP}")),
        };
        if let Some(answer) = answer {
            self.answers.give(answer);
        }
    }

    /// Selects the target that the setup names.
    fn select_of_setup(&mut self) -> Option<String> {
        match &self.targets {
            None => self.say(OperatorCommand::Select, None),
            Some(targets) if targets.selections.target_of_setup().is_none() => Some(NO_TARGET.to_owned()),
            Some(_) => self.say(OperatorCommand::Select, Some(Choice::OfSetup)),
        }
    }

    /// Selects the target in this region.
    fn select(&mut self, region: &str) -> Option<String> {
        let Some(ConsoleTargets { size, .. }) = self.targets else {
            return Some("select refused: this run has no images in which a target can be chosen".to_owned());
        };
        let spec = region.parse::<RegionSpec>().and_then(|spec| spec.check_inside(size).map(|()| spec));
        match spec {
            Ok(spec @ RegionSpec::Mask(_)) => self.select_mask(spec),
            Ok(spec) => match load_region(&spec, size) {
                Ok(region) => {
                    let selection = Selection { region, drawn_on: None, model: None };
                    self.say(OperatorCommand::Select, Some(Choice::Marked(selection)))
                }
                Err(why) => Some(format!("select refused: {why:#}")),
            },
            Err(why) => Some(format!("select refused: {why}")),
        }
    }

    /// Reads a mask on a thread of its own: a file of a network may not answer at all.
    fn select_mask(&mut self, spec: RegionSpec) -> Option<String> {
        if let Some(refused) = self.refused_while_reading(OperatorCommand::Select) {
            return Some(refused);
        }
        let ConsoleTargets { size, selections } = self.targets.clone()?;
        if self.files.load(Ordering::SeqCst) >= FILES_MAX {
            return Some(format!("select refused: {FILES_MAX} files do not answer; use rect:, poly: or click:"));
        }
        self.commands += 1;
        let (number, at) = (self.commands, self.clock.now());
        self.shared.reading.store(number, Ordering::SeqCst);
        self.files.fetch_add(1, Ordering::SeqCst);
        let (files, waiting, shared) = (Arc::clone(&self.files), Arc::clone(&self.queue), Arc::clone(&self.shared));
        let mut answers = self.answers.clone();
        answers.left_out = 0;
        let read = move || {
            let region = load_region(&spec, size);
            files.fetch_sub(1, Ordering::SeqCst);
            // With the lock, commands that are typed from now on come behind this one.
            let mut give = waiting.lock().unwrap_or_else(PoisonError::into_inner);
            // A `stop` or `hold` may have overtaken it, and has answered.
            if shared.reading.compare_exchange(number, 0, Ordering::SeqCst, Ordering::SeqCst).is_err() {
                return;
            }
            let request = OperatorRequest { command: OperatorCommand::Select, at };
            let answer = match region {
                Ok(region) => {
                    let choice = Choice::Marked(Selection { region, drawn_on: None, model: None });
                    queue(&mut give, (number, request), Some((&selections, choice)))
                }
                Err(why) => Some(format!("select refused: {why:#}")),
            };
            drop(give);
            if let Some(answer) = answer {
                answers.give(answer);
            }
        };
        match Builder::new().name("mask".to_owned()).spawn(read) {
            Ok(_) => None,
            Err(error) => {
                self.files.fetch_sub(1, Ordering::SeqCst);
                self.shared.reading.store(0, Ordering::SeqCst);
                Some(format!("select refused: no thread to read the mask: {error}"))
            }
        }
    }

    /// Refusal of a command whose target may be that of a file that is still being read.
    fn refused_while_reading(&self, command: OperatorCommand) -> Option<String> {
        let is_reading = self.shared.reading.load(Ordering::SeqCst) != 0;
        let text = || format!("{} refused: the mask of the last select is still being read; repeat it", command.name());
        (is_reading && !command.ends_motion()).then(text)
    }

    /// A part of a line that is too long: only `stop` and `hold` are obeyed, once for each line.
    fn take_part(&mut self, part: &str, (is_rest, obeyed): (bool, &mut Option<OperatorCommand>)) {
        self.shared.has_typed.store(true, Ordering::SeqCst);
        let answer = match cautious_command_of(part) {
            Some(command) if *obeyed != Some(command) && *obeyed != Some(OperatorCommand::Stop) => {
                *obeyed = Some(command);
                self.say(command, None)
            }
            None if !is_rest => Some(format!("the line is longer than {LINE_MAX} bytes: {COMMANDS_HELP}")),
            _ => None,
        };
        if let Some(answer) = answer {
            self.answers.give(answer);
        }
    }

    fn say(&mut self, command: OperatorCommand, choice: Option<Choice>) -> Option<String> {
        if let Some(refused) = self.refused_while_reading(command) {
            return Some(refused);
        }
        if !self.shared.has_begun.load(Ordering::SeqCst) {
            return self.say_early(command, choice);
        }
        self.give(command, choice)
    }

    /// Handles a command while both arms are being enabled. `stop` aborts enabling and ends the run. Commands that cause no motion are
    /// queued. Commands that could cause motion are refused, because the operator refers to the present state.
    fn say_early(&mut self, command: OperatorCommand, choice: Option<Choice>) -> Option<String> {
        match command {
            OperatorCommand::Stop => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("enabling aborted: stopping both arms, then writing the report".to_owned())
            }
            OperatorCommand::Select | OperatorCommand::Hold | OperatorCommand::HoldHand => Some(
                self.give(command, choice)
                    .unwrap_or_else(|| format!("{} is queued until both arms are enabled", command.name())),
            ),
            OperatorCommand::Start | OperatorCommand::Resume | OperatorCommand::Realign | OperatorCommand::Reset => {
                Some(format!(
                    "{} refused: both arms are still being enabled; repeat it when they are enabled",
                    command.name()
                ))
            }
        }
    }

    fn give(&mut self, command: OperatorCommand, choice: Option<Choice>) -> Option<String> {
        let request = OperatorRequest { command, at: self.clock.now() };
        self.commands += 1;
        let slot = match command {
            OperatorCommand::Stop => &self.shared.stop,
            OperatorCommand::Hold => &self.shared.hold,
            OperatorCommand::HoldHand => &self.shared.hold_hand,
            _ => {
                let chosen = self.targets.as_ref().map(|targets| &targets.selections).zip(choice);
                let mut give = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
                return queue(&mut give, (self.commands, request), chosen);
            }
        };
        slot.say(self.commands, request.at);
        // If its command is in the queue already, the control thread drops and answers it.
        let is_reading = self.shared.reading.swap(0, Ordering::SeqCst) != 0;
        is_reading.then(|| format!("select not done: overtaken by {}; the mask is not used", command.name()))
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
