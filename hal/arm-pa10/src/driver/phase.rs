//! How far an activity has come, and what it sends next.

use pb3dp_geometry::MonotonicTime;

use super::Activity;

/// How far an activity has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// No activity: the state alone says what is sent.
    Steady,
    /// Connecting, or the second half of clearing.
    Looking { step: LookStep, activity: Activity },
    /// Enabling: first S, then cycles with brakes on.
    Enabling { started: bool },
    /// Opening the brakes, since the first answer to a command that opens them.
    Releasing { since: Option<MonotonicTime> },
    /// Going through the stop order.
    Stopping(StopStep),
}

/// What a controller answered first, when it was told to close its brakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FirstAnswer {
    /// Nothing yet.
    Nothing,
    /// E: it may have no use for C.
    End,
    /// C.
    Cyclic,
}

/// Steps of looking at the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LookStep {
    /// On a bus, brakes on with servos on, until this time: nobody knows who drove the arm before.
    Close { until: Option<MonotonicTime>, heard: FirstAnswer },
    /// E, tried so often, before anything else is asked.
    FirstEnd { tries: u32, heard: FirstAnswer },
    /// C once more: does this controller answer C out of its control mode, too?
    Check { left: u32 },
    /// Clear the alarm of this axis, 0 to 6 (clearing only).
    Clear(usize),
    /// Read the limits of this axis, 0 to 6 (where the configuration wants it).
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
    /// Down to speed 0.
    Ramp,
    /// Speed 0 for so many more cycles.
    Rest { left: u32 },
    /// Brakes on, servos on, until this time (from the first command on).
    Brake { until: Option<MonotonicTime>, heard: bool },
    /// Brakes on, servos off, once.
    Off,
    /// E, tried so often.
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
