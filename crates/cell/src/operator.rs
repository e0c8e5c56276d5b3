//! Sources of operator commands: the command line itself, alone or with a person beside the arms (`attended.rs`), or a console
//! (`console.rs`).

use pb3dp_geometry::frames::Hand;
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest, State};

/// Source of operator commands. The thread that moves the arms calls it: no method may wait.
pub trait Operator: Send {
    /// A new command, if there is one, and the last sign of life; `last` is the previous decision of the supervisor.
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput;

    /// Receives the decision of this step.
    fn show(&mut self, decision: &Decision);

    /// The control step has come to its end.
    fn end_step(&mut self) {}

    /// Receives a problem that the operator must know, such as a failed reset; `None` clears it.
    fn tell(&mut self, trouble: Option<String>);

    /// How the hand shall move; the same in each step until the operator changes it.
    fn motion(&self) -> MotionRequest {
        MotionRequest::default()
    }

    /// Receives the result of a command that took longer than its control step; unlike [`Self::tell`], it is reported once, at once.
    fn answer(&mut self, _result: String) {}

    /// Whether a person commands: only then are latched faults reset, and the target waits for the command `start`.
    fn is_person(&self) -> bool;

    /// Whether the arm with the target may begin its path before the first `start`.
    fn carries_before_start(&self) -> bool {
        !self.is_person()
    }

    /// Whether the sign of life ends when nobody is there. A run moves arms that are not emulated only with such an operator.
    fn can_fall_silent(&self) -> bool;

    /// Whether nobody can give commands: then no message asks for one.
    fn is_nobody(&self) -> bool {
        !self.is_person() && !self.can_fall_silent()
    }
}

/// How the operator wants the hand to move, within what the setup and the supervisor allow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionRequest {
    /// Share of the velocity of the camera arm, 0 to 1. Values that are not finite count as 0.
    pub speed_share: f64,
    /// Offset of the desired pose of the hand, in axes of the hand.
    pub hand_from_hand_shifted: Pose<Hand, Hand>,
}

impl Default for MotionRequest {
    /// Full velocity, no offset.
    fn default() -> Self {
        Self { speed_share: 1.0, hand_from_hand_shifted: Pose::coincident() }
    }
}

/// Operator of a run without a console: selects the target once, starts as soon as possible, and never resets or resumes. Its sign of life
/// is that the run continues, so it is for emulated arms only.
#[derive(Clone, Copy, Debug)]
pub struct ByCommand;

impl ByCommand {
    /// The command that leads on from the last decision.
    pub(crate) fn next(last: Option<&Decision>) -> Option<OperatorCommand> {
        match last {
            None => Some(OperatorCommand::Select),
            Some(decision) if decision.state == State::Selecting && decision.is_ready => Some(OperatorCommand::Start),
            Some(_) => None,
        }
    }
}

impl Operator for ByCommand {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let request = Self::next(last).map(|command| OperatorRequest { command, at: now });
        OperatorInput { request, heartbeat_at: Some(now), silent_after: None }
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, _trouble: Option<String>) {}

    fn is_person(&self) -> bool {
        false
    }

    fn can_fall_silent(&self) -> bool {
        false
    }
}
