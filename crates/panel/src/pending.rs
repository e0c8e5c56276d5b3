//! Commands without a result.

use std::sync::{Mutex, MutexGuard, PoisonError};

use pb3dp_cell::selection::Selection;
use pb3dp_servo::supervisor::OperatorCommand;
use serde::Serialize;
use tokio::sync::oneshot;

use crate::control_link::TakenCommand;
use crate::refusal::Refusal;

/// Commands that wait for their result.
const PENDING_MAX: usize = 64;
/// Answer to an accepted command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CommandAnswer {
    /// The command.
    pub command: &'static str,
    /// One line: the result.
    pub line: String,
    /// State number afterwards; the page may use it before the next state arrives.
    pub number: u64,
}

/// Receives the result of a command.
pub type Answer = oneshot::Receiver<Result<CommandAnswer, Refusal>>;

/// A target that a `select` chooses.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// The selection; `None` leaves the target to the setup.
    pub selection: Option<Selection>,
    /// Its name.
    pub name: Option<String>,
}

/// A command without a result.
pub struct PendingCommand {
    /// Its number.
    pub id: u64,
    /// The command.
    pub command: OperatorCommand,
    /// The target of a `select`.
    pub chosen: Option<Chosen>,
    /// Takes the result.
    pub answer: oneshot::Sender<Result<CommandAnswer, Refusal>>,
}

/// Commands without a result.
#[derive(Default)]
pub struct PendingCommands(Mutex<Vec<PendingCommand>>);

impl PendingCommands {
    fn lock(&self) -> MutexGuard<'_, Vec<PendingCommand>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a command; returns false if too many wait.
    pub fn push(&self, command: PendingCommand) -> bool {
        let mut pending = self.lock();
        let has_room = pending.len() < PENDING_MAX;
        if has_room {
            pending.push(command);
        }
        has_room
    }

    /// Whether a command waits that may begin motion.
    pub fn has_start(&self) -> bool {
        let begins =
            |pending: &PendingCommand| matches!(pending.command, OperatorCommand::Start | OperatorCommand::Resume);
        self.lock().iter().any(begins)
    }

    /// Removes a command that was not given.
    pub fn remove(&self, id: u64) {
        self.lock().retain(|pending| pending.id != id);
    }

    /// Removes the commands that this result is for: a slot for urgent commands holds the last request only, and its result is that of
    /// the earlier ones, too.
    pub fn take(&self, taken: &TakenCommand) -> Vec<PendingCommand> {
        let is_done = |pending: &mut PendingCommand| {
            pending.id == taken.id
                || (taken.command.ends_motion() && pending.command == taken.command && pending.id < taken.id)
        };
        self.lock().extract_if(.., is_done).collect()
    }
}
