//! Protocol layers between the driver and the bytes of a link, without I/O: messages become frames, frames become replies.
//!
//! [`BusLink`] connects to the servo controller, [`GatewayLink`] to a gateway in either dialect. A transport (socket, serial port,
//! pseudo-terminal) moves the bytes and provides the time.

mod bus;
mod codes;
mod gateway;

pub use bus::{BusFrameError, BusLink};
pub use gateway::{GatewayLink, HEARTBEAT_INTERVAL, HELLO_TIMEOUT, HeldError, HelloError, LinkError, SILENCE};

use pb3dp_arm_pa10_protocol::codec::{ReplyMessage, TorqueScale, WireFormat};

use crate::driver::{AxisLimits, Reply, Sample};

/// Content of a reply of the servo controller for the driver, with torques in the scale of its wire format.
fn reply_of(message: &ReplyMessage, format: WireFormat) -> Reply {
    match message {
        ReplyMessage::Cyclic(arm) => Reply::Sample(Sample::from_reply(arm, &TorqueScale::of_format(format))),
        ReplyMessage::Eeprom(table) => Reply::Limits(AxisLimits {
            axis: table.axis,
            lower_rad: table.negative_limit.to_rad(),
            upper_rad: table.positive_limit.to_rad(),
        }),
        ReplyMessage::Done(_) => Reply::Done,
    }
}
