//! Typed operator input, and the confirmation before an arm moves.

use std::io::{IsTerminal as _, Write};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use pb3dp_cell::attended_motion::{AttendedMotion, EndedByPerson, Keys, ends_motion, instructions};
use pb3dp_cell::parts::Parts;
use pb3dp_cell::terminal::{print_line, typed_lines};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::signals::{StopSignal, StopSignals};
use pb3dp_setup::setup::Setup;
use rustix::termios::{QueueSelector, tcflush};

/// Interval at which signals are checked while nothing is typed.
const LOOK: Duration = Duration::from_millis(50);

/// The program was ended by a signal.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("ended by {0}")]
pub struct Interrupted(pub StopSignal);

/// The lines of standard input, as they arrive.
pub struct Console {
    lines: Receiver<std::io::Result<String>>,
}

/// Result of waiting for a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A line, without its end.
    Typed(String),
    /// Standard input has ended.
    Ended,
    /// No line in time.
    TimedOut,
}

impl Console {
    /// Starts reading lines. Discards input typed at a terminal before.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start() -> Result<Self> {
        flush_terminal();
        Ok(Self { lines: typed_lines()? })
    }

    /// The lines after the confirmation.
    pub fn into_lines(self) -> Receiver<std::io::Result<String>> {
        self.lines
    }

    /// Discards lines typed before the prompt: they cannot be answers to it.
    pub fn forget(&self) {
        flush_terminal();
        while self.lines.try_recv().is_ok() {}
    }

    /// Ends a motion by what was typed meanwhile, if nobody can type any more, or nobody presses a key; does not wait. Other lines are
    /// keys. Returns the question to ask now, if one is due.
    ///
    /// # Errors
    /// [`EndedByPerson`].
    pub fn goes_on(&self, keys: &mut Keys, now: MonotonicTime) -> Result<Option<&'static str>, EndedByPerson> {
        loop {
            match self.lines.try_recv() {
                Ok(Ok(line)) if ends_motion(&line) => return Err(EndedByPerson::Typed(line)),
                Ok(Ok(_)) => keys.key_pressed(now),
                Ok(Err(_)) | Err(TryRecvError::Disconnected) => return Err(EndedByPerson::EndOfInput),
                Err(TryRecvError::Empty) => return keys.look(now),
            }
        }
    }

    /// Waits for a line, up to `patience` if given.
    ///
    /// # Errors
    /// [`Interrupted`] by a signal, or unreadable standard input.
    pub fn line(&self, patience: Option<Duration>, signals: &mut StopSignals) -> Result<Line> {
        let since = Instant::now();
        loop {
            if let Some(signal) = signals.try_take()? {
                return Err(Interrupted(signal).into());
            }
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => return Ok(Line::Typed(line.context("cannot read standard input")?)),
                Err(RecvTimeoutError::Disconnected) => return Ok(Line::Ended),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if patience.is_some_and(|patience| since.elapsed() >= patience) {
                return Ok(Line::TimedOut);
            }
        }
    }

    /// Waits until exactly this name is typed, up to `patience` if given. Discards what was typed at a terminal before: no name counts
    /// that was typed before the plan was shown. A pipe is read as it is, for scripts.
    ///
    /// # Errors
    /// If something else or nothing is typed in time, if standard input ends, or on a signal.
    pub fn typed(&self, name: &str, patience: Option<Duration>, signals: &mut StopSignals) -> Result<()> {
        if std::io::stdin().is_terminal() {
            self.forget();
        }
        match self.line(patience, signals).context("nothing was moved")? {
            Line::Typed(line) if line == name => Ok(()),
            Line::Typed(line) => bail!("typed {line:?} is not {name}; nothing was moved"),
            Line::Ended => bail!("{name} was not typed: standard input has ended; nothing was moved"),
            Line::TimedOut => bail!("{name} was not typed in time; nothing was moved"),
        }
    }
}

/// Discards input that the terminal holds, also a line without its end.
fn flush_terminal() {
    // Standard input that is not a terminal has no such input.
    let _ = tcflush(std::io::stdin(), QueueSelector::IFlush);
}

/// Waits until exactly this name is typed; returns the console, whose next lines belong to what the name has begun.
///
/// # Errors
/// As [`Console::typed`].
pub fn typed(name: &str, signals: &mut StopSignals) -> Result<Console> {
    let console = Console::start()?;
    console.typed(name, None, signals)?;
    Ok(console)
}

