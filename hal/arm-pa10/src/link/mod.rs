//! Between the driver and the bytes of a link, without I/O: messages become frames, frames become replies.
//!
//! [`BusLink`] speaks to the servo controller itself, [`GatewayLink`] to a gateway in either dialect. A transport (socket, serial
//! port, pseudo-terminal) moves the bytes and tells the time.

mod bus;
mod gateway;

pub use bus::{BusFrameError, BusLink};
pub use gateway::{GatewayLink, GatewayLinkConfig, HEARTBEAT_INTERVAL, HELLO_TIMEOUT, LinkError, SILENCE};
