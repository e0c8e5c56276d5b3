//! Progress of long work: a bar in a terminal, nothing elsewhere.

use std::io;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};
use pb3dp_cell::terminal::print_line;

/// The bar that is shown; log lines are written above it.
static SHOWN: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Time between two drawings.
const REDRAWN_EVERY: Duration = Duration::from_millis(200);

/// A bar on standard error, until it is dropped. indicatif draws nothing if standard error is not a terminal.
pub struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// A bar for `total` parts of the work.
    pub fn of(total: usize, work: &'static str) -> Self {
        let bar = ProgressBar::new(total as u64).with_message(work).with_finish(ProgressFinish::AndClear);
        // The template is constant, and a test draws it.
        let bar = match ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {elapsed}, {eta} left") {
            Ok(style) => bar.with_style(style),
            Err(_) => bar,
        };
        bar.enable_steady_tick(REDRAWN_EVERY);
        *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar.clone());
        Self { bar }
    }

    /// One part is done.
    pub fn advance(&self) {
        self.bar.inc(1);
    }

    /// Prints a line of results to standard output, above the bar.
    ///
    /// # Errors
    /// If standard output cannot be written.
    pub fn print_line(&self, line: &str) -> io::Result<()> {
        self.bar.suspend(|| print_line(line))
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        *SHOWN.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Writes something to the terminal without tearing the bar.
pub fn beside<T>(write: impl FnOnce() -> T) -> T {
    let shown = SHOWN.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match shown {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}
