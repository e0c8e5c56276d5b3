//! The envelope of every message.

use crc::{CRC_8_AUTOSAR, CRC_16_IBM_3740, Crc, Table};

use crate::codec::ByteBuffer;

/// Version of the protocol; another version is another protocol.
pub const PROTOCOL_VERSION: u8 = 1;

/// Longest payload.
pub const PAYLOAD_LENGTH_MAX: usize = 128;

/// Bytes of a frame besides its payload.
pub const OVERHEAD: usize = HEADER_LENGTH + 2;

/// Longest frame.
pub const FRAME_BYTES_MAX: usize = OVERHEAD + PAYLOAD_LENGTH_MAX;

/// A frame starts with these.
pub(super) const SYNC: [u8; 2] = [0xA5, 0x5A];

/// Sync bytes, version, arm, type, payload length, sequence, timestamp, header check.
pub(super) const HEADER_LENGTH: usize = 17;

const VERSION_AT: usize = 2;
const LENGTH_AT: usize = 5;
const HEADER_CHECK_AT: usize = 16;

static HEADER_CRC: Crc<u8, Table<1>> = Crc::<u8, Table<1>>::new(&CRC_8_AUTOSAR);
static FRAME_CRC: Crc<u16, Table<1>> = Crc::<u16, Table<1>>::new(&CRC_16_IBM_3740);

/// The data of a frame.
pub type Payload = ByteBuffer<PAYLOAD_LENGTH_MAX>;

/// An encoded frame.
pub type FrameBytes = ByteBuffer<FRAME_BYTES_MAX>;

/// Which arm a frame is for, or from: arms cannot be confused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ArmId(pub u8);

/// One frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// For or from this arm.
    pub arm: ArmId,
    /// What the payload is.
    pub frame_type: u8,
    /// Of a message of the host: one more than the one before. Of an answer: that of the message answered.
    pub sequence: u16,
    /// When it was sent, microseconds on the monotonic clock of the sender.
    pub timestamp_us: u64,
    /// The data.
    pub payload: Payload,
}

impl Frame {
    /// The bytes on the line.
    pub fn encode(&self) -> FrameBytes {
        let mut bytes = FrameBytes::EMPTY;
        bytes.extend(&SYNC);
        // The length fits: PAYLOAD_LENGTH_MAX is below 256.
        bytes.extend(&[PROTOCOL_VERSION, self.arm.0, self.frame_type, self.payload.len() as u8]);
        bytes.extend(&self.sequence.to_le_bytes());
        bytes.extend(&self.timestamp_us.to_le_bytes());
        bytes.extend(&[HEADER_CRC.checksum(&bytes[SYNC.len()..])]);
        bytes.extend(&self.payload);
        bytes.extend(&FRAME_CRC.checksum(&bytes[SYNC.len()..]).to_le_bytes());
        bytes
    }
}

/// What the start of some bytes is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Head {
    /// Not yet known: more bytes are needed.
    Incomplete,
    /// No sync bytes.
    NoSync,
    /// Sync bytes, but a header whose check or length is wrong.
    BadHeader,
    /// A sound header of another version of the protocol.
    OtherVersion,
    /// A sound header, but the frame's CRC is wrong.
    BadCrc,
    /// A frame of this many bytes.
    Sound { length: usize },
}

/// The start of a stream in which no other byte may stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FirstFrame {
    /// The start of a frame, or nothing.
    Incomplete {
        /// Length of the frame, or of the part that shows it: reading up to it takes no byte of what follows.
        needed: usize,
    },
    /// Something that is no frame.
    None,
    /// A sound frame.
    Frame {
        /// The frame.
        frame: Frame,
        /// Its bytes.
        length: usize,
    },
}

/// The frame at the start of these bytes: nothing is skipped.
pub fn first_frame(bytes: &[u8]) -> FirstFrame {
    match head(bytes) {
        Head::Incomplete if bytes.len() < OVERHEAD => FirstFrame::Incomplete { needed: OVERHEAD },
        Head::Incomplete => FirstFrame::Incomplete { needed: OVERHEAD + usize::from(bytes[LENGTH_AT]) },
        Head::Sound { length } => FirstFrame::Frame { frame: decode_sound(&bytes[..length]), length },
        Head::NoSync | Head::BadHeader | Head::OtherVersion | Head::BadCrc => FirstFrame::None,
    }
}

/// What these bytes start with.
pub(super) fn head(bytes: &[u8]) -> Head {
    let starts_like_sync = bytes.iter().zip(SYNC).all(|(got, expected)| *got == expected);
    if !starts_like_sync {
        return Head::NoSync;
    }
    let Some(header) = bytes.get(..HEADER_LENGTH) else { return Head::Incomplete };
    let payload_length = usize::from(header[LENGTH_AT]);
    if HEADER_CRC.checksum(&header[SYNC.len()..HEADER_CHECK_AT]) != header[HEADER_CHECK_AT] {
        return Head::BadHeader;
    }
    if header[VERSION_AT] != PROTOCOL_VERSION {
        return Head::OtherVersion;
    }
    if payload_length > PAYLOAD_LENGTH_MAX {
        return Head::BadHeader;
    }
    let length = OVERHEAD + payload_length;
    let Some(frame) = bytes.get(..length) else { return Head::Incomplete };
    let sent = u16::from_le_bytes([frame[length - 2], frame[length - 1]]);
    if FRAME_CRC.checksum(&frame[SYNC.len()..length - 2]) == sent { Head::Sound { length } } else { Head::BadCrc }
}

/// The frame in bytes that [`head`] found sound.
pub(super) fn decode_sound(frame: &[u8]) -> Frame {
    let mut timestamp = [0; 8];
    timestamp.copy_from_slice(&frame[8..16]);
    let mut payload = Payload::EMPTY;
    payload.extend(&frame[HEADER_LENGTH..frame.len() - 2]);
    Frame {
        arm: ArmId(frame[3]),
        frame_type: frame[4],
        sequence: u16::from_le_bytes([frame[6], frame[7]]),
        timestamp_us: u64::from_le_bytes(timestamp),
        payload,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checks_have_their_catalogued_values() {
        // As docs/arm-protocol.md states them for the ASCII text 123456789.
        assert_eq!(HEADER_CRC.checksum(b"123456789"), 0xDF);
        assert_eq!(FRAME_CRC.checksum(b"123456789"), 0x29B1);
    }

    #[test]
    fn a_header_of_another_version_is_distinguished_from_damage() {
        let frame = Frame {
            arm: ArmId(2),
            frame_type: 4,
            sequence: 0x0201,
            timestamp_us: 77,
            payload: Payload::from_slice(&[9, 8]).unwrap(),
        };
        let good = frame.encode().as_slice().to_vec();
        assert_eq!(head(&good), Head::Sound { length: OVERHEAD + 2 });
        assert_eq!(decode_sound(&good), frame);
        let mut other = good.clone();
        other[2] = 2;
        assert_eq!(head(&other), Head::BadHeader);
        other[16] = HEADER_CRC.checksum(&other[2..16]);
        assert_eq!(head(&other), Head::OtherVersion);
        let mut long = good.clone();
        long[5] = 129;
        long[16] = HEADER_CRC.checksum(&long[2..16]);
        assert_eq!(head(&long), Head::BadHeader);
        let mut damaged = good;
        damaged[18] ^= 1;
        assert_eq!(head(&damaged), Head::BadCrc);
        assert_eq!(head(&damaged[..20]), Head::Incomplete);
        assert_eq!(head(&[0xA5]), Head::Incomplete);
        assert_eq!(head(&[0xA5, 0xA5]), Head::NoSync);
    }
}
