//! What goes over the wire between a host and the servo controller of a PA-10.
//!
//! Every exchange is one packet out and one packet back: a sequence number, a letter and data ([`ControlPacket`],
//! [`ReplyPacket`]). The cyclic letter C carries one [`AxisCommand`] per axis and brings back one [`AxisReply`] per axis. Two
//! [`WireFormat`]s of it are known; which one an arm speaks shows in the length of its replies.
//!
//! The controller takes joint speeds (or motor torques), never positions. Torque commands cannot be expressed here, as nothing
//! of this program commands torques; nor can an axis without brake and without servo, which would fall, nor the letters M (set
//! the mechanical zero), W and P (write the EEPROM). T (release the brakes) exists only with the feature `brake-release`.
//!
//! Facts come from drivers that run real arms: "SDU" is the driver of the University of Southern Denmark (PA10ros, RobWork),
//! "Orca" the Orca robotics project. What no source tells is said to be unknown where it matters.

mod axis;
mod bytes;
mod command;
mod counts;
mod eeprom;
mod error;
mod packet;
mod reply;
mod sequence;
mod signals;
mod status;

pub use axis::Axis;
pub use bytes::ByteBuffer;
pub use command::{ArmCommand, AxisCommand, Supervision};
pub use counts::{
    AngleCounts, COUNTS_PER_TURN, GEAR_RATIO, PA10_SPEED_MAX_RAD_PER_S, SpeedCounts, TorqueCounts, TorqueScale,
};
pub use eeprom::EepromAxis;
pub use error::CodecError;
pub use packet::{
    ControlMessage, ControlPacket, DATA_LENGTH_MAX, Letter, PACKET_LENGTH_MAX, Packet, ReplyMessage, ReplyPacket,
    packet_pointer,
};
pub use reply::{ArmReply, AxisReply};
pub use sequence::SequenceModulus;
pub use signals::{NoSignalSource, Signal, SignalBits, SignalSource, StatusSignals, StatusWord, WiredSignals};
pub use status::{AxisStatus, CommAlarm, CommStatus, CommWord, ServoAlarm, ServoWord};

/// How a cyclic command and its reply are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum WireFormat {
    /// Format A: little-endian, 5 bytes per axis out and 8 back (SDU, a 7-axis arm). No speeds come back, and the meaning of
    /// its status bits is not public.
    LittleEndian5x8,
    /// Format B: big-endian, 6 bytes per axis out and 10 back (Orca, a PA10-6CE, with a switch for the 7CE).
    BigEndian6x10,
}

impl WireFormat {
    /// Both formats.
    pub const ALL: [Self; 2] = [Self::LittleEndian5x8, Self::BigEndian6x10];

    /// Data bytes of a cyclic command: 35 or 44.
    pub const fn command_length(self) -> usize {
        match self {
            Self::LittleEndian5x8 => 7 * 5,
            Self::BigEndian6x10 => 7 * 6 + 2,
        }
    }

    /// Data bytes of a cyclic reply: 58 or 72.
    pub const fn reply_length(self) -> usize {
        match self {
            Self::LittleEndian5x8 => 7 * 8 + 2,
            Self::BigEndian6x10 => 7 * 10 + 2,
        }
    }

    /// The format whose cyclic reply has this many data bytes, if there is one.
    pub fn of_reply_length(data_length: usize) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.reply_length() == data_length)
    }

    const fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::LittleEndian5x8 => u16::from_le_bytes(bytes),
            Self::BigEndian6x10 => u16::from_be_bytes(bytes),
        }
    }

    const fn u16_bytes(self, value: u16) -> [u8; 2] {
        match self {
            Self::LittleEndian5x8 => value.to_le_bytes(),
            Self::BigEndian6x10 => value.to_be_bytes(),
        }
    }

    const fn i32(self, bytes: [u8; 4]) -> i32 {
        match self {
            Self::LittleEndian5x8 => i32::from_le_bytes(bytes),
            Self::BigEndian6x10 => i32::from_be_bytes(bytes),
        }
    }

    const fn i32_bytes(self, value: i32) -> [u8; 4] {
        match self {
            Self::LittleEndian5x8 => value.to_le_bytes(),
            Self::BigEndian6x10 => value.to_be_bytes(),
        }
    }

    const fn i16(self, bytes: [u8; 2]) -> i16 {
        self.u16(bytes).cast_signed()
    }

    const fn i16_bytes(self, value: i16) -> [u8; 2] {
        self.u16_bytes(value.cast_unsigned())
    }
}

impl std::fmt::Display for WireFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::LittleEndian5x8 => "format A (little-endian, 5 and 8 bytes per axis)",
            Self::BigEndian6x10 => "format B (big-endian, 6 and 10 bytes per axis)",
        })
    }
}
