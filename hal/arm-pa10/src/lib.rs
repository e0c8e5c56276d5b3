//! Mitsubishi PA-10 arm backends.
//!
//! * [`codec`]: the two wire formats of the servo controller, its messages, replies and alarms. Pure functions.
//! * [`arcnet`]: the frames in which Linux passes these messages through an ARCNET card.
//! * [`mock`]: an arm without hardware: the state machine and the contract of a real one over simulated joints.

pub mod arcnet;
pub mod codec;
pub mod mock;

pub use mock::{MockArm, MockArmConfig, MockArmFaults};
