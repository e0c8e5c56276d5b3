//! What operator and control loop may ask for, and why it may be refused.

use pb3dp_arm_pa10_protocol::codec::CodecError;
use pb3dp_kinematics::JointVector;

use super::{Activity, DriverState, Event};

/// What operator and control loop may ask for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Look at the arm.
    Connect,
    /// Servos on, brakes on, and prove the link.
    Enable,
    /// Open the brakes at speed 0.
    ReleaseBrakes,
    /// Follow these joint speeds, rad/s, until the next request.
    Move(JointVector),
    /// Come to rest with open brakes.
    Hold,
    /// Come to rest, brakes on, servos off, control mode off. Harmless when repeated.
    Stop,
    /// Clear the latched state: only an operator's action asks for it.
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

/// Why a request was refused. Nothing was sent, and the arm goes on with what it was doing; a refused velocity makes it hold.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Not in this state.
    #[error("{request:?} is not possible: the arm is {state}; {}", hint(*state))]
    NotInState {
        /// What was asked for.
        request: Event,
        /// Where the driver is.
        state: DriverState,
    },
    /// Something else has to end first.
    #[error("{request:?} is not possible while {activity}; wait for its end, or stop")]
    Busy {
        /// What was asked for.
        request: Event,
        /// What is going on.
        activity: Activity,
    },
    /// A velocity cannot be sent.
    #[error("the velocity is refused as a whole")]
    Velocity(#[from] CodecError),
}

/// What to do in a state.
fn hint(state: DriverState) -> &'static str {
    match state {
        DriverState::Disconnected => "connect first",
        DriverState::Connected => "enable first, or it is done already",
        DriverState::Enabled => "release the brakes to move, or stop",
        DriverState::Holding | DriverState::Moving => "move, hold or stop",
        DriverState::Fault | DriverState::EStop => "remove the cause, then reset",
    }
}
