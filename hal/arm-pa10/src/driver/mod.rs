//! The host's side of one arm as a state machine that receives the time and does no I/O.
//!
//! The owner of the link polls [`Driver::poll_transmit`] for the due message, passes replies to [`Driver::handle_reply`], reports
//! damage and time, and forwards the requests of the operator and the control loop ([`Request`]). The link encodes the messages, which
//! are those of the codec, into frames for the gateway. It checks that a reply answers the message before it.
//!
//! Guarantees:
//! * A request that the state does not allow is refused by name and sends nothing ([`table`] lists all requests).
//! * Brakes open only after a warm-up that shows a reliable and fast link.
//! * Two lost replies in a row are tolerated; the third stops the arm, as do 20 lost or damaged ones of the last 100, and a measurement
//!   older than [`MEASUREMENT_AGE_MAX`]. A velocity without a successor fades and stops.
//! * Every stop ramps to speed 0, stays there, closes the brakes, switches the servos off and ends the control mode, in limited
//!   time with or without answers.
//! * A fault or an emergency stop latches. Only a reset leaves the latch, only if the controller shows that the cause is gone, and
//!   only to `Connected`.
//! * Nothing is allocated after construction.

mod codes;
mod condition;
mod config;
mod link;
mod machine;
mod motion;
mod progress;
mod requests;
mod sample;
mod state;
pub mod table;
mod torque;

pub use condition::{ArmCondition, EmergencyStopCause, FaultCause, MEASUREMENT_AGE_MAX, Sample, Trip, Uncontrollable};
pub use config::{DriverConfig, DriverConfigError, LimitsCheck, PA10_TORQUE_MAX_N_M};
pub use link::{BadReply, LinkCounters, WarmUpFailure};
pub use machine::{AxisLimits, Driver, Reply, Transmit};
pub use requests::{Refusal, Request};
pub use state::Latched;
pub use table::{Activity, DriverState, Event, Outcome};
