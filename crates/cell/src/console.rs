//! Operator console: commands are read on one thread and answers written on another, so the thread that moves the arms waits for neither.

use std::io::{BufRead, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest};
use rtrb::{Consumer, Producer, RingBuffer};

use super::operator::Operator;

/// Commands that no control step has taken yet; `stop` and `hold` need no space in this queue.
const WORDS_MAX: usize = 16;
/// Answers that are not written yet.
const ANSWERS_MAX: usize = 64;
/// Longest accepted line, bytes.
const LINE_MAX: u64 = 256;
/// Time between two read attempts on a non-blocking input.
const READ_AGAIN: Duration = Duration::from_millis(10);
/// Time between two checks for results of commands; an operator does not notice it.
const RESULTS_EVERY: Duration = Duration::from_millis(50);

/// Part of the answer to an unknown command.
const WORDS: &str = "use select, start, hold, resume, stop, reset, status, help or quit";

/// Answer to `help`.
const HELP: &str = "\
select   initialise the marked target
start    follow the target with the hand
hold     hold both arms; resume continues
resume   continue after a hold
stop     stop both arms and close the brakes; reset leaves this state
reset    clear a stop or a fault after its cause is gone
status   show the state and what inhibits motion
quit     stop both arms, write the report, exit
help     show this list";

/// Operator commands from a console, one on each line. The end of the input ends the run, as `quit` does.
pub struct Console {
    /// Each command with its number.
    words: Consumer<(u64, OperatorRequest)>,
    shared: Arc<Shared>,
    heard_at: Option<MonotonicTime>,
    /// Time at which commands were first accepted; commands queued before are stamped with it.
    begun_at: Option<MonotonicTime>,
    /// Commands up to this number precede a `stop` or `hold` that was taken, and are dropped.
    overtaken: u64,
    /// The command that this control step obeys or refuses.
    commanded: Option<OperatorCommand>,
    /// Results of commands, for the answering thread.
    results: Producer<(OperatorCommand, Decision)>,
    /// Trouble not shown yet because the reader held the lock.
    untold: Option<Option<String>>,
}

/// State shared by the threads of a console.
#[derive(Default)]
struct Shared {
    is_closed: AtomicBool,
    /// Commands are accepted: both arms are enabled.
    has_begun: AtomicBool,
    stop: Urgent,
    hold: Urgent,
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
        (interrupt, prompt): (Arc<AtomicBool>, &'static str),
    ) -> Result<Self> {
        let (give, words) = RingBuffer::new(WORDS_MAX);
        let (say, said) = sync_channel(ANSWERS_MAX);
        let (results, decided) = RingBuffer::new(WORDS_MAX);
        let shared = Arc::new(Shared::default());
        let write = move || write_all(&said, decided, answers, prompt);
        Builder::new().name("answers".to_owned()).spawn(write).context("no thread for the answers of the console")?;
        let reading = Reading {
            clock,
            give,
            answers: Answers { say, left_out: 0 },
            shared: Arc::clone(&shared),
            interrupt,
            words: 0,
        };
        let read = move || reading.read(lines);
        Builder::new().name("console".to_owned()).spawn(read).context("no thread for the console")?;
        Ok(Self { words, shared, heard_at: None, begun_at: None, overtaken: 0, commanded: None, results, untold: None })
    }

