//! A person beside an arm that is not emulated and moves by a command of its own, not by a run: everything that means "stop" ends the
//! motion, and so does silence.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::Builder;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::Cause;

pub use super::person::ends_motion;
use super::person::{KeyRequest, silence};
use super::terminal::EscapeEndsLine;

/// Interval at which the silence is measured while nothing is typed.
const LOOK: Duration = Duration::from_millis(50);

/// Question to a person who types nothing while an arm moves.
const ASK: &str = "are you there? press Enter now, or the motion ends (operator_silent)";

/// Why a motion ended before its end.
#[derive(Clone, Debug, PartialEq)]
pub enum EndedByPerson {
    /// This line was typed.
    Typed(String),
    /// Nobody can type any more.
    EndOfInput,
    /// Nobody has pressed a key in time.
    Silent(Cause),
}

impl std::fmt::Display for EndedByPerson {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Typed(line) => write!(f, "ended by {line:?}, which was typed"),
            Self::EndOfInput => write!(f, "ended by the end of standard input: Ctrl-D, or a terminal that was closed"),
            Self::Silent(cause) => write!(
                f,
                "operator_silent: {cause} (supervisor.operator_key_within_s); give the command again, and press Enter at least every \
                 {} s while the arm moves",
                cause.threshold
            ),
        }
    }
}

impl std::error::Error for EndedByPerson {}

/// Instructions to a person before such a motion.
pub fn instructions(key_within: Duration) -> String {
    format!(
        "While it moves, press Enter at least every {} s, or the motion ends. To stop it, type stop and Enter, or press Esc.",
        key_within.as_secs_f64()
    )
}

/// The keys of a person beside a moving arm: silence ends the motion, and a key is asked for in time.
#[derive(Clone, Copy, Debug)]
pub struct Keys {
    within: Duration,
    heartbeat_at: MonotonicTime,
    request: KeyRequest,
}

impl Keys {
    /// A person who has pressed a key now, and must press one within each such time.
    pub fn new(within: Duration, now: MonotonicTime) -> Self {
        Self { within, heartbeat_at: now, request: KeyRequest::default() }
    }

    /// A key was pressed.
    pub fn key_pressed(&mut self, now: MonotonicTime) {
        self.heartbeat_at = now;
    }

    /// The question to ask now, if one is due.
    ///
    /// # Errors
    /// [`EndedByPerson::Silent`].
    pub fn look(&mut self, now: MonotonicTime) -> Result<Option<&'static str>, EndedByPerson> {
        match silence(self.within, self.heartbeat_at, now) {
            Some(cause) => Err(EndedByPerson::Silent(cause)),
            None => Ok(self.request.is_due(self.within, self.heartbeat_at, now).then_some(ASK)),
        }
    }
}

/// Questions to a person, from a thread of their own: an output that nobody reads blocks only that thread, and a person in front of it can
/// still type.
pub struct Questions(SyncSender<&'static str>);

impl Questions {
    /// Questions written to `output`.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start(mut output: impl Write + Send + 'static) -> Result<Self> {
        let (ask, asked) = sync_channel(1);
        let write = move || {
            for question in asked {
                let _ = writeln!(output, "{question}").and_then(|()| output.flush());
            }
        };
        Builder::new().name("questions".to_owned()).spawn(write).context("no thread for questions to the operator")?;
        Ok(Self(ask))
    }

    /// Asks; while an earlier question waits, that one is enough.
    pub fn ask(&self, question: &'static str) {
        let _ = self.0.try_send(question);
    }
}

/// Listens to a person until it is dropped, on a thread of its own: the thread that moves the arm only looks at the outcome.
pub struct AttendedMotion {
    shared: Arc<Shared>,
    /// Given back behind the motion.
    _escape: Option<EscapeEndsLine>,
}

#[derive(Default)]
struct Shared {
    ended: OnceLock<EndedByPerson>,
    is_over: AtomicBool,
}

impl AttendedMotion {
    /// Listens to these lines from now on, and asks on `answers` for a key in time. `on_end` is called once if the person, or nobody,
    /// ends the motion.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start(
        lines: Receiver<io::Result<String>>,
        key_within: Duration,
        clock: Arc<dyn Clock>,
        answers: impl Write + Send + 'static,
        on_end: impl FnOnce(&EndedByPerson) + Send + 'static,
    ) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let keys = Keys::new(key_within, clock.now());
        let mut listening = Listening { lines, clock, questions: Questions::start(answers)?, keys };
        let shared_state = Arc::clone(&shared);
        let listen = move || {
            if let Some(ended) = listening.until(&shared_state.is_over) {
                on_end(shared_state.ended.get_or_init(|| ended));
            }
        };
        Builder::new().name("person".to_owned()).spawn(listen).context("no thread for typed lines")?;
        Ok(Self { shared, _escape: EscapeEndsLine::set() })
    }

    /// Why the motion must end; does not wait.
    pub fn ended(&self) -> Option<&EndedByPerson> {
        self.shared.ended.get()
    }
}

