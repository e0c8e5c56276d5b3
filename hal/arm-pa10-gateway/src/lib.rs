//! The gateway of a PA-10, which owns the bus of an arm.
//!
//! * [`gateway`]: that device without its hardware: bytes of the host on one side, ARCNET frames on the other.
//! * [`service`]: a gateway that runs, with a thread that keeps the cycle.

pub mod gateway;
pub mod service;
