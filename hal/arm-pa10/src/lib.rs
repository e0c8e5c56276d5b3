//! Mitsubishi PA-10 arm backends.
//!
//! * [`codec`]: the two wire formats of the servo controller, its messages, replies and alarms. Pure functions.
//! * [`arcnet`]: the frames in which Linux passes these messages through an ARCNET card.
//! * [`gateway_protocol`]: the framed protocol between a host and the gateway that owns the bus of an arm.
//! * [`gateway`]: that device without its hardware: bytes of the host on one side, ARCNET frames on the other.
//! * [`driver`]: the host side of one arm as a state machine without I/O and clock.
//! * [`link`]: between the driver and the bytes of the bus or of a gateway.
//! * [`io`]: what touches the world: byte links, threads and clocks stand there and nowhere else.
//! * [`watchdog`]: what becomes of a velocity whose successor stays away.
//! * [`mock_controller`]: the servo controller at the far end of the bus, emulated byte by byte, with faults on request.
//! * [`far_end`]: that controller and the gateway before it, as a host finds them at the end of its line.
//! * [`mock`]: an arm without hardware: the state machine and the contract of a real one over simulated joints.

pub mod arcnet;
pub mod codec;
pub mod driver;
pub mod far_end;
pub mod gateway;
pub mod gateway_protocol;
pub mod io;
pub mod link;
pub mod mock;
pub mod mock_controller;
pub mod watchdog;

pub use mock::{MockArm, MockArmConfig, MockArmFaults};
