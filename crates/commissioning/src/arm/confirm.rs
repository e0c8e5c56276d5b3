//! What an operator types, and that he wants an arm to move.

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use pb3dp_cell::terminal::typed_lines;
use pb3dp_hal_platform::signals::{StopSignal, StopSignals};

/// Signals are looked for this often while nothing is typed.
const LOOK: Duration = Duration::from_millis(50);

/// A signal asked to end.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("ended by {0}")]
pub struct Interrupted(pub StopSignal);

/// The lines of standard input, as they come.
pub struct Console {
    lines: Receiver<std::io::Result<String>>,
}

/// What came of waiting for a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A line, without its end.
    Typed(String),
    /// Standard input has ended.
    Ended,
    /// Nobody typed anything.
    TimedOut,
}

impl Console {
    /// Reads lines from now on.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start() -> Result<Self> {
        Ok(Self { lines: typed_lines()? })
    }

    /// Forgets what was typed before it was asked for: nobody has thought about it.
    pub fn forget(&self) {
        while self.lines.try_recv().is_ok() {}
    }

    /// Waits for a line, for at most this long if a time is given.
    ///
    /// # Errors
    /// [`Interrupted`] by a signal, or standard input that cannot be read.
    pub fn line(&self, patience: Option<Duration>, signals: &mut StopSignals) -> Result<Line> {
        let since = Instant::now();
        loop {
            if let Some(signal) = signals.try_take()? {
                return Err(Interrupted(signal).into());
            }
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => return Ok(Line::Typed(line.context("standard input cannot be read")?)),
                Err(RecvTimeoutError::Disconnected) => return Ok(Line::Ended),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if patience.is_some_and(|patience| since.elapsed() >= patience) {
                return Ok(Line::TimedOut);
            }
        }
    }

    /// Waits until exactly this name was typed, for at most this long if a time is given.
    ///
    /// # Errors
    /// If something else is typed or nothing in time, standard input ends, or a signal asks to end.
    pub fn typed(&self, name: &str, patience: Option<Duration>, signals: &mut StopSignals) -> Result<()> {
        match self.line(patience, signals).context("nothing was moved")? {
            Line::Typed(line) if line == name => Ok(()),
            Line::Typed(line) => bail!("{line:?} is not {name}; nothing was moved"),
            Line::Ended => bail!("nobody typed {name}: standard input has ended; nothing was moved"),
            Line::TimedOut => bail!("nobody typed {name} in time; nothing was moved"),
        }
    }
}

/// Waits until exactly this name was typed.
///
/// # Errors
/// As [`Console::typed`].
pub fn typed(name: &str, signals: &mut StopSignals) -> Result<()> {
    Console::start()?.typed(name, None, signals)
}
