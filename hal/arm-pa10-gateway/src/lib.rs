//! The gateway of a PA-10: it owns the bus of one arm.
//!
//! * [`gateway`]: the state machine without I/O: bytes of the host on one side, ARCNET frames on the other.
//! * [`service`]: the running gateway, with the thread that keeps the cycle.

pub mod gateway;
pub mod service;
