//! A driver that speaks to an emulated controller itself, without a gateway: for tests of driver and joints.

use pb3dp_arm_pa10_protocol::arcnet::{self, Frame, FrameError, Route};
use pb3dp_arm_pa10_protocol::codec::{
    CodecError, ControlPacket, ReplyMessage, ReplyPacket, SequenceModulus, TorqueScale, WireFormat,
};
use pb3dp_geometry::MonotonicTime;

use pb3dp_arm_pa10::driver::{AxisLimits, BadReply, Driver, Reply, Sample, Transmit};

/// Encodes messages into ARCNET frames, and decodes replies.
#[derive(Clone, Copy, Debug)]
pub struct BusLink {
    format: WireFormat,
    modulus: SequenceModulus,
    last: Option<ControlPacket>,
}

impl BusLink {
    /// Creates a link to a controller with this wire format and these sequence numbers.
    pub fn new(format: WireFormat, modulus: SequenceModulus) -> Self {
        Self { format, modulus, last: None }
    }

    /// Encodes a message.
    ///
    /// # Errors
    /// If the wire format cannot express it: supervision by the controller in format A.
    pub fn send(&mut self, transmit: &Transmit) -> Result<Frame, CodecError> {
        let packet = ControlPacket { sequence: self.modulus.reduce(transmit.exchange), message: transmit.message };
        let frame = arcnet::encode(Route::TO_CONTROLLER, &packet.encode(self.format)?)?;
        self.last = Some(packet);
        Ok(frame)
    }

    /// Passes a frame from the bus to the driver. Frames of other nodes are ignored, and the driver counts those that are no reply to the
    /// last message.
    pub fn handle_frame(&mut self, now: MonotonicTime, frame: &[u8], driver: &mut Driver) {
        let packet = match arcnet::decode(Route::TO_HOST, frame) {
            Ok(packet) => packet,
            Err(FrameError::Route { .. }) => return,
            Err(_) => return driver.handle_bad_reply(BadReply::Damaged),
        };
        let Some(asked) = &self.last else { return driver.handle_bad_reply(BadReply::Mismatched) };
        match ReplyPacket::decode(self.format, asked, packet) {
            Ok(reply) => driver.handle_reply(now, &reply_of(&reply.message, self.format)),
            Err(CodecError::Sequence { .. }) => driver.handle_bad_reply(BadReply::Late),
            Err(CodecError::ReplyLetter { .. } | CodecError::OtherFormat { .. }) => {
                driver.handle_bad_reply(BadReply::Mismatched);
            }
            Err(_) => driver.handle_bad_reply(BadReply::Damaged),
        }
    }
}

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
