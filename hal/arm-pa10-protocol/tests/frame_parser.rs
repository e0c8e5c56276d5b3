//! The parser finds frames between any other bytes.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, FRAME_BYTES_MAX, Frame, FrameParser, OVERHEAD, PAYLOAD_LENGTH_MAX, Payload, Received,
};
use proptest::prelude::*;

const ARM: ArmId = ArmId(7);

fn frames() -> impl Strategy<Value = Frame> {
    let payload = prop::collection::vec(any::<u8>(), 0..=PAYLOAD_LENGTH_MAX);
    (any::<u8>(), any::<u16>(), any::<u64>(), payload).prop_map(|(frame_type, sequence, timestamp_us, payload)| Frame {
        arm: ARM,
        frame_type,
        sequence,
        timestamp_us,
        payload: Payload::from_slice(&payload).unwrap(),
    })
}

/// Bytes that contain the beginning of a frame more often than random bytes do.
fn garbage(length: usize) -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![3 => any::<u8>(), 1 => Just(0xA5), 1 => Just(0x5A), 1 => Just(0x01)];
    prop::collection::vec(byte, 0..length)
}

/// All frames in these bytes, fed in pieces of the given size, followed by silence.
fn parse(bytes: &[u8], piece: usize) -> (Vec<Frame>, FrameParser) {
    let mut parser = FrameParser::new(ARM);
    let mut found = Vec::new();
    for piece in bytes.chunks(piece.max(1)) {
        parser.feed(piece, |received| found.extend(frame_of(received)));
    }
    parser.handle_silence(|received| found.extend(frame_of(received)));
    assert!(!parser.is_within_frame());
    (found, parser)
}

fn frame_of(received: Received) -> Option<Frame> {
    match received {
        Received::Frame(frame) => Some(frame),
        Received::OtherArm(_) => None,
    }
}

fn stream(frames: &[Frame]) -> Vec<u8> {
    frames.iter().flat_map(|frame| frame.encode().as_slice().to_vec()).collect()
}

/// Whether the bytes begin with a valid frame that was not sent.
///
/// The CRC has 16 bits: one damaged frame in 65 536 passes, with bytes of the next frame at its end. No parser can detect this.
fn is_sound_by_chance(found: &Frame, sent: &[Frame], damaged: &[u8]) -> bool {
    !sent.contains(found) && damaged.starts_with(found.encode().as_slice())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn a_clean_stream_is_all_frames_in_pieces_of_any_size(
        sent in prop::collection::vec(frames(), 1..6), piece in 1usize..300
    ) {
        let (found, parser) = parse(&stream(&sent), piece);
        prop_assert_eq!(&found, &sent);
        let counters = parser.counters();
        prop_assert_eq!((counters.frames, counters.resyncs, counters.skipped_bytes), (sent.len() as u64, 0, 0));
    }

    #[test]
    fn a_frame_behind_any_garbage_is_found(garbage in garbage(400), sent in frames(), piece in 1usize..300) {
        let mut bytes = garbage;
        bytes.extend(sent.encode().as_slice());
        let (found, _) = parse(&bytes, piece);
        prop_assert!(found.contains(&sent), "{found:?}");
    }

    /// Also without silence: at the latest after further bytes of the length of the longest frame.
    #[test]
    fn a_frame_behind_any_garbage_is_not_kept_back(garbage in garbage(400), sent in frames(), rest in frames()) {
        let mut parser = FrameParser::new(ARM);
        let mut found = Vec::new();
        let mut bytes = garbage;
        bytes.extend(sent.encode().as_slice());
        let behind: Vec<u8> = rest.encode().as_slice().iter().copied().cycle().take(FRAME_BYTES_MAX).collect();
        bytes.extend(behind);
        parser.feed(&bytes, |received| found.extend(frame_of(received)));
        prop_assert!(found.contains(&sent), "{found:?}");
    }

    #[test]
    fn a_corrupted_frame_costs_itself_alone(
        before in frames(), hit in frames(), after in frames(), at in 0usize..FRAME_BYTES_MAX, flip in 1u8.., piece in 1usize..300
    ) {
        let mut damaged = hit.encode().as_slice().to_vec();
        let at = at % damaged.len();
        damaged[at] ^= flip;
        let mut bytes = stream(&[before]);
        bytes.extend(&damaged);
        bytes.extend(stream(&[after]));
        let (found, parser) = parse(&bytes, piece);
        // One wrong byte is at most 8 wrong bits in a row: both checks detect all of these, anywhere.
        prop_assert_eq!(found, [before, after]);
        prop_assert!(parser.counters().resyncs == 1, "{:?}", parser.counters());
    }

    #[test]
    fn a_truncated_frame_costs_one_frame(
        before in frames(), hit in frames(), after in prop::collection::vec(frames(), 1..4), keep in 0usize..FRAME_BYTES_MAX,
        piece in 1usize..300
    ) {
        let whole = hit.encode();
        let keep = keep % whole.len();
        let damaged = [&whole[..keep], &stream(&after)].concat();
        let (found, _) = parse(&[stream(&[before]), damaged.clone()].concat(), piece);
        let without_hit: Vec<Frame> = [before].into_iter().chain(after.iter().copied()).collect();
        // If the missing end equals the beginning of the next frame, the next frame loses its beginning instead.
        let without_next: Vec<Frame> = [before, hit].into_iter().chain(after[1..].iter().copied()).collect();
        let chance = found.get(1).is_some_and(|frame| is_sound_by_chance(frame, &without_next, &damaged));
        prop_assert!(found == without_hit || found == without_next || chance, "{found:?}");
    }

    #[test]
    fn lost_and_doubled_bytes_cost_one_frame(
        before in frames(), hit in frames(), after in frames(), at in 0usize..FRAME_BYTES_MAX, double: bool
    ) {
        let mut damaged = hit.encode().as_slice().to_vec();
        let at = at % damaged.len();
        let byte = damaged.remove(at);
        if double {
            damaged.splice(at..at, [byte, byte]);
        }
        damaged.extend(stream(&[after]));
        let (found, _) = parse(&[stream(&[before]), damaged.clone()].concat(), 64);
        let sent = [before, hit, after];
        let lost = sent.iter().filter(|frame| !found.contains(frame)).count();
        let chance = found.get(1).is_some_and(|frame| is_sound_by_chance(frame, &sent, &damaged));
        prop_assert!(found.contains(&before) && (lost <= 1 || chance), "{found:?}");
    }

    #[test]
    fn any_bytes_are_survived_and_accounted_for(bytes in garbage(3000), piece in 1usize..300) {
        let (found, parser) = parse(&bytes, piece);
        let in_frames: usize = found.iter().map(|frame| OVERHEAD + frame.payload.len()).sum();
        let counters = parser.counters();
        if counters.wrong_arm == 0 {
            prop_assert_eq!(counters.skipped_bytes as usize + in_frames, bytes.len());
        }
    }
}

