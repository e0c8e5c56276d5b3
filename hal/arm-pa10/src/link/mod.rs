//! Protocol layer between the driver and the bytes of a link, without I/O: messages become frames, frames become replies.
//!
//! [`GatewayLink`] speaks the messages of a gateway. A transport (socket, serial port, pseudo-terminal) moves the bytes and provides
//! the time.

mod codes;
mod gateway;

pub use gateway::{GatewayLink, HEARTBEAT_INTERVAL, HELLO_TIMEOUT, HeldError, HelloError, LinkError, SILENCE};
