//! Who tells a run what to do: the command itself, or a person at a console.

use std::io::{BufRead, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::{Decision, OperatorInput, Said, State, Word};

/// Words that were typed and that no control step has taken yet.
const WORDS_MAX: usize = 16;

/// What a console answers to a line that is none of its words.
const WORDS: &str = "known are select, start, hold, resume, stop, reset, status and quit";

/// Who tells a run what to do. The thread that moves the arms asks: nothing here waits.
pub trait Operator: Send {
    /// A word that was not handed over before, and the last sign of life; `last` is what the supervisor decided before.
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput;

    /// What the supervisor decided in this step.
    fn show(&mut self, decision: &Decision);

    /// Something that a person has to know, an arm that can not be reset, say; or that there is nothing any more.
    fn tell(&mut self, trouble: Option<String>);

    /// Whether a person speaks: who can reset what is latched, and without whose start the target does not move either.
    fn is_person(&self) -> bool;
}

/// The command is the operator: it selects the target and starts as soon as it can, once, and never resets or resumes. It is there as
/// long as it runs.
#[derive(Clone, Copy, Debug)]
pub struct ByCommand;

impl Operator for ByCommand {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let word = match last {
            None => Some(Word::Select),
            Some(decision) if decision.state == State::Selecting && decision.is_ready => Some(Word::Start),
            Some(_) => None,
        };
        OperatorInput { said: word.map(|word| Said { word, at: now }), heard_at: Some(now) }
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, _trouble: Option<String>) {}

    fn is_person(&self) -> bool {
        false
    }
}

/// A person who types words, one on each line, as long as the lines do not end.
pub struct Console {
    words: Receiver<Said>,
    shared: Arc<Shared>,
    heard_at: Option<MonotonicTime>,
}

/// What both threads of a console know.
#[derive(Default)]
struct Shared {
    is_closed: AtomicBool,
    shown: Mutex<Shown>,
}

#[derive(Clone, Default)]
struct Shown {
    decision: Option<Decision>,
    trouble: Option<String>,
}

impl Console {
    /// Reads `lines` on a thread of its own and writes its answers to `answers`; the word `quit` sets `interrupt`.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(
        clock: Arc<dyn Clock>,
        lines: impl BufRead + Send + 'static,
        answers: impl Write + Send + 'static,
        interrupt: Arc<AtomicBool>,
    ) -> Result<Self> {
        let (give, words) = sync_channel(WORDS_MAX);
        let shared = Arc::new(Shared::default());
        let reading = Reading { clock, give, shared: Arc::clone(&shared), interrupt };
        let read = move || reading.read(lines, answers);
        std::thread::Builder::new().name("console".to_owned()).spawn(read).context("no thread for the console")?;
        Ok(Self { words, shared, heard_at: None })
    }
}

impl Operator for Console {
    fn listen(&mut self, _last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        // A console that is open is the sign of life; a person who types nothing has nothing to say.
        if !self.shared.is_closed.load(Ordering::SeqCst) {
            self.heard_at = Some(now);
        }
        OperatorInput { said: self.words.try_recv().ok(), heard_at: self.heard_at }
    }

    fn show(&mut self, decision: &Decision) {
        // Who reads it now has one that is a step old.
        if let Ok(mut shown) = self.shared.shown.try_lock() {
            shown.decision = Some(*decision);
        }
    }

    fn tell(&mut self, trouble: Option<String>) {
        // Both arms rest when there is trouble: here a wait is allowed.
        self.shared.shown.lock().unwrap_or_else(PoisonError::into_inner).trouble = trouble;
    }

    fn is_person(&self) -> bool {
        true
    }
}

/// The thread that reads.
struct Reading {
    clock: Arc<dyn Clock>,
    give: SyncSender<Said>,
    shared: Arc<Shared>,
    interrupt: Arc<AtomicBool>,
}

impl Reading {
    /// Until the lines end: from then on the operator is silent.
    fn read(&self, lines: impl BufRead, mut answers: impl Write) {
        for line in lines.lines().map_while(Result::ok) {
            if let Some(answer) = self.answer(line.trim()) {
                // Who does not read the answers can still type.
                let _ = writeln!(answers, "{answer}").and_then(|()| answers.flush());
            }
        }
        self.shared.is_closed.store(true, Ordering::SeqCst);
    }

    fn answer(&self, line: &str) -> Option<String> {
        let word = Word::ALL.into_iter().find(|word| word.name() == line);
        match (word, line) {
            (Some(word), _) => {
                let said = Said { word, at: self.clock.now() };
                self.give.try_send(said).is_err().then(|| format!("{line} was not taken: too many words wait"))
            }
            (None, "status") => Some(self.status()),
            (None, "quit") => {
                self.interrupt.store(true, Ordering::SeqCst);
                Some("both arms stop, then the report".to_owned())
            }
            (None, "") => None,
            (None, other) => Some(format!("{other:?} is no word: {WORDS}")),
        }
    }

    fn status(&self) -> String {
        let Shown { decision, trouble } = self.shared.shown.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let why = decision.map_or_else(|| "not begun yet".to_owned(), |decision| decision.why.to_string());
        match trouble {
            Some(trouble) => format!("{why}\n{trouble}"),
            None => why,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Sender, channel};

    use pb3dp_hal_clock::VirtualClock;

    use super::*;

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

    #[test]
    fn a_console_hands_words_over_in_order_and_is_silent_behind_its_end() {
        let clock = Arc::new(VirtualClock::new());
        clock.sleep_until(MonotonicTime::from_nanos(5));
        let interrupt = Arc::new(AtomicBool::new(false));
        let (written, answers) = channel();
        let lines = "select\n start \n\nstatus\ngo\nquit\n".as_bytes();
        let mut console = Console::start(clock, lines, Written(written), Arc::clone(&interrupt)).unwrap();
        let text: String = answers.iter().collect();
        assert!(text.contains("not begun yet\n") && text.contains("\"go\" is no word: known are select"), "{text}");
        assert!(interrupt.load(Ordering::SeqCst));
        while !console.shared.is_closed.load(Ordering::SeqCst) {
            std::thread::yield_now();
        }
        let now = MonotonicTime::from_nanos(9);
        let heard = [0, 1, 2].map(|_| console.listen(None, now));
        let words = heard.map(|input| input.said.map(|said| (said.word, said.at)));
        let at = MonotonicTime::from_nanos(5);
        assert_eq!(words, [Some((Word::Select, at)), Some((Word::Start, at)), None]);
        assert_eq!(heard[2].heard_at, None, "it ended before it was ever asked");
    }

    #[test]
    fn an_open_console_is_a_sign_of_life() {
        let (reader, writer) = std::io::pipe().unwrap();
        let lines = std::io::BufReader::new(reader);
        let clock = Arc::new(VirtualClock::new());
        let mut console = Console::start(clock, lines, std::io::sink(), Arc::default()).unwrap();
        let now = MonotonicTime::from_nanos(7);
        assert_eq!(console.listen(None, now), OperatorInput { said: None, heard_at: Some(now) });
        drop(writer);
        while !console.shared.is_closed.load(Ordering::SeqCst) {
            std::thread::yield_now();
        }
        let later = MonotonicTime::from_nanos(70);
        assert_eq!(console.listen(None, later).heard_at, Some(now));
    }
}
