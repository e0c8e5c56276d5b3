//! The framed protocol between a host and a gateway, the device that owns the bus of one arm and its cycle of 2 ms.
//!
//! `docs/arm-protocol.md` specifies it, so that firmware can be written from the text alone; a test reads its examples from there.
//! [`Frame`] is the envelope, [`FrameParser`] finds frames in a stream of bytes, [`HostMessage`] and [`GatewayMessage`] are what
//! frames say. Everything is little-endian. Nothing here allocates, reads a clock or does I/O.

mod codes;
mod fields;
mod frame;
mod freshness;
mod gateway_message;
mod host_message;
mod limits;
mod line;
mod parser;
mod sequence;
mod session;
mod state;

pub use codes::{ControlOperation, DriveMode, GatewayState, Geometry, RejectReason, StopCause};
pub use frame::{
    ArmId, FRAME_BYTES_MAX, FirstFrame, Frame, FrameBytes, OVERHEAD, PAYLOAD_LENGTH_MAX, PROTOCOL_VERSION, Payload,
    first_frame,
};
pub use freshness::DelayMeter;
pub use gateway_message::{
    ControlReply, EepromLimits, FaultReport, Firmware, GatewayMessage, Health, HelloReply, Holder, Reject,
};
pub use host_message::HELLO;
pub use host_message::{ArmOperation, Control, DriveCommand, Hello, HostMessage};
pub use limits::{AxisMotion, AxisMotionLimits, HostLimits, LimitOutOfRange, MotionLimits, MotionQuantity, WiderLimit};
pub use line::{EXCHANGE_BYTES, LineTooSlow, check_line, exchange_time};
pub use parser::{FrameParser, ParserCounters, Received};
pub use sequence::{Arrival, SequenceTracker};
pub use session::{
    Agreement, CHALLENGE, CLIENT_NONCE, Handshake, KEY_BYTES_MIN, KeyTooShort, MAC_BYTES, NONCE_BYTES, Nonce,
    NotAuthentic, Opener, PROOF, Proof, RECORD_BYTES_MAX, RecordBytes, Sealer, SharedKey, Side,
};
pub use state::{AxisState, State};

use std::time::Duration;

use crate::codec::CodecError;

/// Brakes that take longer to open are none.
pub const BRAKE_TIME_MAX: Duration = Duration::from_secs(5);

/// Why a frame is no message, or a message no frame.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MessageError {
    /// The type is none of this direction.
    #[error("frame type 0x{got:02x} is not valid in this direction; compare the versions of host and gateway")]
    Type {
        /// The type byte.
        got: u8,
    },
    /// The payload has the wrong length for its type.
    #[error(
        "frame type 0x{frame_type:02x}: {got} bytes of payload instead of {expected}; compare the versions of both sides"
    )]
    Length {
        /// The type byte.
        frame_type: u8,
        /// Length of the payload.
        got: usize,
        /// What the type demands.
        expected: usize,
    },
    /// A field has a value without a meaning.
    #[error(
        "frame type 0x{frame_type:02x}: {field} is {got}, which has no meaning; compare the versions of both sides"
    )]
    Value {
        /// The type byte.
        frame_type: u8,
        /// Name of the field in `docs/arm-protocol.md`.
        field: &'static str,
        /// What it holds.
        got: i64,
    },
    /// A number cannot be expressed.
    #[error("the message cannot be expressed")]
    Codec(#[from] CodecError),
}
