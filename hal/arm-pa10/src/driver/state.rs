//! The state of the driver: one enum, whose variants carry what exists in this state only.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_geometry::MonotonicTime;

use super::Trip;
use super::link::WarmUp;
use super::motion::{Ramp, VelocityCommand};
use super::table::{Activity, DriverState};

/// Cause and time of a latch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latched {
    /// The cause. After a failed reset: the cause of the failure.
    pub trip: Trip,
    /// Time.
    pub at: MonotonicTime,
    /// Previous state.
    pub state_before: DriverState,
}

/// State of the driver. `since` is the time at which an activity began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum State {
    /// The state of the arm is unknown.
    Disconnected,
    /// Connecting, or, with a latch, the second half of a reset.
    Looking { since: MonotonicTime, step: LookStep, latch: Option<Latch> },
    /// Control mode off, brakes on.
    Connected,
    /// Starts the control mode and tests the link.
    Enabling { since: MonotonicTime, step: EnableStep },
    /// Control mode on, brakes on.
    Enabled,
    /// Opens the brakes at speed 0.
    Releasing { since: MonotonicTime, step: ReleaseStep },
    /// Brakes open, decelerating or stationary.
    Holding { ramp: Ramp, last_request: MonotonicTime },
    /// Brakes open, following a velocity.
    Moving(VelocityCommand),
    /// First half of the stop order, with open brakes until they close.
    Braking { since: MonotonicTime, step: StopStep, of: Stopped },
    /// Second half of the stop order, with closed brakes.
    Ending { since: MonotonicTime, step: EndStep, of: Ended },
    /// Stopped until a reset.
    Latched(Latch),
    /// First half of a reset: clears the alarm of this axis.
    Clearing { since: MonotonicTime, axis: Axis, latch: Latch },
}

/// A cause that only a reset clears.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Latch {
    pub cause: Latched,
    /// Since an emergency stop, even if a reset has found a fault afterwards.
    pub is_emergency_stop: bool,
    /// The gateway has to latch the cause too.
    pub in_gateway: bool,
}

/// Steps of connecting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum LookStep {
    /// Read the limits of this axis (if configured).
    Limits(Axis),
    /// S.
    Start,
    /// S again, until it is answered.
    StartSent,
    /// One cycle with brakes on and servos off.
    Look,
    /// E.
    End,
}

/// Steps of enabling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum EnableStep {
    /// S.
    Start,
    /// S again, until it is answered.
    StartSent,
    /// Cycles with closed brakes.
    WarmUp(WarmUp),
}

/// Steps of opening the brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ReleaseStep {
    /// The first opening command is due.
    Due,
    /// It was sent.
    Sent,
    /// An opening command was first answered at this time.
    Answered(MonotonicTime),
}

/// Steps of the stop order until the brakes are closed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum StopStep {
    /// Ramp to speed 0.
    Ramp(Ramp),
    /// Speed 0 for this number of further cycles.
    Rest { left: u32 },
    /// Brakes on, servos on, until this time (from the first command on).
    Brake { until: Option<MonotonicTime> },
}

/// Steps of the stop order after the brakes are closed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum EndStep {
    /// Brakes on, servos off, once.
    Off,
    /// E, with the number of attempts.
    End { tries: u32 },
}

/// State that a stop order ends, or the latch that it leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stopped {
    Enabled,
    Holding,
    Moving,
    Latched(Latch),
}

/// State that the second half of a stop order ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Ended {
    Connecting,
    Enabling,
    Stopped(Stopped),
}

impl Latch {
    fn state(&self) -> DriverState {
        if self.is_emergency_stop { DriverState::EStop } else { DriverState::Fault }
    }
}

impl Stopped {
    fn state(&self) -> DriverState {
        match self {
            Self::Enabled => DriverState::Enabled,
            Self::Holding => DriverState::Holding,
            Self::Moving => DriverState::Moving,
            Self::Latched(latch) => latch.state(),
        }
    }
}

impl State {
    /// The state in the table.
    pub fn driver_state(&self) -> DriverState {
        match self {
            Self::Disconnected | Self::Looking { latch: None, .. } | Self::Ending { of: Ended::Connecting, .. } => {
                DriverState::Disconnected
            }
            Self::Connected | Self::Enabling { .. } | Self::Ending { of: Ended::Enabling, .. } => {
                DriverState::Connected
            }
            Self::Enabled | Self::Releasing { .. } => DriverState::Enabled,
            Self::Holding { .. } => DriverState::Holding,
            Self::Moving(_) => DriverState::Moving,
            Self::Braking { of, .. } | Self::Ending { of: Ended::Stopped(of), .. } => of.state(),
            Self::Latched(latch) | Self::Clearing { latch, .. } | Self::Looking { latch: Some(latch), .. } => {
                latch.state()
            }
        }
    }

    /// The activity, and the time at which it began, if there is one.
    pub fn activity(&self) -> Option<(Activity, MonotonicTime)> {
        match *self {
            Self::Looking { since, latch: None, .. } => Some((Activity::Connecting, since)),
            Self::Looking { since, .. } | Self::Clearing { since, .. } => Some((Activity::Clearing, since)),
            Self::Enabling { since, .. } => Some((Activity::Enabling, since)),
            Self::Releasing { since, .. } => Some((Activity::Releasing, since)),
            Self::Braking { since, .. } | Self::Ending { since, .. } => Some((Activity::Stopping, since)),
            Self::Disconnected | Self::Connected | Self::Enabled => None,
            Self::Holding { .. } | Self::Moving(_) | Self::Latched(_) => None,
        }
    }

    pub fn latch(&self) -> Option<&Latch> {
        match self {
            Self::Latched(latch)
            | Self::Clearing { latch, .. }
            | Self::Looking { latch: Some(latch), .. }
            | Self::Braking { of: Stopped::Latched(latch), .. }
            | Self::Ending { of: Ended::Stopped(Stopped::Latched(latch)), .. } => Some(latch),
            _ => None,
        }
    }

    /// The test of the link, while it runs.
    pub fn warm_up(&mut self) -> Option<&mut WarmUp> {
        match self {
            Self::Enabling { step: EnableStep::WarmUp(warm_up), .. } => Some(warm_up),
            _ => None,
        }
    }

    /// Whether the last cyclic command opened the brakes.
    pub fn has_open_brakes(&self) -> bool {
        match self {
            Self::Releasing { step, .. } => *step != ReleaseStep::Due,
            Self::Braking { step, .. } => !matches!(step, StopStep::Brake { until: Some(_) }),
            Self::Holding { .. } | Self::Moving(_) => true,
            _ => false,
        }
    }

    /// The due message was sent.
    pub fn note_sent(&mut self, now: MonotonicTime, brake_time: Duration) {
        match self {
            Self::Looking { step: step @ LookStep::Start, .. } => *step = LookStep::StartSent,
            Self::Enabling { step: step @ EnableStep::Start, .. } => *step = EnableStep::StartSent,
            Self::Releasing { step: step @ ReleaseStep::Due, .. } => *step = ReleaseStep::Sent,
            Self::Braking { step: StopStep::Rest { left }, .. } => *left = left.saturating_sub(1),
            Self::Braking { step: StopStep::Brake { until: until @ None }, .. } => *until = Some(now + brake_time),
            Self::Ending { step: step @ EndStep::Off, .. } => *step = EndStep::End { tries: 0 },
            Self::Ending { step: EndStep::End { tries }, .. } => *tries += 1,
            _ => {}
        }
    }
}