fn frame(payload: &[u8]) -> Frame {
    Frame {
        arm: ARM,
        frame_type: 0x82,
        sequence: 3,
        timestamp_us: 12_345,
        payload: Payload::from_slice(payload).unwrap(),
    }
}

#[test]
fn each_kind_of_damage_has_its_counter() {
    let good = frame(&[1, 2, 3]).encode().as_slice().to_vec();
    let counters = |bytes: &[u8]| {
        let (found, parser) = parse(bytes, 1000);
        assert!(found.is_empty(), "{found:?}");
        *parser.counters()
    };
    let mut wrong_crc = good.clone();
    wrong_crc[18] ^= 0x40;
    assert_eq!((counters(&wrong_crc).crc_errors, counters(&wrong_crc).resyncs), (1, 1));
    let mut wrong_header = good.clone();
    wrong_header[5] ^= 0x10;
    assert_eq!((counters(&wrong_header).header_errors, counters(&wrong_header).crc_errors), (1, 0));
    assert_eq!(counters(&good[..good.len() - 1]).truncated, 1);
    let other = Frame { arm: ArmId(8), ..frame(&[1]) }.encode();
    assert_eq!((counters(&other).wrong_arm, counters(&other).frames, counters(&other).skipped_bytes), (1, 0, 0));
}

#[test]
fn a_missing_end_that_the_next_frame_begins_with_costs_one_frame() {
    let ends_like_sync = |frame: &Frame| frame.encode().last() == Some(&0xA5);
    let hit = (0..=u8::MAX).map(|byte| frame(&[byte])).find(ends_like_sync).unwrap();
    let (whole, next, last) = (hit.encode(), frame(&[1]), frame(&[2]));
    let mut bytes = whole[..whole.len() - 1].to_vec();
    bytes.extend(stream(&[next, last]));
    assert_eq!(parse(&bytes, 64).0, [hit, last]);
}

#[test]
fn a_frame_that_is_sound_by_chance_costs_the_frames_that_it_reaches_into() {
    let (next, last) = (frame(&[1]), frame(&[2]));
    let behind = stream(&[next, last]);
    let with_a_byte_lost = |payload: u32| {
        let whole = frame(&payload.to_le_bytes()).encode();
        [&whole[..17], &whole[18..], &behind].concat()
    };
    let taken_for_sound: Vec<_> =
        (0..500_000).map(with_a_byte_lost).filter(|bytes| parse(bytes, 64).0 != [next, last]).collect();
    assert!(!taken_for_sound.is_empty());
    for bytes in taken_for_sound {
        let (found, _) = parse(&bytes, 64);
        assert!(is_sound_by_chance(&found[0], &[next, last], &bytes) && found[1..] == [last], "{found:?}");
    }
}

#[test]
fn a_damaged_length_does_not_keep_the_next_frame_waiting() {
    // The damaged length is 128 bytes too large: without a header check, the next frames would have to wait.
    let mut bytes = frame(&[]).encode().as_slice().to_vec();
    bytes[5] ^= 0x80;
    let next = frame(&[4]);
    bytes.extend(next.encode().as_slice());
    let mut parser = FrameParser::new(ARM);
    let mut found = Vec::new();
    parser.feed(&bytes, |received| found.extend(frame_of(received)));
    assert_eq!(found, [next]);
}

#[test]
fn a_frame_of_another_arm_is_handed_on_as_such() {
    let other = Frame { arm: ArmId(8), ..frame(&[9]) };
    let mut found = Vec::new();
    FrameParser::new(ARM).feed(&other.encode(), |received| found.push(received));
    assert_eq!(found, [Received::OtherArm(other)]);
}

#[test]
fn a_link_opened_anew_forgets_half_a_frame() {
    let whole = frame(&[1, 2]).encode();
    let mut parser = FrameParser::new(ARM);
    let mut found = Vec::new();
    parser.feed(&whole[..10], |received| found.push(received));
    parser.restart();
    parser.feed(&whole, |received| found.push(received));
    assert_eq!(found, [Received::Frame(frame(&[1, 2]))]);
    assert_eq!(parser.counters().resyncs, 0);
}
