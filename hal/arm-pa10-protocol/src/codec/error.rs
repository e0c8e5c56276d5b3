//! Why bytes are no message, or a message no bytes.

use super::{Axis, WireFormat};

/// Why bytes are no message, or a message no bytes. Nothing is sent, and nothing of a refused packet is used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CodecError {
    /// A speed is not finite or does not fit its field.
    #[error(
        "{axis}: {speed_rad_per_s} rad/s is not a number within -6.5536 to 6.5534 rad/s, which the wire can carry; nothing is \
         sent, correct the command"
    )]
    SpeedRange {
        /// Which axis.
        axis: Axis,
        /// The speed given, rad/s.
        speed_rad_per_s: f64,
    },
    /// An angle is not finite or does not fit its field.
    #[error("{axis}: {angle_rad} rad is not a number within +-16470 rad, which the wire can carry; correct the angle")]
    AngleRange {
        /// Which axis.
        axis: Axis,
        /// The angle given, rad.
        angle_rad: f64,
    },
    /// A torque is not finite or does not fit its field.
    #[error("{axis}: a torque of {torque_n_m} N m cannot be expressed in 16 bits; correct the torque or its scale")]
    TorqueRange {
        /// Which axis.
        axis: Axis,
        /// The torque given, N m at the joint.
        torque_n_m: f64,
    },
    /// There is no axis of this number on the wire.
    #[error("there is no axis {got}: on the wire axes are 1 to 7, from the base; 0 is none")]
    AxisNumber {
        /// The number given.
        got: u16,
    },
    /// The packet is too short to have a sequence number and a letter, or too long for a short ARCNET packet.
    #[error(
        "a packet of {got} bytes: sequence number, letter and 0 to 252 bytes of data make 2 to 254; check the link"
    )]
    PacketLength {
        /// Length of the packet.
        got: usize,
    },
    /// The data of a letter has the wrong length.
    #[error("message {letter}: {got} bytes of data instead of {expected}; check the link and the arm's model")]
    Length {
        /// The letter of the message.
        letter: char,
        /// Length of the data.
        got: usize,
        /// What the letter demands.
        expected: usize,
    },
    /// The cyclic reply is one of the other wire format.
    #[error("the reply has the length of {got}, the configuration says {configured}; correct the wire format there")]
    OtherFormat {
        /// The format that has replies of this length.
        got: WireFormat,
        /// The format that was expected.
        configured: WireFormat,
    },
    /// The letter is none that this program knows or would ever send.
    #[error("message of type 0x{got:02x}: not one of the letters S, C, E, A, R; it is neither sent nor answered")]
    Letter {
        /// The type byte.
        got: u8,
    },
    /// The reply answers something else.
    #[error(
        "reply of type 0x{got:02x} to a message {expected}: not the answer to what was asked; the exchange is lost"
    )]
    ReplyLetter {
        /// The type byte of the reply.
        got: u8,
        /// The letter that was sent.
        expected: char,
    },
    /// The reply answers an earlier or no message.
    #[error("reply with sequence number {got} to message {expected}: stale or foreign; the exchange is lost")]
    Sequence {
        /// The reply's sequence number.
        got: u8,
        /// The message's sequence number.
        expected: u8,
    },
    /// The mode of an axis is none of those in use.
    #[error(
        "{axis}: mode 0x{mode:04x} is none of brake on (1), brake and servo on (3) and servo on (2); brake and servo both off, \
         torque control and other bits are not in use here"
    )]
    Mode {
        /// Which axis.
        axis: Axis,
        /// The mode found.
        mode: u16,
    },
    /// A field that must be zero is not.
    #[error("{axis}: {field} is {value} where it must be 0 (it is unused in this mode)")]
    NotZero {
        /// Which axis.
        axis: Axis,
        /// Name of the field.
        field: &'static str,
        /// What it holds.
        value: i16,
    },
    /// The supervision word has bits that are not in use.
    #[error("supervision word 0x{got:04x} of the command: only bit 3 (watch the dead-man switch) is in use")]
    Supervision {
        /// The word found.
        got: u16,
    },
    /// The axes of one command disagree on whether they react to alarms of other axes.
    #[error("{axis} disagrees with axis 1 on reacting to alarms of other axes: all axes or none")]
    MixedSupervision {
        /// The first axis that differs from axis 1.
        axis: Axis,
    },
    /// The format has no field for this.
    #[error("{format} has no place for {what}: leave it out, or choose the other format if the arm speaks it")]
    NotInFormat {
        /// What cannot be expressed.
        what: &'static str,
        /// The format.
        format: WireFormat,
    },
    /// The EEPROM reply is for another axis.
    #[error("EEPROM reply of board {board}, start {start} instead of {axis}; read it again")]
    EepromOfOtherAxis {
        /// The axis asked for.
        axis: Axis,
        /// Board in the reply.
        board: u8,
        /// Start in the reply.
        start: u8,
    },
    /// The EEPROM request is for a place where no axis has its table.
    #[error("EEPROM board {board}, start {start}: boards are 1 to 4, starts 0 or 32, and board 4 has one axis")]
    EepromPlace {
        /// Board asked for.
        board: u8,
        /// Start asked for.
        start: u8,
    },
    /// The limits in the EEPROM reply are no range around zero.
    #[error(
        "{axis}: the EEPROM says {negative_deg} to {positive_deg} degrees, which is no range around 0 within +-720; the layout of \
         this arm's table may differ, compare with its manual"
    )]
    EepromLimits {
        /// Which axis.
        axis: Axis,
        /// Lower limit read, degrees.
        negative_deg: f64,
        /// Upper limit read, degrees.
        positive_deg: f64,
    },
}
