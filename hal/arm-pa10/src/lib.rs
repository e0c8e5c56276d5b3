//! The Mitsubishi PA-10: the host side of one arm.
//!
//! * [`driver`]: a state machine without I/O and clock.
//! * [`link`]: between the driver and the bytes of the bus or of a gateway.
//! * [`arm`]: a real PA-10, behind a gateway or on a bus of this computer.
//! * [`bus`]: the ARCNET bus of an arm, and a socket in its place; [`serial`]: a serial line to a gateway.

pub mod arm;
pub mod bus;
pub mod driver;
pub mod link;
pub mod serial;
