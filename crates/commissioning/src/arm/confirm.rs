//! Typed operator input, and the confirmation before an arm moves.

use std::io::IsTerminal;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use pb3dp_cell::terminal::typed_lines;
use pb3dp_hal_platform::signals::{StopSignal, StopSignals};
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

/// Waits until exactly this name is typed.
///
/// # Errors
/// As [`Console::typed`].
pub fn typed(name: &str, signals: &mut StopSignals) -> Result<()> {
    Console::start()?.typed(name, None, signals)
}
