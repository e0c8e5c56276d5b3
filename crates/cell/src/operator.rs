//! Who tells a run what to do: the command itself, or a person at a console (`console.rs`).

use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Decision, OperatorInput, Said, State, Word};

/// Who tells a run what to do. The thread that moves the arms asks: nothing here waits.
pub trait Operator: Send {
    /// A word that was not handed over before, and the last sign of life; `last` is what the supervisor decided before.
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput;

    /// What the supervisor decided in this step.
    fn show(&mut self, decision: &Decision);

    /// Something that a person has to know, an arm that cannot be reset, say; or that there is nothing any more.
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