    fn next_word(&mut self) -> Option<OperatorRequest> {
        for (urgent, word) in [(&self.shared.stop, OperatorCommand::Stop), (&self.shared.hold, OperatorCommand::Hold)] {
            if let Some((number, at)) = urgent.take() {
                self.overtaken = self.overtaken.max(number);
                return Some(OperatorRequest { word, at });
            }
        }
        while let Ok((number, said)) = self.words.pop() {
            if number > self.overtaken {
                return Some(said);
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
    fn listen(&mut self, _last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let begun_at = *self.begun_at.get_or_insert(now);
        self.shared.has_begun.store(true, Ordering::SeqCst);
        // An open console counts as a sign of life, even while the operator types nothing.
        if !self.shared.is_closed.load(Ordering::SeqCst) {
            self.heard_at = Some(now);
        }
        let said = self.next_word().map(|said| OperatorRequest { at: said.at.max(begun_at), ..said });
        self.commanded = said.map(|said| said.word);
        OperatorInput { said, heard_at: self.heard_at }
    }

    fn show(&mut self, decision: &Decision) {
        if let Some(command) = self.commanded.take() {
            // More results than anybody reads are dropped; the log has all.
            let _ = self.results.push((command, *decision));
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

    fn is_person(&self) -> bool {
        true
    }
}

/// The result of a command.
fn result_of(command: OperatorCommand, decision: &Decision) -> String {
    match (&decision.refused, &decision.transition) {
        (Some(refused), _) => refused.to_string(),
        (None, Some(transition)) => format!("{}: {}", command.name(), transition.to),
        (None, None) => format!("{}: no change, the state is {}", command.name(), decision.state),
    }
}

/// Writes answers until all senders are dropped; write errors are ignored.
fn write_all(
    said: &Receiver<String>,
    mut results: Consumer<(OperatorCommand, Decision)>,
    mut answers: impl Write,
    prompt: &str,
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
        while let Ok((command, decision)) = results.pop() {
            answer(&result_of(command, &decision));
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

/// The command of a line. `stop` and `hold` are recognised by the first word in any case and with any punctuation, because an operator
/// in a hurry types `STOP!`; a command that can cause motion must be exact.
fn command_of(line: &str) -> Option<OperatorCommand> {
    let first = line.split(|c: char| !c.is_alphabetic()).find(|word| !word.is_empty()).unwrap_or_default();
    let is_cautious = |command: &OperatorCommand| {
        matches!(command, OperatorCommand::Stop | OperatorCommand::Hold) && command.name().eq_ignore_ascii_case(first)
    };
    OperatorCommand::ALL.into_iter().find(|command| command.name() == line || is_cautious(command))
}

impl Reading {
    /// Reads until the input ends.
    fn read(mut self, mut lines: impl BufRead) {
        let mut line = Vec::new();
        let mut is_rest = false;
        loop {
            match lines.by_ref().take(LINE_MAX).read_until(b'\n', &mut line) {
                Ok(0) => break,
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    std::thread::sleep(READ_AGAIN);
                    continue;
                }
                Err(_) => break,
            }
            let is_whole = line.ends_with(b"\n") || (line.len() as u64) < LINE_MAX;
            if is_rest {
                is_rest = !is_whole;
            } else if is_whole {
                self.take(String::from_utf8_lossy(&line).trim());
            } else {
                is_rest = true;
                self.answers.give(format!("the line is longer than {LINE_MAX} bytes: {WORDS}"));
            }
            line.clear();
        }
        if !self.interrupt.load(Ordering::SeqCst) {
            self.answers.give("end of input: stopping both arms, then writing the report".to_owned());
        }
    }

    fn take(&mut self, line: &str) {
        let answer = match (command_of(line), line) {
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
            OperatorCommand::Select | OperatorCommand::Hold => Some(
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
mod tests {
    use std::io::{BufReader, PipeWriter, pipe};
    use std::path::Path;
    use std::sync::mpsc::{Sender, channel};
    use std::time::Instant;

    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_servo::Mode;
    use pb3dp_servo::supervisor::{ArmCondition, ArmInput, Innovation, Inputs, Supervisor};
    use pb3dp_setup::setup::read_setup;

    use super::*;

    const NOW: MonotonicTime = MonotonicTime::from_nanos(9);

    /// Collects the written answers, one by one.
    struct Written(Sender<String>);

    impl Write for Written {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.send(String::from_utf8_lossy(bytes).into_owned()).ok();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// A console with the given input, its answers, and its interrupt flag.
    fn console(lines: impl BufRead + Send + 'static) -> (Console, Receiver<String>, Arc<AtomicBool>) {
        let (written, answers) = channel();
        let interrupt = Arc::new(AtomicBool::new(false));
        let clock = Arc::new(VirtualClock::new());
        clock.sleep_until(MonotonicTime::from_nanos(5));
        (Console::start(clock, lines, Written(written), (Arc::clone(&interrupt), "")).unwrap(), answers, interrupt)
    }

    fn typed() -> (BufReader<std::io::PipeReader>, PipeWriter) {
        let (reader, writer) = pipe().unwrap();
        (BufReader::new(reader), writer)
    }

    fn wait_until(what: impl Fn() -> bool) {
        let begin = Instant::now();
        while !what() {
            assert!(begin.elapsed() < Duration::from_secs(30));
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn decision() -> Decision {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let config = read_setup(Path::new(file)).unwrap().supervisor;
        let inputs = Inputs {
            operator: OperatorInput::default(),
            controller: Mode::Idle,
            innovation: Innovation::NoneNew,
            estimate: None,
            frame: None,
            range_end: None,
            smallest_singular_value: None,
            arms: [ArmInput { state: ArmCondition::Disabled, measured_at: None }; 2],
        };
        Supervisor::new(config).unwrap().step(&inputs, NOW)
    }

    fn word(console: &mut Console) -> Option<OperatorCommand> {
        console.listen(None, NOW).said.map(|said| said.word)
    }

    /// As [`console`], with both arms enabled; also returns the writer for commands.
    fn begun() -> (Console, PipeWriter, Receiver<String>, Arc<AtomicBool>) {
        let (lines, writer) = typed();
        let (mut console, answers, interrupt) = console(lines);
        assert_eq!(console.listen(None, NOW).said, None);
        (console, writer, answers, interrupt)
    }

    #[test]
    fn a_console_hands_words_over_in_order_and_ends_the_run_behind_its_end() {
        let (mut console, mut writer, answers, interrupt) = begun();
        write!(writer, "select\n start \n\nstatus\ngo\nresume").unwrap();
        drop(writer);
        let text: String = answers.iter().collect();
        assert!(text.contains("not started yet") && text.contains("unknown command \"go\": use select"), "{text}");
        assert!(text.ends_with("end of input: stopping both arms, then writing the report\n"), "{text}");
        wait_until(|| interrupt.load(Ordering::SeqCst) && console.shared.is_closed.load(Ordering::SeqCst));
        let later = MonotonicTime::from_nanos(70);
        let heard = [0; 4].map(|_| console.listen(None, later));
        let words = heard.map(|input| input.said.map(|said| (said.word, said.at)));
        assert_eq!(
            words,
            [
                Some((OperatorCommand::Select, NOW)),
                Some((OperatorCommand::Start, NOW)),
                Some((OperatorCommand::Resume, NOW)),
                None
            ]
        );
        assert_eq!(heard[2].heard_at, Some(NOW), "a closed console gives no sign of life");
    }

    #[test]
    fn a_stop_typed_in_a_hurry_is_a_stop_and_a_start_must_be_exact() {
        use OperatorCommand::{Hold, Start, Stop};
        for line in ["stop", "STOP", "Stop!", "stop now", "stop.", "  stop", "!stop"] {
            assert_eq!(command_of(line), Some(Stop), "{line:?}");
        }
        assert_eq!(["Hold", "HOLD it", "hold"].map(command_of), [Some(Hold); 3]);
        assert_eq!(command_of("start"), Some(Start));
        for line in ["START", "start now", "start.", "Resume", "reset!", "stopping", "do not stop", "restart", ""] {
            assert_eq!(command_of(line), None, "{line:?}");
        }
    }

    #[test]
    fn every_command_gets_its_result_as_an_answer() {
        let (mut console, mut writer, answers, _) = begun();
        writeln!(writer, "start").unwrap();
        wait_until(|| !console.words.is_empty());
        assert_eq!(word(&mut console), Some(OperatorCommand::Start));
        let unchanged = decision();
        assert_eq!((unchanged.refused, unchanged.transition), (None, None));
        console.show(&unchanged);
        // A step without a command has no result.
        console.show(&unchanged);
        drop((console, writer));
        let text: String = answers.iter().collect();
        assert!(text.contains("start: no change, the state is idle\n"), "{text}");
        assert_eq!(text.matches("no change").count(), 1, "{text}");
    }

    #[test]
    fn words_that_are_said_while_the_arms_are_switched_on_are_kept_or_refused_at_once() {
        let (lines, mut writer) = typed();
        let (mut console, answers, interrupt) = console(lines);
        writeln!(writer, "start\nselect\nresume\nreset\nstatus\nhold\nselect").unwrap();
        let mut text = String::new();
        while text.matches("queued").count() < 3 {
            text += &answers.recv().unwrap();
        }
        for word in ["start", "resume", "reset"] {
            let refusal = format!("{word} refused: both arms are still being enabled");
            assert!(text.contains(&refusal), "{text}");
        }
        assert!(text.contains("not started yet: both arms are being enabled"), "{text}");
        // Ten seconds later: each command is stamped now, and hold has overtaken the first select.
        let later = NOW + Duration::from_secs(10);
        let words = [0; 3].map(|_| console.listen(None, later).said.map(|said| (said.word, said.at)));
        assert_eq!(words, [Some((OperatorCommand::Hold, later)), Some((OperatorCommand::Select, later)), None]);
        assert!(!interrupt.load(Ordering::SeqCst));
        // From now on each command counts at the time of its input.
        writeln!(writer, "start").unwrap();
        wait_until(|| !console.words.is_empty());
        assert_eq!(word(&mut console), Some(OperatorCommand::Start));
    }

    #[test]
    fn stop_breaks_off_the_switching_on_of_both_arms() {
        let (lines, mut writer) = typed();
        let (_console, answers, interrupt) = console(lines);
        writeln!(writer, "stop").unwrap();
        assert!(answers.recv().unwrap().contains("enabling aborted"));
        wait_until(|| interrupt.load(Ordering::SeqCst));
    }

    #[test]
    fn an_open_console_is_a_sign_of_life() {
        let (lines, writer) = typed();
        let (mut console, _answers, interrupt) = console(lines);
        assert_eq!(console.listen(None, NOW), OperatorInput { said: None, heard_at: Some(NOW) });
        assert!(!interrupt.load(Ordering::SeqCst));
        drop(writer);
        wait_until(|| console.shared.is_closed.load(Ordering::SeqCst));
        assert_eq!(console.listen(None, MonotonicTime::from_nanos(70)).heard_at, Some(NOW));
    }

    #[test]
    fn stop_and_hold_find_room_behind_any_number_of_words_and_overtake_them() {
        let (mut console, mut writer, answers, _) = begun();
        // More commands than the queue holds, but no more refusals than the answer queue holds.
        for _ in 0..40 {
            writeln!(writer, "start").unwrap();
        }
        writeln!(writer, "hold\nstop\nquit").unwrap();
        let mut text = String::new();
        while !text.contains("stopping both arms") {
            text += &answers.recv().unwrap();
        }
        assert!(text.contains("start refused: 16 commands are waiting"), "{text}");
        assert_eq!(
            [0; 3].map(|_| word(&mut console)),
            [Some(OperatorCommand::Stop), Some(OperatorCommand::Hold), None]
        );
        // Later commands are taken again.
        writeln!(writer, "reset").unwrap();
        wait_until(|| !console.words.is_empty());
        assert_eq!([0; 2].map(|_| word(&mut console)), [Some(OperatorCommand::Reset), None]);
    }

    #[test]
    fn bytes_that_are_no_text_and_lines_without_end_are_no_words_and_close_nothing() {
        let long = [b"x".repeat(LINE_MAX as usize), b"start\n".to_vec()].concat();
        let lines = [b"st\xffart\n\xfe\xfe\n".to_vec(), long, b"select\n".to_vec()].concat();
        let (mut console, answers, _) = console(std::io::Cursor::new(lines));
        let text: String = answers.iter().collect();
        assert!(text.contains("unknown command \"st\u{fffd}art\"") && text.contains("longer than 256 bytes"), "{text}");
        assert_eq!([0; 2].map(|_| word(&mut console)), [Some(OperatorCommand::Select), None]);
    }

    #[test]
    fn a_person_who_reads_no_answers_is_still_heard() {
        let ((lines, mut writer), (unread, full)) = (typed(), pipe().unwrap());
        let mut console = Console::start(Arc::new(VirtualClock::new()), lines, full, (Arc::default(), "")).unwrap();
        assert_eq!(word(&mut console), None);
        // More than a pipe and the answer queue hold.
        for _ in 0..4000 {
            writeln!(writer, "what is the matter with you?").unwrap();
        }
        writeln!(writer, "stop").unwrap();
        wait_until(|| console.shared.stop.number.load(Ordering::SeqCst) > 0);
        assert_eq!(word(&mut console), Some(OperatorCommand::Stop));
        // Dropped answers are reported once the output is read.
        let mut read = BufReader::new(unread).lines().map(|line| line.unwrap());
        let told = read.find(|line| {
            writeln!(writer, "status").unwrap();
            line.contains("earlier answers dropped")
        });
        assert!(told.is_some());
    }

    #[test]
    fn what_is_told_while_somebody_reads_is_shown_in_the_next_step() {
        let (lines, _writer) = typed();
        let (mut console, ..) = console(lines);
        let shared = Arc::clone(&console.shared);
        let reading = shared.shown.lock().unwrap();
        console.tell(Some("an overcurrent".to_owned()));
        drop(reading);
        assert_eq!(shared.shown.lock().unwrap().trouble, None);
        let decision = decision();
        console.show(&decision);
        assert_eq!(shared.shown.lock().unwrap().trouble.as_deref(), Some("an overcurrent"));
        let reading = shared.shown.lock().unwrap();
        console.tell(None);
        console.show(&decision);
        drop(reading);
        console.show(&decision);
        let shown = shared.shown.lock().unwrap();
        assert!(shown.trouble.is_none() && shown.decision.is_some());
    }
}
