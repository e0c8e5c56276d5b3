//! Packets: sequence number, letter, data.

use super::{ArmCommand, ArmReply, Axis, ByteBuffer, CodecError, EepromAxis, WireFormat, eeprom};

/// Most data bytes of a short ARCNET packet that has a sequence number and a letter.
pub const DATA_LENGTH_MAX: usize = 252;

/// Longest packet.
pub const PACKET_LENGTH_MAX: usize = 2 + DATA_LENGTH_MAX;

/// An encoded packet: sequence number, letter, data.
pub type Packet = ByteBuffer<PACKET_LENGTH_MAX>;

/// The letter of a message. M (set the mechanical zero), W and P (write the EEPROM) do not exist here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Letter {
    /// S: start of the control mode; the brakes stay on.
    Start,
    /// C: cyclic command; its reply carries the state.
    Cyclic,
    /// E: end of the control mode.
    End,
    /// A: clear the alarm of one axis.
    ClearAlarm,
    /// R: read the EEPROM.
    ReadEeprom,
    /// T: start of the brake-release mode. The arm falls.
    #[cfg(feature = "brake-release")]
    ReleaseBrakes,
}

impl Letter {
    /// The byte on the wire.
    pub const fn byte(self) -> u8 {
        match self {
            Self::Start => b'S',
            Self::Cyclic => b'C',
            Self::End => b'E',
            Self::ClearAlarm => b'A',
            Self::ReadEeprom => b'R',
            #[cfg(feature = "brake-release")]
            Self::ReleaseBrakes => b'T',
        }
    }

    /// The letter of a byte.
    ///
    /// # Errors
    /// If it is none of those in use.
    pub fn from_byte(byte: u8) -> Result<Self, CodecError> {
        Ok(match byte {
            b'S' => Self::Start,
            b'C' => Self::Cyclic,
            b'E' => Self::End,
            b'A' => Self::ClearAlarm,
            b'R' => Self::ReadEeprom,
            #[cfg(feature = "brake-release")]
            b'T' => Self::ReleaseBrakes,
            got => return Err(CodecError::Letter { got }),
        })
    }
}

/// A message to the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlMessage {
    /// Start of the control mode; the brakes stay on.
    Start,
    /// What the axes are to do; the controller expects one every 2 ms.
    Cyclic(ArmCommand),
    /// End of the control mode: back to the adjustment mode, brakes on.
    End,
    /// Clear the alarm of an axis (Orca; whether controllers of the C series know it is unknown).
    ClearAlarm(Axis),
    /// Read the table of an axis (SDU).
    ReadEeprom(Axis),
    /// Start of the brake-release mode. All axes fall.
    #[cfg(feature = "brake-release")]
    ReleaseBrakes,
}

impl ControlMessage {
    /// Its letter.
    pub fn letter(&self) -> Letter {
        match self {
            Self::Start => Letter::Start,
            Self::Cyclic(_) => Letter::Cyclic,
            Self::End => Letter::End,
            Self::ClearAlarm(_) => Letter::ClearAlarm,
            Self::ReadEeprom(_) => Letter::ReadEeprom,
            #[cfg(feature = "brake-release")]
            Self::ReleaseBrakes => Letter::ReleaseBrakes,
        }
    }

    /// Its data.
    ///
    /// # Errors
    /// If the format cannot express it.
    pub fn encode_data(&self, format: WireFormat) -> Result<ByteBuffer<DATA_LENGTH_MAX>, CodecError> {
        let mut data = ByteBuffer::EMPTY;
        match self {
            Self::Start | Self::End => {}
            #[cfg(feature = "brake-release")]
            Self::ReleaseBrakes => {}
            Self::Cyclic(command) => command.encode(format, &mut data)?,
            Self::ClearAlarm(axis) => data.extend(&u16::from(axis.number()).to_be_bytes()),
            Self::ReadEeprom(axis) => data.extend(&eeprom::place(*axis)),
        }
        Ok(data)
    }

    /// A message from its letter and data.
    ///
    /// # Errors
    /// If the data does not have the length of the letter or says what is never sent.
    pub fn decode_data(format: WireFormat, letter: Letter, data: &[u8]) -> Result<Self, CodecError> {
        let with_length = |expected: usize| {
            let letter = char::from(letter.byte());
            if data.len() == expected {
                Ok(data)
            } else {
                Err(CodecError::Length { letter, got: data.len(), expected })
            }
        };
        Ok(match letter {
            Letter::Start => with_length(0).map(|_| Self::Start)?,
            Letter::End => with_length(0).map(|_| Self::End)?,
            #[cfg(feature = "brake-release")]
            Letter::ReleaseBrakes => with_length(0).map(|_| Self::ReleaseBrakes)?,
            Letter::Cyclic => Self::Cyclic(ArmCommand::decode(format, data)?),
            Letter::ClearAlarm => {
                let number = with_length(2)?;
                Self::ClearAlarm(Axis::from_number(u16::from_be_bytes([number[0], number[1]]))?)
            }
            Letter::ReadEeprom => {
                let place = with_length(2)?;
                Self::ReadEeprom(eeprom::axis_at(place[0], place[1])?)
            }
        })
    }
}

