//! A person at a console leads a run: words come in on one thread, answers go out on another, and the thread that moves the arms waits
//! for neither.

use std::io::{BufRead, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Decision, OperatorInput, Said, Word};
use rtrb::{Consumer, Producer, RingBuffer};

use super::operator::Operator;

/// Words that were typed and that no control step has taken yet; `stop` and `hold` need no room.
const WORDS_MAX: usize = 16;
/// Answers that were not read yet.
const ANSWERS_MAX: usize = 64;
/// Bytes of a line that is looked at.
const LINE_MAX: u64 = 256;
/// What a line that is not there yet is waited for, where a read does not wait by itself.
const READ_AGAIN: Duration = Duration::from_millis(10);

/// What a console answers to a line that is none of its words.
const WORDS: &str = "known are select, start, hold, resume, stop, reset, status, help and quit";

/// What `help` answers.
const HELP: &str = "\
select   initialise the target that is marked
start    let the hand follow it
hold     hold both arms; resume goes on
resume   go on after a hold
stop     stop both arms with brakes; reset leads out of it
reset    clear a stop or a fault, once its cause is gone
status   what the supervisor does, and why nothing moves
quit     stop both arms, write the report, end
help     this list";

/// A person who types words, one on each line. When the lines end, the run ends as by `quit`.
pub struct Console {
    /// Each with its number.
    words: Consumer<(u64, Said)>,
    shared: Arc<Shared>,
    heard_at: Option<MonotonicTime>,
    /// When words were listened to for the first time: those that were kept until then are said at this moment.
    begun_at: Option<MonotonicTime>,
    /// Words up to this number were said before a `stop` or `hold` that was taken: they are not said any more.
    overtaken: u64,
    /// What is not shown yet, as somebody was reading.
    untold: Option<Option<String>>,
}

/// What the threads of a console know.
#[derive(Default)]
struct Shared {
    is_closed: AtomicBool,
    /// Words are listened to: both arms are on.
    has_begun: AtomicBool,
    stop: Urgent,
    hold: Urgent,
    shown: Mutex<Shown>,
}

/// A word that always finds room: when it was said last.
#[derive(Default)]
struct Urgent {
    /// 0: it was not said since it was taken.
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
    /// Reads `lines` on a thread of its own, and writes its answers to `answers` on another one, each with `prompt` behind it; the word
    /// `quit` and the end of the lines set `interrupt`.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(
        clock: Arc<dyn Clock>,
        lines: impl BufRead + Send + 'static,
        answers: impl Write + Send + 'static,
        (interrupt, prompt): (Arc<AtomicBool>, &'static str),
    ) -> Result<Self> {
        let (give, words) = RingBuffer::new(WORDS_MAX);
        let (say, said) = sync_channel(ANSWERS_MAX);
        let shared = Arc::new(Shared::default());
        let write = move || write_all(&said, answers, prompt);
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
        Ok(Self { words, shared, heard_at: None, begun_at: None, overtaken: 0, untold: None })
    }

    fn next_word(&mut self) -> Option<Said> {
        for (urgent, word) in [(&self.shared.stop, Word::Stop), (&self.shared.hold, Word::Hold)] {
            if let Some((number, at)) = urgent.take() {
                self.overtaken = self.overtaken.max(number);
                return Some(Said { word, at });
            }
        }
        while let Ok((number, said)) = self.words.pop() {
            if number > self.overtaken {
                return Some(said);
            }
        }
        None
    }

    /// Shows it unless somebody is reading: whether that was possible.
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
        // A console that is open is the sign of life; a person who types nothing has nothing to say.
        if !self.shared.is_closed.load(Ordering::SeqCst) {
            self.heard_at = Some(now);
        }
        let said = self.next_word().map(|said| Said { at: said.at.max(begun_at), ..said });
        OperatorInput { said, heard_at: self.heard_at }
    }

    fn show(&mut self, decision: &Decision) {
        let mut untold = self.untold.take();
        // Who reads it now has one that is a step old.
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
        // The next step shows it.
        self.untold = untold;
    }

    fn is_person(&self) -> bool {
        true
    }
}

/// Writes answers until nobody has any more to give, or they cannot be written.
fn write_all(said: &Receiver<String>, mut answers: impl Write, prompt: &str) {
    if !prompt.is_empty() {
        let _ = write!(answers, "type a word; help lists them\n{prompt}").and_then(|()| answers.flush());
    }
    for answer in said {
        // Who does not read the answers can still type.
        let _ = write!(answers, "{answer}\n{prompt}").and_then(|()| answers.flush());
    }
}

