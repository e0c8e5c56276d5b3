//! The gateway of a PA-10: it owns the bus of one arm.
//!
//! * [`bus`]: the ARCNET bus of an arm, and a socket in its place.
//! * [`gateway`]: the state machine without I/O: bytes of the host on one side, ARCNET frames on the other.
//! * [`service`]: the running gateway, with the thread that keeps the cycle.

pub mod bus;
pub mod gateway;
pub mod service;
