//! Progress of an activity, and its next message.

use pb3dp_geometry::MonotonicTime;

use super::Activity;

/// Progress of an activity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// No activity: the state alone determines the messages.
    Steady,
    /// Connecting, or the second half of clearing.
    Looking { step: LookStep, activity: Activity },
    /// Enabling: first S, then cycles with closed brakes.
    Enabling { started: bool },
    /// Opening the brakes, since the first answer to the opening command.
    Releasing { since: Option<MonotonicTime> },
    /// Executing the stop order.
    Stopping(StopStep),
}

/// Steps of connecting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LookStep {
    /// Clear the alarm of this axis, 0 to 6 (clearing only).
    Clear(usize),
    /// Read the limits of this axis, 0 to 6 (if configured).
    Limits(usize),
    /// S.
    Start,
    /// One cycle with brakes on and servos off.
    Look,
    /// E.
    End,
}

/// Steps of the stop order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopStep {
    /// Ramp to speed 0.
    Ramp,
    /// Speed 0 for this number of further cycles.
    Rest { left: u32 },
    /// Brakes on, servos on, until this time (from the first command on).
    Brake { until: Option<MonotonicTime> },
    /// Brakes on, servos off, once.
    Off,
    /// E, with the number of attempts.
    End { tries: u32 },
}

impl Phase {
    pub fn activity(&self) -> Activity {
        match self {
            Self::Steady => Activity::None,
            Self::Looking { activity, .. } => *activity,
            Self::Enabling { .. } => Activity::Enabling,
            Self::Releasing { .. } => Activity::Releasing,
            Self::Stopping(_) => Activity::Stopping,
        }
    }
}