/// Answers on their way to the thread that writes them.
struct Answers {
    say: SyncSender<String>,
    /// Of those before: for them there was no room.
    left_out: u64,
}

impl Answers {
    fn give(&mut self, answer: String) {
        let text = match self.left_out {
            0 => answer,
            left_out => format!("({left_out} answers before are left out: nobody has read them)\n{answer}"),
        };
        self.left_out = if self.say.try_send(text).is_ok() { 0 } else { self.left_out + 1 };
    }
}

/// The thread that reads.
struct Reading {
    clock: Arc<dyn Clock>,
    give: Producer<(u64, Said)>,
    answers: Answers,
    shared: Arc<Shared>,
    interrupt: Arc<AtomicBool>,
    /// How many were typed.
    words: u64,
}

impl Drop for Reading {
    /// However reading ends: nobody can speak any more, so both arms stop.
    fn drop(&mut self) {
        self.shared.is_closed.store(true, Ordering::SeqCst);
        self.interrupt.store(true, Ordering::SeqCst);
    }
}

impl Reading {
    /// Until the lines end.
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
                self.answers.give(format!("a line of more than {LINE_MAX} bytes is no word: {WORDS}"));
            }
            line.clear();
        }
        if !self.interrupt.load(Ordering::SeqCst) {
            self.answers.give("the words have ended: both arms stop, then the report".to_owned());
        }
    }

    fn take(&mut self, line: &str) {
        let word = Word::ALL.into_iter().find(|word| word.name() == line);
        let answer = match (word, line) {
            (Some(word), _) => self.say(word),
            (None, "status") => Some(self.status()),
            (None, "help" | "?") => Some(HELP.to_owned()),
            (None, "quit") => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("both arms stop, then the report".to_owned())
            }
            (None, "") => None,
            (None, other) => Some(format!("{other:?} is no word: {WORDS}")),
        };
        if let Some(answer) = answer {
            self.answers.give(answer);
        }
    }

    fn say(&mut self, word: Word) -> Option<String> {
        if !self.shared.has_begun.load(Ordering::SeqCst) {
            return self.say_early(word);
        }
        self.give(word)
    }

    /// While both arms are still being switched on: `stop` ends that, and so the run; what leads to no motion is kept until somebody
    /// listens, and what could is refused, as who says it means what is seen now.
    fn say_early(&mut self, word: Word) -> Option<String> {
        match word {
            Word::Stop => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("both arms are still being switched on: that is broken off, both stop, then the report".to_owned())
            }
            Word::Select | Word::Hold => Some(
                self.give(word)
                    .unwrap_or_else(|| format!("{} is kept: both arms are still being switched on", word.name())),
            ),
            Word::Start | Word::Resume | Word::Reset => Some(format!(
                "{} was not taken: both arms are still being switched on; say it again when that is done",
                word.name()
            )),
        }
    }

    fn give(&mut self, word: Word) -> Option<String> {
        let said = Said { word, at: self.clock.now() };
        self.words += 1;
        match word {
            Word::Stop => self.shared.stop.say(self.words, said.at),
            Word::Hold => self.shared.hold.say(self.words, said.at),
            _ if self.give.push((self.words, said)).is_err() => {
                return Some(format!("{} was not taken: too many words wait", word.name()));
            }
            _ => {}
        }
        None
    }

    fn status(&self) -> String {
        let Shown { decision, trouble } = self.shared.shown.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let why = decision.map_or_else(
            || "not begun yet: both arms are being switched on".to_owned(),
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

    /// What was written, line by line.
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

    /// A console whose lines are at an end or not, with what it answers, and whether the run is to end.
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

    fn word(console: &mut Console) -> Option<Word> {
        console.listen(None, NOW).said.map(|said| said.word)
    }

    /// As [`console`], where both arms are on; behind it the words, if there are any.
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
        assert!(text.contains("not begun yet") && text.contains("\"go\" is no word: known are select"), "{text}");
        assert!(text.ends_with("the words have ended: both arms stop, then the report\n"), "{text}");
        wait_until(|| interrupt.load(Ordering::SeqCst) && console.shared.is_closed.load(Ordering::SeqCst));
        let later = MonotonicTime::from_nanos(70);
        let heard = [0; 4].map(|_| console.listen(None, later));
        let words = heard.map(|input| input.said.map(|said| (said.word, said.at)));
        assert_eq!(words, [Some((Word::Select, NOW)), Some((Word::Start, NOW)), Some((Word::Resume, NOW)), None]);
        assert_eq!(heard[2].heard_at, Some(NOW), "nobody was there when it was asked again");
    }

    #[test]
    fn words_that_are_said_while_the_arms_are_switched_on_are_kept_or_refused_at_once() {
        let (lines, mut writer) = typed();
        let (mut console, answers, interrupt) = console(lines);
        writeln!(writer, "start\nselect\nresume\nreset\nstatus\nhold\nselect").unwrap();
        let mut text = String::new();
        while text.matches("kept").count() < 3 {
            text += &answers.recv().unwrap();
        }
        for word in ["start", "resume", "reset"] {
            let refusal = format!("{word} was not taken: both arms are still being switched on");
            assert!(text.contains(&refusal), "{text}");
        }
        assert!(text.contains("not begun yet: both arms are being switched on"), "{text}");
        // Ten seconds later; each word is one of this moment, and hold has overtaken the first select.
        let later = NOW + Duration::from_secs(10);
        let words = [0; 3].map(|_| console.listen(None, later).said.map(|said| (said.word, said.at)));
        assert_eq!(words, [Some((Word::Hold, later)), Some((Word::Select, later)), None]);
        assert!(!interrupt.load(Ordering::SeqCst));
        // From now on words count as they are said.
        writeln!(writer, "start").unwrap();
        wait_until(|| !console.words.is_empty());
        assert_eq!(word(&mut console), Some(Word::Start));
    }

    #[test]
    fn stop_breaks_off_the_switching_on_of_both_arms() {
        let (lines, mut writer) = typed();
        let (_console, answers, interrupt) = console(lines);
        writeln!(writer, "stop").unwrap();
        assert!(answers.recv().unwrap().contains("that is broken off"));
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
        // More than there is room for, and no more refusals than answers find room.
        for _ in 0..40 {
            writeln!(writer, "start").unwrap();
        }
        writeln!(writer, "hold\nstop\nquit").unwrap();
        let mut text = String::new();
        while !text.contains("both arms stop") {
            text += &answers.recv().unwrap();
        }
        assert!(text.contains("start was not taken: too many words wait"), "{text}");
        assert_eq!([0; 3].map(|_| word(&mut console)), [Some(Word::Stop), Some(Word::Hold), None]);
        // What is said afterwards is heard again.
        writeln!(writer, "reset").unwrap();
        wait_until(|| !console.words.is_empty());
        assert_eq!([0; 2].map(|_| word(&mut console)), [Some(Word::Reset), None]);
    }

    #[test]
    fn bytes_that_are_no_text_and_lines_without_end_are_no_words_and_close_nothing() {
        let long = [b"x".repeat(LINE_MAX as usize), b"start\n".to_vec()].concat();
        let lines = [b"st\xffart\n\xfe\xfe\n".to_vec(), long, b"select\n".to_vec()].concat();
        let (mut console, answers, _) = console(std::io::Cursor::new(lines));
        let text: String = answers.iter().collect();
        assert!(text.contains("\"st\u{fffd}art\" is no word") && text.contains("more than 256 bytes"), "{text}");
        assert_eq!([0; 2].map(|_| word(&mut console)), [Some(Word::Select), None]);
    }

    #[test]
    fn a_person_who_reads_no_answers_is_still_heard() {
        let ((lines, mut writer), (unread, full)) = (typed(), pipe().unwrap());
        let mut console = Console::start(Arc::new(VirtualClock::new()), lines, full, (Arc::default(), "")).unwrap();
        assert_eq!(word(&mut console), None);
        // More than a pipe and the queue of answers hold.
        for _ in 0..4000 {
            writeln!(writer, "what is the matter with you?").unwrap();
        }
        writeln!(writer, "stop").unwrap();
        wait_until(|| console.shared.stop.number.load(Ordering::SeqCst) > 0);
        assert_eq!(word(&mut console), Some(Word::Stop));
        // What was left out is told as soon as somebody reads.
        let mut read = BufReader::new(unread).lines().map(|line| line.unwrap());
        let told = read.find(|line| {
            writeln!(writer, "status").unwrap();
            line.contains("answers before are left out")
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
