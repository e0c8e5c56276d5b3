//! The host's side of one arm as a state machine that receives the time and does no I/O.
//!
//! The owner of the link asks [`Driver::poll_transmit`] for the message that is due, hands replies to [`Driver::handle_reply`],
//! tells damage and time, and passes on what the operator and the control loop want ([`Request`]). The link may be a gateway or
//! the bus itself: messages are those of the codec, and each adapter puts them into its own frames and checks that a reply
//! answers the message before it.
//!
//! What the machine promises:
//! * A request that the state does not allow is refused by name and sends nothing ([`table`] lists all of them).
//! * Brakes open only after a warm-up that shows a sound and quick link.
//! * Two lost replies in a row are tolerated, the third stops the arm, and so does a measurement that is older than
//!   [`MEASUREMENT_AGE_MAX`]. A velocity whose successor stays away fades and stops.
//! * Every stop goes down to speed 0, stays there, then closes the brakes, switches the servos off and ends the control mode, in
//!   bounded time whether or not anybody answers.
//! * A fault or an emergency stop latches. Only a reset leaves it, only if the controller shows that the cause is gone, and only
//!   to `Connected`.
//! * Nothing is allocated after construction.

mod codes;
mod condition;
mod config;
mod link;
mod listening;
mod machine;
mod motion;
mod phase;
mod progress;
mod requests;
pub mod table;
mod torque;

pub use condition::{ArmCondition, EmergencyStopCause, FaultCause, MEASUREMENT_AGE_MAX, Sample, Trip, Uncontrollable};
pub use config::{DriverConfig, DriverConfigError, LimitsCheck, PA10_TORQUE_MAX_N_M};
pub use link::{BadReply, LinkCounters, WarmUpFailure};
pub use machine::{AxisLimits, Driver, Latched, Reply, Transmit};
pub use requests::{Refusal, Request};
pub use table::{Activity, DriverState, Event, Outcome};
