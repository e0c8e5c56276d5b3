//! The line between host and gateway, with faults of frames.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10_emulation::mock_controller::{
    Fault, LineFault, MockController, MockControllerConfig, ReplyFault, Side,
};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, FrameParser, HostMessage, Received};
use pb3dp_arm_pa10_test_support::bus_bench::{START, plant};

/// HEARTBEAT stands for any frame.
fn frame() -> Vec<u8> {
    HostMessage::Heartbeat.frame(ArmId(4), 9, 77).encode().as_slice().to_vec()
}

/// A controller, for its line.
fn controller() -> MockController {
    let config = MockControllerConfig::new(WireFormat::BigEndian6x10);
    MockController::new(config, Arc::new(Mutex::new(plant())), 1, START).unwrap()
}

fn after(fault: LineFault, frames: usize) -> Vec<Vec<u8>> {
    let mut controller = controller();
    controller.inject(START, Fault::Line(fault));
    let (mut now, mut came) = (START, Vec::new());
    for _ in 0..frames {
        controller.send_on_line(now, &frame());
        now = now + Duration::from_millis(1);
        came.extend(std::iter::from_fn(|| controller.poll_line(now)).map(|bytes| bytes.as_slice().to_vec()));
    }
    came
}

#[test]
fn faults_of_the_line_happen_to_frames() {
    let answers = |kind| LineFault::Answers { kind, count: 2 };
    assert_eq!(after(answers(ReplyFault::Drop), 3), [frame()]);
    assert_eq!(after(answers(ReplyFault::Duplicate), 2).len(), 4);
    assert_eq!(after(LineFault::Silence(true), 3).len(), 0);
    let millis = Duration::from_millis;
    assert_eq!(after(LineFault::Slow(millis(2)), 5).len(), 4, "of 5 ms the last three frames are late by 2 ms");
    let readdressed = after(LineFault::WrongArm { count: 1 }, 2);
    assert_eq!((readdressed[0][3], &readdressed[1]), (5, &frame()));
    for damaged in [after(answers(ReplyFault::Corrupt), 3), after(answers(ReplyFault::Truncate), 3)] {
        assert!(damaged[0] != frame() && damaged[1] != frame() && damaged[2] == frame(), "{damaged:?}");
    }
    for (kind, sound) in [(LineFault::WrongArm { count: 1 }, true), (answers(ReplyFault::Corrupt), false)] {
        let mut parser = FrameParser::new(ArmId(4));
        let mut found = Vec::new();
        parser.feed(&after(kind, 1)[0], |received| found.push(received));
        assert_eq!(matches!(found[..], [Received::OtherArm(_)]), sound, "{found:?}");
    }
}

fn times(bytes: &[u8]) -> Vec<u64> {
    let mut times = Vec::new();
    FrameParser::new(ArmId(4)).feed(bytes, |received| {
        let (Received::Frame(frame) | Received::OtherArm(frame)) = received;
        times.push(frame.timestamp_us);
    });
    times
}

/// Repeated jumps, with wrap-around at zero, and in pieces of any size.
#[test]
fn a_clock_that_jumps_shows_in_every_frame_of_its_side() {
    let jump = |side, by_us| LineFault::ClockJump { side, by_us };
    let sent = after(jump(Side::Gateway, -78), 2);
    assert_eq!([times(&sent[0]), times(&sent[1])], [[u64::MAX], [u64::MAX]]);
    assert_eq!(after(jump(Side::Host, 5), 1), [frame()]);
    let mut controller = controller();
    let mut answer = Vec::new();
    for by_us in [3_600_000_000, -600_000_000] {
        controller.inject(START, Fault::Line(jump(Side::Host, by_us)));
        for piece in [frame(), frame()].concat().chunks(7) {
            controller.hear_on_line(START, piece, |bytes| answer.extend_from_slice(bytes));
        }
    }
    assert_eq!(times(&answer), [3_600_000_077, 3_600_000_077, 3_000_000_077, 3_000_000_077]);
}

#[test]
fn a_slow_reader_takes_so_many_bytes_in_a_second() {
    let read = |rate: Option<u32>| {
        let mut controller = controller();
        controller.inject(START, Fault::Line(LineFault::SlowReader { bytes_per_second: rate }));
        let (mut now, mut count) = (START + Duration::from_secs(100), 0);
        for _ in 0..2000 {
            now = now + Duration::from_millis(1);
            let bytes = [0; 50];
            let room = controller.readable_on_line(now).min(bytes.len());
            controller.hear_on_line(now, &bytes[..room], |answer| count += answer.len());
            let again = controller.reads_line_again();
            assert!(controller.readable_on_line(now) > 0 || rate == Some(0) || again.is_some_and(|again| again > now));
        }
        count
    };
    assert_eq!([read(None), read(Some(0))], [100_000, 0]);
    for rate in [1, 30, 600, 5000, 20_000] {
        // The bytes of 2 s, plus those accepted at once.
        let expected = 2 * rate as usize;
        assert!((expected..=expected + 1 + rate as usize / 100 + 50).contains(&read(Some(rate))), "{rate}");
    }
}
