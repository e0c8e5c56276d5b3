//! What travels between a host, a gateway and the servo controller of a Mitsubishi PA-10. Pure functions: no I/O, no clock.
//!
//! * [`codec`]: the two wire formats of the servo controller, its messages, replies and alarms.
//! * [`arcnet`]: the frames in which Linux passes these messages through an ARCNET card.
//! * [`gateway_protocol`]: the framed protocol between a host and the gateway that owns the bus of an arm.
//! * [`places`]: where the other end of a link is, and what is spoken there.
//! * [`watchdog`]: what becomes of a velocity whose successor stays away.

pub mod arcnet;
pub mod codec;
mod codes;
pub mod gateway_protocol;
pub mod places;
pub mod watchdog;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
