//! A PA-10 without hardware.
//!
//! * [`mock_controller`]: the servo controller at the far end of the bus, emulated byte by byte, with faults on request.
//! * [`far_end`]: that controller and an optional gateway, as a host finds them at the end of its line.
//! * [`mod@line`]: both at the far end of a line, in real time behind a terminal or a socket, and in virtual time.
//! * [`mock`]: an arm without hardware: the state machine and the contract of a real one over simulated joints.

pub mod far_end;
pub mod line;
pub mod mock;
pub mod mock_controller;

pub use mock::{MockArm, MockArmConfig, MockArmFaults};
