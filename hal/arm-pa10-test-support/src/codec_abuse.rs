//! Properties that hold for any bytes: shared by the fuzz targets in `tests/fuzz` and the test with random bytes.

#![allow(clippy::unwrap_used, reason = "what fails here is found by it")]

use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{
    ArmCommand, Axis, AxisCommand, ControlMessage, ControlPacket, ReplyMessage, ReplyPacket, Supervision, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, Frame, FrameParser, GatewayMessage, HostMessage, OVERHEAD, PAYLOAD_LENGTH_MAX, Payload, Received,
};

const ARM: ArmId = ArmId(1);

/// Packets of both wire formats and ARCNET frames.
pub fn codecs_survive(bytes: &[u8]) {
    let Some((&choice, packet)) = bytes.split_first() else { return };
    let format = WireFormat::ALL[usize::from(choice & 1)];
    if let Ok(decoded) = ControlPacket::decode(format, packet) {
        assert_eq!(decoded.encode(format).unwrap().as_slice(), packet, "two forms of {decoded:?}");
    }
    let axis = Axis::ALL[usize::from(choice >> 1) % Axis::COUNT];
    let sequence = packet.first().copied().unwrap_or(choice);
    for message in [
        ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Off, Supervision::default())),
        ControlMessage::ReadEeprom(axis),
        ControlMessage::ClearAlarm(axis),
        ControlMessage::Start,
        ControlMessage::End,
    ] {
        let asked = ControlPacket { sequence, message };
        let Ok(reply) = ReplyPacket::decode(format, &asked, packet) else { continue };
        let again = reply.encode(format).unwrap();
        assert_eq!(ReplyPacket::decode(format, &asked, &again), Ok(reply));
        if let ReplyMessage::Cyclic(arm) = reply.message {
            assert_eq!(again.as_slice(), packet);
            assert!(arm.position_rad().iter().all(|angle| angle.is_finite()));
        }
    }
    for route in [Route::TO_HOST, Route::TO_CONTROLLER] {
        if let Ok(inner) = arcnet::decode(route, bytes) {
            assert_eq!(inner, &bytes[4..]);
        }
    }
}

/// A stream as the bytes describe it: garbage, valid frames and damaged ones.
pub fn gateway_stream_survives(bytes: &[u8]) {
    let mut stream = Vec::new();
    let mut sent = Vec::new();
    let mut rest = bytes;
    while let [what, length, tail @ ..] = rest {
        let (body, later) = tail.split_at(tail.len().min(usize::from(*length)));
        rest = later;
        if what % 4 == 0 {
            stream.extend_from_slice(body);
            continue;
        }
        let payload = Payload::from_slice(&body[..body.len().min(PAYLOAD_LENGTH_MAX)]).unwrap();
        let frame = Frame { arm: ARM, frame_type: *what, sequence: u16::from(*length), timestamp_us: 5, payload };
        let mut encoded = frame.encode().as_slice().to_vec();
        if what % 4 == 1 {
            let at = usize::from(*length) % encoded.len();
            encoded[at] ^= what | 1;
        } else {
            sent.push(frame);
        }
        stream.extend(encoded);
    }
    let mut found = Vec::new();
    let mut parser = FrameParser::new(ARM);
    let piece = usize::from(bytes.first().copied().unwrap_or(1)) + 1;
    for piece in stream.chunks(piece) {
        parser.feed(piece, |received| found.push(received));
    }
    parser.handle_silence(|received| found.push(received));
    assert!(!parser.is_within_frame());

    let frames = found.iter().map(|received| match received {
        Received::Frame(frame) | Received::OtherArm(frame) => frame,
    });
    let in_frames: usize = frames.clone().map(|frame| OVERHEAD + frame.payload.len()).sum();
    assert_eq!(in_frames + parser.counters().skipped_bytes as usize, stream.len());
    // Valid frames are found in their order, unless the garbage contains a valid frame that swallows some.
    let foreign = frames.clone().any(|frame| !sent.contains(frame));
    let mut expected = sent.iter();
    let mut next = expected.next();
    for frame in frames {
        if Some(frame) == next {
            next = expected.next();
        }
        messages_survive(frame);
    }
    assert!(next.is_none() || foreign, "{next:?} was lost");
}

/// A frame with these bytes as type and payload.
pub fn gateway_frame_survives(bytes: &[u8]) {
    let [frame_type, payload @ ..] = bytes else { return };
    let Some(payload) = Payload::from_slice(payload) else { return };
    messages_survive(&Frame { arm: ARM, frame_type: *frame_type, sequence: 3, timestamp_us: 4, payload });
}

fn messages_survive(frame: &Frame) {
    if let Ok(message) = HostMessage::decode(frame) {
        assert_eq!(message.frame(frame.arm, frame.sequence, frame.timestamp_us), *frame, "two forms of {message:?}");
    }
    if let Ok(message) = GatewayMessage::decode(frame) {
        assert_eq!(message.frame(frame.arm, frame.sequence, frame.timestamp_us), *frame, "two forms of {message:?}");
    }
}
