//! The thread that writes answers.

use std::io::Write;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use pb3dp_servo::supervisor::{Decision, OperatorCommand};
use rtrb::Consumer;

use super::{CommandResult, Shared};

/// Time between two checks for results of commands; an operator does not notice it.
pub(super) const RESULTS_EVERY: Duration = Duration::from_millis(50);

/// Question to an operator who types nothing while an arm may move.
pub(super) const ASK: &str = "are you there? press Enter now, or the arms hold (operator_silent)";

/// Answer to commands that were typed while this program was suspended.
pub(super) const DISCARDED: &str = "this program was suspended, or its clock stepped: commands typed meanwhile are discarded (not stop and \
                                    hold); type them again";

/// Answer when the target is ready, and the program does not start by itself any more.
pub(super) const NO_START: &str = "ready, and this program no longer starts by itself, because something was typed or nobody pressed \
                                   Enter in time; use start";

/// Answer to `start` before the estimation has taken the target of the last `select`.
const AWAITED: &str = "start refused: the target just selected is still being initialised; check it, then repeat start";

/// The result of a command.
fn result_of(command: OperatorCommand, decision: &Decision) -> String {
    match (&decision.refused, &decision.transition) {
        (Some(refused), _) => refused.to_string(),
        (None, Some(transition)) => format!("{}: {}", command.name(), transition.to),
        (None, None) if command == OperatorCommand::Hold && decision.no_arm_may_move => {
            format!("hold: both arms hold, the state is {}", decision.state)
        }
        (None, None) => format!("{}: no change, the state is {}", command.name(), decision.state),
    }
}

/// A refusal with the problem that an arm has reported: it names the arm, the supervisor knows only that the drives are disabled.
fn with_trouble(result: String, decision: &Decision, shared: &Shared) -> String {
    let trouble = || shared.shown.lock().unwrap_or_else(PoisonError::into_inner).trouble.clone();
    match decision.refused.and_then(|_| trouble()) {
        Some(trouble) => format!("{result}\n{trouble}"),
        None => result,
    }
}

/// Writes answers until all senders are dropped; write errors are ignored.
pub(super) fn write_all(
    lines: &Receiver<String>,
    (mut results, shared): (Consumer<CommandResult>, &Shared),
    (mut answers, prompt): (impl Write, &str),
) {
    if !prompt.is_empty() {
        let _ = write!(answers, "type a command; help lists them\n{prompt}").and_then(|()| answers.flush());
    }
    // An operator whose output is not read can still type commands.
    let mut answer = |text: &str| drop(write!(answers, "{text}\n{prompt}").and_then(|()| answers.flush()));
    loop {
        let lines = lines.recv_timeout(RESULTS_EVERY);
        if let Ok(text) = &lines {
            answer(text);
        }
        while let Ok(result) = results.pop() {
            match result {
                CommandResult::Step(command, decision) => {
                    answer(&with_trouble(result_of(command, &decision), &decision, shared));
                }
                CommandResult::Late(text) => answer(&text),
                CommandResult::Overtaken(command, by) => {
                    answer(&format!("{} not done: overtaken by {}", command.name(), by.name()));
                }
                CommandResult::Awaited => answer(AWAITED),
            }
        }
        if shared.asks_for_key.swap(false, Ordering::SeqCst) {
            answer(ASK);
        }
        if shared.has_discarded.swap(false, Ordering::SeqCst) {
            answer(DISCARDED);
        }
        if shared.has_no_start.swap(false, Ordering::SeqCst) {
            answer(NO_START);
        }
        if lines == Err(RecvTimeoutError::Disconnected) {
            return;
        }
    }
}
