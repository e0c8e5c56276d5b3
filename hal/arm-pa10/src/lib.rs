//! The Mitsubishi PA-10: the host side of one arm.
//!
//! * [`driver`]: a state machine without I/O and clock.
//! * [`link`]: between the driver and the bytes of its gateway.
//! * [`arm`]: a real PA-10, behind a gateway.
//! * [`serial`]: a serial line to a gateway.

pub mod arm;
pub mod driver;
pub mod link;
pub mod serial;
