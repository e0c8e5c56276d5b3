//! Log lines on their way to the page. Who logs never waits: a line that finds the queue busy or full is counted and left out.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, TryLockError};

use pb3dp_geometry::MonotonicTime;

use crate::messages::socket::LogLine;
use crate::messages::time_ms;

/// Lines that the panel has not taken yet; it takes them at 20 Hz.
const LINES_MAX: usize = 256;
/// Longest line, characters.
const LINE_MAX: usize = 1000;

/// A queue of log lines; clones share it.
#[derive(Clone, Debug)]
pub struct LogLines(Arc<Queue>);

#[derive(Debug)]
struct Queue {
    lines: Mutex<VecDeque<LogLine>>,
    left_out: AtomicU64,
}

impl Default for LogLines {
    fn default() -> Self {
        let lines = Mutex::new(VecDeque::with_capacity(LINES_MAX));
        Self(Arc::new(Queue { lines, left_out: AtomicU64::new(0) }))
    }
}

impl LogLines {
    /// Adds a line: `info`, `warn` or `error`. A code in brackets at its end becomes its code.
    pub fn push(&self, at: MonotonicTime, level: &'static str, text: &str) {
        let text: String = text.chars().take(LINE_MAX).collect();
        let line = LogLine { time_ms: time_ms(at), level, code: code_in(&text), text };
        let mut lines = match self.0.lines.try_lock() {
            Ok(lines) => lines,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return self.leave_out(),
        };
        if lines.len() < LINES_MAX { lines.push_back(line) } else { self.leave_out() }
    }

    fn leave_out(&self) {
        self.0.left_out.fetch_add(1, Ordering::SeqCst);
    }

    /// Takes all lines, oldest first; the last one may say how many were left out.
    pub fn take(&self, now: MonotonicTime) -> Vec<LogLine> {
        let mut taken: Vec<LogLine> = match self.0.lines.lock() {
            Ok(mut lines) => lines.drain(..).collect(),
            Err(poisoned) => poisoned.into_inner().drain(..).collect(),
        };
        match self.0.left_out.swap(0, Ordering::SeqCst) {
            0 => {}
            left_out => taken.push(LogLine {
                time_ms: time_ms(now),
                level: "warn",
                text: format!("{left_out} log lines are not shown here"),
                code: None,
            }),
        }
        taken
    }
}

/// The code in a line: `[PB3DP-SUP-005]`.
fn code_in(text: &str) -> Option<String> {
    let (_, after) = text.rsplit_once("[PB3DP-")?;
    let (rest, _) = after.split_once(']')?;
    let is_code = rest.len() <= 16 && rest.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
    is_code.then(|| format!("PB3DP-{rest}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_in_order_with_their_codes_and_what_is_too_much_is_counted() {
        let lines = LogLines::default();
        let at = MonotonicTime::from_secs_f64(1.5);
        lines.push(at, "warn", "held: no heartbeat [PB3DP-SUP-005]");
        for _ in 0..LINES_MAX + 2 {
            lines.push(at, "info", "x");
        }
        let taken = lines.take(at);
        assert_eq!((taken[0].time_ms, taken[0].code.as_deref()), (1500.0, Some("PB3DP-SUP-005")));
        assert_eq!(taken.len(), LINES_MAX + 1);
        assert_eq!(taken[LINES_MAX].text, "3 log lines are not shown here");
        assert!(lines.take(at).is_empty());
    }
}
