//! The link to the servo controller over the bus.

use pb3dp_arm_pa10_protocol::arcnet::{self, Frame, FrameError, Route};
use pb3dp_arm_pa10_protocol::codec::{CodecError, ControlPacket, ReplyPacket, SequenceModulus, WireFormat};
use pb3dp_geometry::MonotonicTime;

use crate::driver::{BadReply, Driver, FaultCause, Transmit, Trip};

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

    /// Passes a frame from the bus to the driver. Frames of other nodes are ignored.
    ///
    /// # Errors
    /// Why the frame is not a reply to the last message, for the log; the driver has counted it.
    pub fn handle_frame(&mut self, now: MonotonicTime, frame: &[u8], driver: &mut Driver) -> Result<(), BusFrameError> {
        let packet = match arcnet::decode(Route::TO_HOST, frame) {
            Ok(packet) => packet,
            Err(FrameError::Route { .. }) => return Ok(()),
            Err(error) => {
                driver.handle_bad_reply(BadReply::Damaged);
                return Err(error.into());
            }
        };
        let Some(asked) = &self.last else {
            driver.handle_bad_reply(BadReply::Mismatched);
            return Ok(());
        };
        match ReplyPacket::decode(self.format, asked, packet) {
            Ok(reply) => {
                driver.handle_reply(now, &super::reply_of(&reply.message, self.format));
                Ok(())
            }
            Err(error) => {
                if let CodecError::OtherFormat { got, configured } = error {
                    driver.handle_trip(now, Trip::Fault(FaultCause::ReplyFormat { got, configured }));
                }
                driver.handle_bad_reply(match error {
                    CodecError::Sequence { .. } => BadReply::Late,
                    CodecError::ReplyLetter { .. } | CodecError::OtherFormat { .. } => BadReply::Mismatched,
                    _ => BadReply::Damaged,
                });
                Err(error.into())
            }
        }
    }
}

/// Why a frame is not a reply to the last message.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BusFrameError {
    /// A frame without a packet.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A packet that does not answer the last message.
    #[error(transparent)]
    Packet(#[from] CodecError),
}
