//! What a person types beside arms: the words that stop them, and keys as the sign of life.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Cause, Condition, Detail, OperatorCommand};

use super::terminal::{has_term, without_escape_sequences};

/// Words that stop both arms.
const STOP_COMMANDS: [&str; 3] = ["stop", "estop", "halt"];

/// A person is asked for a key this long before the longest silence, or a third of it before: time to read the line and to press Enter.
const ASKS_BEFORE: Duration = Duration::from_secs(10);

/// The key that a person hits first who wants to end something.
const ESCAPE: char = '\x1b';

/// The command of a line. `stop` and `hold` are recognised anywhere in a line, in any case and with any punctuation, because an operator
/// in a hurry types `STOP!` or hits an arrow key first; a command that can cause motion must be exact, and so must `hold hand`, which lets
/// one arm move on.
pub(crate) fn command_of(line: &str) -> Option<OperatorCommand> {
    let exact = without_escape_sequences(line);
    let mut all = OperatorCommand::ALL.into_iter();
    all.find(|command| command.name() == exact.trim()).or_else(|| cautious_command_of(line))
}

/// `stop` or `hold`, if the line contains such a word.
pub(crate) fn cautious_command_of(line: &str) -> Option<OperatorCommand> {
    if STOP_COMMANDS.into_iter().any(|term| has_term(line, term)) {
        return Some(OperatorCommand::Stop);
    }
    has_term(line, OperatorCommand::Hold.name()).then_some(OperatorCommand::Hold)
}

/// Whether a line ends a motion that knows no other command: `stop` or `hold` in it, `q` or `quit` alone, or the key Esc at its end.
pub fn ends_motion(line: &str) -> bool {
    let text = without_escape_sequences(line);
    let term = text.trim_matches(|c: char| !c.is_alphabetic());
    cautious_command_of(line).is_some()
        || ["q", "quit"].into_iter().any(|quit| term.eq_ignore_ascii_case(quit))
        || line.trim_end().ends_with(ESCAPE)
}

/// When to ask a person for a key.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KeyRequest {
    /// The sign of life after which a key was asked for.
    asked_after: Option<MonotonicTime>,
}

impl KeyRequest {
    /// Whether to ask now: in time, and once after each sign of life.
    pub fn is_due(&mut self, within: Duration, heartbeat_at: MonotonicTime, now: MonotonicTime) -> bool {
        let left = within.saturating_sub(now.saturating_since(heartbeat_at));
        let is_due = left <= ASKS_BEFORE.min(within / 3) && self.asked_after != Some(heartbeat_at);
        if is_due {
            self.asked_after = Some(heartbeat_at);
        }
        is_due
    }
}

/// The condition `operator_silent`, if the last sign of life is too old.
pub(crate) fn silence(within: Duration, heartbeat_at: MonotonicTime, now: MonotonicTime) -> Option<Cause> {
    let age = now.saturating_since(heartbeat_at);
    (age > within).then_some(Cause {
        condition: Condition::OperatorSilent,
        value: age.as_secs_f64(),
        threshold: within.as_secs_f64(),
        detail: Detail::None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_end_a_motion() {
        for line in
            ["stop", "STOP!", "please hold", "hold hand", "e-stop", "halt", "q", "Q", "quit", "\x1b", "\x1b\x1b"]
        {
            assert!(ends_motion(line), "{line:?}");
        }
        for line in ["ab\x1b", " q ", "q!", "\x1b[Aq", "\x1b[Astop", "status stop"] {
            assert!(ends_motion(line), "{line:?}");
        }
        for line in ["", " ", "ok", "\x1b[A", "\x1bOP", "go on", "stopping", "quiet", "?"] {
            assert!(!ends_motion(line), "{line:?}");
        }
    }
}