/// Waits until a person has typed the word for a motion; `real_within`: the arm is not emulated, and a key must be pressed within each such
/// time while it moves.
///
/// # Errors
/// As [`Console::typed`], and if nobody can type.
pub fn confirmed(word: &str, real_within: Option<Duration>, signals: &mut StopSignals) -> Result<Console> {
    print_line("The arm will move. Keep all persons out of its reach and a hand on the emergency stop.")?;
    if let Some(key_within) = real_within {
        need_person()?;
        print_line(&instructions(key_within))?;
    }
    print_line(&format!("Type {word} to move it:"))?;
    typed(word, signals)
}

/// Ends a run of both arms as a signal does when the person beside them, or nobody, ends its motion.
///
/// # Errors
/// If the system provides no thread.
pub fn attend(
    console: Console,
    key_within: Duration,
    parts: &Parts,
    answers: impl Write + Send + 'static,
) -> Result<AttendedMotion> {
    let interrupt = Arc::clone(&parts.interrupt);
    let on_end = move |ended: &EndedByPerson| {
        interrupt.store(true, Ordering::SeqCst);
        tracing::warn!("{ended}: stopping both arms");
    };
    AttendedMotion::start(console.into_lines(), key_within, Arc::clone(&parts.clock), answers, on_end)
}

/// Checks that a person can type: commands and names for real arms must come from a terminal, because a pipe or a file types
/// whether or not somebody is there. Test builds accept any standard input.
///
/// # Errors
/// If standard input is no terminal.
pub fn need_person() -> Result<()> {
    match is_person(std::io::stdin().is_terminal(), cfg!(debug_assertions)) {
        true => Ok(()),
        false => bail!(
            "standard input is not a terminal: a person must type the commands and names for arms that are not emulated; run the \
             program in a terminal (`ssh -t` from another computer)"
        ),
    }
}

/// Refuses to move arms that are not emulated by a command without a button to hold, if the setup requires one.
///
/// # Errors
/// If `supervisor.hold_to_run` is true.
pub fn need_no_button(setup: &Setup) -> Result<()> {
    if setup.hold_to_run {
        bail!(
            "supervisor.hold_to_run = true: arms that are not emulated move only while a button of the panel is pressed, and this command \
             has none; set supervisor.hold_to_run = false for it, with a hand on the emergency stop"
        );
    }
    Ok(())
}

fn is_person(is_terminal: bool, is_test_build: bool) -> bool {
    is_terminal || is_test_build
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::mpsc::{Sender, channel};

    use super::*;

    /// A console, its keyboard, and the keys of a person who has pressed one at 0 s and must press one every 30 s.
    fn bench() -> (Console, Sender<io::Result<String>>, Keys) {
        let (typed, lines) = channel();
        (Console { lines }, typed, Keys::new(Duration::from_secs(30), MonotonicTime::ZERO))
    }

    fn at(seconds: u64) -> MonotonicTime {
        MonotonicTime::ZERO + Duration::from_secs(seconds)
    }

    #[test]
    fn a_stop_typed_during_a_motion_ends_it_and_so_does_the_end_of_input() {
        let (console, typed, mut keys) = bench();
        let mut goes_on = || console.goes_on(&mut keys, at(1));
        assert_eq!(goes_on(), Ok(None));
        ["", "yes"].into_iter().for_each(|line| typed.send(Ok(line.to_owned())).unwrap());
        assert_eq!(goes_on(), Ok(None));
        ["", "stop", "yes"].into_iter().for_each(|line| typed.send(Ok(line.to_owned())).unwrap());
        assert_eq!(goes_on(), Err(EndedByPerson::Typed("stop".to_owned())));
        typed.send(Err(io::Error::other("EIO"))).unwrap();
        assert_eq!(goes_on(), Err(EndedByPerson::EndOfInput));
        drop(typed);
        assert_eq!(goes_on(), Err(EndedByPerson::EndOfInput));
    }

    #[test]
    fn nobody_who_presses_a_key_during_a_motion_ends_it_and_is_asked_before() {
        let (console, typed, mut keys) = bench();
        assert_eq!(console.goes_on(&mut keys, at(19)), Ok(None));
        let asked = console.goes_on(&mut keys, at(21)).unwrap().unwrap();
        assert!(asked.contains("press Enter now"), "{asked}");
        assert_eq!(console.goes_on(&mut keys, at(22)), Ok(None), "asked once");
        typed.send(Ok(String::new())).unwrap();
        assert_eq!(console.goes_on(&mut keys, at(29)), Ok(None));
        assert_eq!(console.goes_on(&mut keys, at(48)), Ok(None));
        assert!(console.goes_on(&mut keys, at(50)).unwrap().is_some());
        let ended = console.goes_on(&mut keys, at(60)).unwrap_err().to_string();
        assert!(ended.contains("operator_silent"), "{ended}");
    }

    #[test]
    fn a_pipe_is_no_person_in_a_release() {
        assert!(is_person(true, false) && !is_person(false, false) && is_person(false, true));
    }
}
