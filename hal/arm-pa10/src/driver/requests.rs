//! Requests of operator and control loop, and why they are refused.

use pb3dp_arm_pa10_protocol::codec::CodecError;
use pb3dp_kinematics::JointVector;

use super::{Activity, DriverState, Event};

/// A request of the operator or the control loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Check the arm: start and end the control mode with brakes on.
    Connect,
    /// Servos on, brakes on, and test the link.
    Enable,
    /// Open the brakes at speed 0.
    ReleaseBrakes,
    /// Follow these joint speeds, rad/s, until the next request.
    Move(JointVector),
    /// Stop with open brakes.
    Hold,
    /// Stop, brakes on, servos off, control mode off. May be repeated.
    Stop,
    /// Clear the latched state. Send it only on an operator's action.
    Reset,
    /// Release the arm.
    Disconnect,
}

impl Request {
    pub(super) fn event(&self) -> Event {
        match self {
            Self::Connect => Event::Connect,
            Self::Enable => Event::Enable,
            Self::ReleaseBrakes => Event::ReleaseBrakes,
            Self::Move(_) => Event::Move,
            Self::Hold => Event::Hold,
            Self::Stop => Event::Stop,
            Self::Reset => Event::Reset,
            Self::Disconnect => Event::Disconnect,
        }
    }
}

/// Why a request was refused. Nothing was sent, and the arm continues as before; after a refused velocity it holds.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Not in this state.
    #[error("{request:?} is not possible: the arm is {state}; {}", hint(*state))]
    NotInState {
        /// The request.
        request: Event,
        /// State of the driver.
        state: DriverState,
    },
    /// Another activity has to end first.
    #[error("{request:?} is not possible while {activity}; wait until this has ended, or stop")]
    Busy {
        /// The request.
        request: Event,
        /// The activity.
        activity: Activity,
    },
    /// A velocity cannot be sent.
    #[error("velocity refused, no axis was commanded")]
    Velocity(#[from] CodecError),
}

/// Advice for a state.
fn hint(state: DriverState) -> &'static str {
    match state {
        DriverState::Disconnected => "connect first",
        DriverState::Connected => "enable first, unless the arm is already as requested",
        DriverState::Enabled => "release the brakes to move, or stop",
        DriverState::Holding | DriverState::Moving => "move, hold or stop",
        DriverState::Fault | DriverState::EStop => "remove the cause, then reset",
    }
}