/// A message to the controller with its sequence number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControlPacket {
    /// From [`super::SequenceModulus::reduce`]: never that of the message before.
    pub sequence: u8,
    /// What is said.
    pub message: ControlMessage,
}

impl ControlPacket {
    /// The packet's bytes.
    ///
    /// # Errors
    /// If the format cannot express the message.
    pub fn encode(&self, format: WireFormat) -> Result<Packet, CodecError> {
        let data = self.message.encode_data(format)?;
        Ok(packet(self.sequence, self.message.letter(), &data))
    }

    /// The packet of these bytes, as a controller reads it.
    ///
    /// # Errors
    /// If the bytes are no packet that this program would send.
    pub fn decode(format: WireFormat, bytes: &[u8]) -> Result<Self, CodecError> {
        let (sequence, letter, data) = parts(bytes)?;
        let message = ControlMessage::decode_data(format, Letter::from_byte(letter)?, data)?;
        Ok(Self { sequence, message })
    }
}

/// What a reply says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplyMessage {
    /// To C: what the arm measures.
    Cyclic(ArmReply),
    /// To R: the table of an axis.
    Eeprom(EepromAxis),
    /// To any other letter. Whether such replies carry data is unknown, so any data is accepted and dropped.
    Done(Letter),
}

/// A reply of the controller with the sequence number that it echoes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplyPacket {
    /// The number of the message that is answered.
    pub sequence: u8,
    /// The answer.
    pub message: ReplyMessage,
}

impl ReplyPacket {
    /// The packet's bytes, as a controller writes them.
    ///
    /// # Errors
    /// If the format cannot express the reply.
    pub fn encode(&self, format: WireFormat) -> Result<Packet, CodecError> {
        let mut data = ByteBuffer::EMPTY;
        let letter = match &self.message {
            ReplyMessage::Cyclic(reply) => reply.encode(format, &mut data).map(|()| Letter::Cyclic)?,
            ReplyMessage::Eeprom(table) => {
                table.encode(&mut data);
                Letter::ReadEeprom
            }
            ReplyMessage::Done(letter) => *letter,
        };
        Ok(packet(self.sequence, letter, &data))
    }

    /// The reply to `asked` in these bytes.
    ///
    /// # Errors
    /// If it answers another message, or its data is not what that letter brings.
    pub fn decode(format: WireFormat, asked: &ControlPacket, bytes: &[u8]) -> Result<Self, CodecError> {
        let (sequence, letter, data) = parts(bytes)?;
        if sequence != asked.sequence {
            return Err(CodecError::Sequence { got: sequence, expected: asked.sequence });
        }
        Ok(Self { sequence, message: ReplyMessage::decode_data(format, &asked.message, letter, data)? })
    }
}

impl ReplyMessage {
    /// The answer to `asked` from the letter and the data of a reply.
    ///
    /// # Errors
    /// If it answers another letter, or its data is not what that letter brings.
    pub fn decode_data(
        format: WireFormat,
        asked: &ControlMessage,
        letter: u8,
        data: &[u8],
    ) -> Result<Self, CodecError> {
        let expected = asked.letter();
        if letter != expected.byte() {
            return Err(CodecError::ReplyLetter { got: letter, expected: char::from(expected.byte()) });
        }
        Ok(match asked {
            ControlMessage::Cyclic(_) => Self::Cyclic(ArmReply::decode(format, data)?),
            ControlMessage::ReadEeprom(axis) => Self::Eeprom(EepromAxis::decode(*axis, data)?),
            _ => Self::Done(expected),
        })
    }
}

/// Where a packet with this many data bytes starts in the packet memory of the ARCNET chip: it ends at address 255.
///
/// # Errors
/// If the data is too long for a short packet.
pub fn packet_pointer(data_length: usize) -> Result<u8, CodecError> {
    let length = data_length.saturating_add(2);
    if data_length > DATA_LENGTH_MAX {
        return Err(CodecError::PacketLength { got: length });
    }
    u8::try_from(256 - length).map_err(|_| CodecError::PacketLength { got: length })
}

fn packet(sequence: u8, letter: Letter, data: &[u8]) -> Packet {
    let mut packet = Packet::EMPTY;
    packet.extend(&[sequence, letter.byte()]);
    packet.extend(data);
    packet
}

fn parts(bytes: &[u8]) -> Result<(u8, u8, &[u8]), CodecError> {
    match bytes {
        [sequence, letter, data @ ..] if data.len() <= DATA_LENGTH_MAX => Ok((*sequence, *letter, data)),
        _ => Err(CodecError::PacketLength { got: bytes.len() }),
    }
}