impl Drop for AttendedMotion {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::SeqCst);
    }
}

/// The listening thread.
struct Listening {
    lines: Receiver<io::Result<String>>,
    clock: Arc<dyn Clock>,
    questions: Questions,
    keys: Keys,
}

impl Listening {
    /// Listens until something ends the motion, or it is over.
    fn until(&mut self, is_over: &AtomicBool) -> Option<EndedByPerson> {
        while !is_over.load(Ordering::SeqCst) {
            match self.lines.recv_timeout(LOOK) {
                Ok(Ok(line)) if ends_motion(&line) => return Some(EndedByPerson::Typed(line)),
                Ok(Ok(_)) => self.keys.key_pressed(self.clock.now()),
                Ok(Err(_)) | Err(RecvTimeoutError::Disconnected) => return Some(EndedByPerson::EndOfInput),
                Err(RecvTimeoutError::Timeout) => {}
            }
            match self.keys.look(self.clock.now()) {
                Err(ended) => return Some(ended),
                Ok(Some(question)) => self.questions.ask(question),
                Ok(None) => {}
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Sender, channel};
    use std::time::Instant;

    use pb3dp_hal_clock::VirtualClock;

    use super::*;

    const WITHIN: Duration = Duration::from_secs(30);

    /// Collects what is written.
    struct Written(Sender<String>);

    impl Write for Written {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.send(String::from_utf8_lossy(bytes).into_owned()).ok();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    struct Bench {
        clock: Arc<VirtualClock>,
        lines: Sender<io::Result<String>>,
        asked: Receiver<String>,
        ends: Receiver<EndedByPerson>,
        motion: AttendedMotion,
    }

    fn bench() -> Bench {
        let clock = Arc::new(VirtualClock::new());
        let ((lines, typed), (written, asked), (end, ends)) = (channel(), channel(), channel());
        let on_end = move |ended: &EndedByPerson| drop(end.send(ended.clone()));
        let motion = AttendedMotion::start(typed, WITHIN, clock.clone(), Written(written), on_end).unwrap();
        Bench { clock, lines, asked, ends, motion }
    }

    impl Bench {
        fn say(&self, line: &str) {
            self.lines.send(Ok(line.to_owned())).unwrap();
        }

        fn at(&self, seconds: u64) {
            self.clock.sleep_until(MonotonicTime::ZERO + Duration::from_secs(seconds));
        }

        fn end(&self) -> EndedByPerson {
            let end = self.ends.recv_timeout(Duration::from_secs(30)).unwrap();
            assert_eq!(self.motion.ended(), Some(&end));
            end
        }

        fn assert_goes_on(&self) {
            assert!(self.ends.recv_timeout(LOOK * 3).is_err() && self.motion.ended().is_none());
        }
    }

    #[test]
    fn a_typed_stop_ends_the_motion_and_another_line_does_not() {
        let bench = bench();
        ["", "status", "\x1b[A"].into_iter().for_each(|line| bench.say(line));
        bench.assert_goes_on();
        bench.say("STOP!");
        assert_eq!(bench.end().to_string(), "ended by \"STOP!\", which was typed");
    }

    #[test]
    fn the_end_of_input_and_an_unreadable_one_end_the_motion() {
        let mut closed = bench();
        closed.lines = channel().0;
        assert_eq!(closed.end(), EndedByPerson::EndOfInput);
        let unreadable = bench();
        unreadable.lines.send(Err(io::Error::other("EIO"))).unwrap();
        assert_eq!(unreadable.end(), EndedByPerson::EndOfInput);
    }

    #[test]
    fn nobody_who_presses_a_key_ends_the_motion_and_is_asked_before() {
        let bench = bench();
        bench.at(19);
        assert!(bench.asked.recv_timeout(LOOK * 3).is_err(), "asked too early");
        bench.at(21);
        assert!(bench.asked.recv_timeout(Duration::from_secs(30)).unwrap().contains("are you there?"));
        bench.say("");
        bench.assert_goes_on();
        bench.at(50);
        bench.assert_goes_on();
        bench.at(52);
        let end = bench.end().to_string();
        assert!(
            end.starts_with(
                "operator_silent: the newest sign of life from the operator is 31.000 s old, limit 30.000 s"
            ),
            "{end}"
        );
        assert!(end.contains("press Enter at least every 30 s"), "{end}");
    }

    /// Behind the motion the same lines may be answers to questions.
    #[test]
    fn it_listens_no_longer_than_the_motion() {
        let Bench { lines, motion, .. } = bench();
        drop(motion);
        let since = Instant::now();
        while lines.send(Ok("stop".to_owned())).is_ok() {
            assert!(since.elapsed() < Duration::from_secs(30));
            std::thread::sleep(LOOK);
        }
    }
}
