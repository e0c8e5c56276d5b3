//! ARCNET frames as a raw Linux socket (`AF_PACKET` on an ARCNET interface) takes and gives them. Pure functions, no socket.
//!
//! A frame is sender, receiver, two offset bytes, then the packet of the codec (sequence number, letter, data). For short packets
//! the first offset byte points to the packet in the memory of the chip, which tells its length; the second one is not in use, and
//! neither Linux nor the controller looks at it (Orca fills in 0xB7).

use crate::codec::{CodecError, PACKET_LENGTH_MAX, Packet, packet_pointer};

/// Node number of the host (SDU, Orca, RobWork).
pub const HOST_NODE: u8 = 0xFF;

/// Node number of the servo controller (SDU, Orca, RobWork).
pub const CONTROLLER_NODE: u8 = 0xFE;

/// Longest frame.
pub const FRAME_LENGTH_MAX: usize = HEADER_LENGTH + PACKET_LENGTH_MAX;

/// Sender, receiver and two offset bytes.
const HEADER_LENGTH: usize = 4;

/// What stands in the second offset byte of frames that are sent, as Orca does it on a real arm.
const FILLER: u8 = 0xB7;

/// A frame as it goes through a raw socket.
pub type Frame = crate::codec::ByteBuffer<FRAME_LENGTH_MAX>;

/// Two nodes of the bus, by the way of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route {
    /// Who sends.
    pub sender: u8,
    /// Who receives.
    pub receiver: u8,
}

impl Route {
    /// From the host to the controller.
    pub const TO_CONTROLLER: Self = Self { sender: HOST_NODE, receiver: CONTROLLER_NODE };

    /// From the controller to the host.
    pub const TO_HOST: Self = Self { sender: CONTROLLER_NODE, receiver: HOST_NODE };
}

/// Why bytes are no ARCNET frame for us.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Too short or too long.
    #[error(
        "ARCNET frame of {got} bytes: a short frame with a packet has 6 to 258; check that the interface is in raw mode"
    )]
    Length {
        /// Length of the frame.
        got: usize,
    },
    /// From or for somebody else.
    #[error(
        "ARCNET frame from node 0x{:02x} to 0x{:02x} instead of 0x{:02x} to 0x{:02x}; check the node numbers on the bus",
        got.sender, got.receiver, expected.sender, expected.receiver
    )]
    Route {
        /// The nodes in the frame.
        got: Route,
        /// The nodes expected.
        expected: Route,
    },
    /// The pointer does not belong to a packet of this length.
    #[error("ARCNET frame with packet pointer {got} and {length} bytes of packet, for which it must be {expected}")]
    Pointer {
        /// The pointer in the frame.
        got: u8,
        /// The pointer that the length demands.
        expected: u8,
        /// Bytes of packet in the frame.
        length: usize,
    },
}

/// The frame that carries a packet.
///
/// # Errors
/// If the packet has no letter.
pub fn encode(route: Route, packet: &Packet) -> Result<Frame, CodecError> {
    let too_short = CodecError::PacketLength { got: packet.len() };
    let pointer = packet_pointer(packet.len().checked_sub(2).ok_or(too_short)?)?;
    let mut frame = Frame::EMPTY;
    frame.extend(&[route.sender, route.receiver, pointer, FILLER]);
    frame.extend(packet);
    Ok(frame)
}

/// The packet in a frame that came this way.
///
/// # Errors
/// If the frame came another way, or its pointer and length disagree.
pub fn decode(expected: Route, frame: &[u8]) -> Result<&[u8], FrameError> {
    let wrong_length = FrameError::Length { got: frame.len() };
    let Some((&[sender, receiver, pointer, _filler], packet)) = frame.split_first_chunk::<HEADER_LENGTH>() else {
        return Err(wrong_length);
    };
    let got = Route { sender, receiver };
    if got != expected {
        return Err(FrameError::Route { got, expected });
    }
    let data_length = packet.len().checked_sub(2).ok_or(wrong_length)?;
    let demanded = packet_pointer(data_length).map_err(|_| wrong_length)?;
    if pointer != demanded {
        return Err(FrameError::Pointer { got: pointer, expected: demanded, length: packet.len() });
    }
    Ok(packet)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::codec::{ArmCommand, AxisCommand, ControlMessage, ControlPacket, Supervision, WireFormat};

    fn packet_of(bytes: &[u8]) -> Packet {
        Packet::from_slice(bytes).unwrap()
    }

    #[test]
    fn frames_have_the_golden_header() {
        let command = ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Off, Supervision::default()));
        for (format, pointer) in [(WireFormat::LittleEndian5x8, 219), (WireFormat::BigEndian6x10, 210)] {
            let packet = ControlPacket { sequence: 0x11, message: command }.encode(format).unwrap();
            let frame = encode(Route::TO_CONTROLLER, &packet).unwrap();
            assert_eq!(frame[..7], [0xFF, 0xFE, pointer, 0xB7, 0x11, b'C', packet[2]]);
            assert_eq!(frame.len(), 4 + packet.len());
            assert_eq!(decode(Route::TO_CONTROLLER, &frame), Ok(packet.as_slice()));
        }
        let frame = encode(Route::TO_HOST, &packet_of(&[3, b'E'])).unwrap();
        assert_eq!(frame.as_slice(), [0xFE, 0xFF, 254, 0xB7, 3, b'E']);
    }

    #[test]
    fn frames_that_are_not_ours_are_refused_by_name() {
        let foreign = [0x05, 0xFF, 254, 0, 3, b'E'];
        let error = decode(Route::TO_HOST, &foreign).unwrap_err();
        assert_eq!(error, FrameError::Route { got: Route { sender: 5, receiver: 0xFF }, expected: Route::TO_HOST });
        assert!(error.to_string().contains("node 0x05 to 0xff instead of 0xfe to 0xff"), "{error}");
        let cut = [0xFE, 0xFF, 219, 0, 3, b'C', 1, 2, 3];
        let error = decode(Route::TO_HOST, &cut).unwrap_err();
        assert_eq!(error, FrameError::Pointer { got: 219, expected: 251, length: 5 });
        for length in [0, 3, 5, 259, 4000] {
            let mut frame = vec![0; length];
            frame.iter_mut().zip([0xFE, 0xFF]).for_each(|(byte, node)| *byte = node);
            assert_eq!(decode(Route::TO_HOST, &frame), Err(FrameError::Length { got: length }));
        }
        assert_eq!(encode(Route::TO_HOST, &packet_of(&[1])), Err(CodecError::PacketLength { got: 1 }));
    }

    proptest! {
        #[test]
        fn packets_come_back_whatever_the_filler(packet in prop::collection::vec(any::<u8>(), 2..=254), filler: u8) {
            let mut frame = encode(Route::TO_HOST, &packet_of(&packet)).unwrap().as_slice().to_vec();
            frame[3] = filler;
            prop_assert_eq!(decode(Route::TO_HOST, &frame), Ok(&packet[..]));
            prop_assert!(decode(Route::TO_CONTROLLER, &frame).is_err());
        }

        #[test]
        fn any_bytes_are_a_packet_or_an_error(frame in prop::collection::vec(any::<u8>(), 0..300)) {
            if let Ok(packet) = decode(Route::TO_HOST, &frame) {
                prop_assert_eq!(packet, &frame[4..]);
            }
        }
    }
}
