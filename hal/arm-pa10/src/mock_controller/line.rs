//! The line between host and gateway: what happens to frames there.

use pb3dp_geometry::MonotonicTime;

use super::fault::LineFault;
use super::outbox::Outbox;
use super::random::Random;
use crate::arcnet;
use crate::gateway_protocol::{ArmId, Frame, FrameParser, Received};

/// Where a frame names its arm.
const ARM_AT: usize = 3;

/// The line between host and gateway.
#[derive(Clone, Debug)]
pub(super) struct Line {
    outbox: Outbox,
    wrong_arm: u32,
    is_deaf: bool,
}

impl Line {
    pub fn new(random: Random) -> Self {
        Self { outbox: Outbox::new(random), wrong_arm: 0, is_deaf: false }
    }

    pub fn inject(&mut self, fault: LineFault) {
        match fault {
            LineFault::Answers { kind, count } => self.outbox.spoil(kind, count),
            LineFault::WrongArm { count } => self.wrong_arm = count,
            LineFault::Delay { count, by } => self.outbox.delay(count, by),
            LineFault::Slow(by) => self.outbox.slow = by,
            LineFault::Silence(on) => self.outbox.silent = on,
            LineFault::Deaf(on) => self.is_deaf = on,
        }
    }

    pub fn is_deaf(&self) -> bool {
        self.is_deaf
    }

    /// A frame on its way to the host.
    pub fn send(&mut self, now: MonotonicTime, frame: &[u8]) {
        let mut frame = frame.to_vec();
        if self.wrong_arm > 0 {
            self.wrong_arm -= 1;
            frame = readdressed(frame);
        }
        // Frames of the gateway are shorter than those of the bus.
        if let Some(frame) = arcnet::Frame::from_slice(&frame) {
            self.outbox.send(now, &frame);
        }
    }

    /// Bytes that have come to the host.
    pub fn poll(&mut self, now: MonotonicTime) -> Option<arcnet::Frame> {
        self.outbox.poll(now)
    }

    pub fn next_arrival(&self) -> Option<MonotonicTime> {
        self.outbox.next_arrival()
    }

    /// What was under way is gone.
    pub fn clear(&mut self) {
        self.outbox.clear();
    }
}

/// The same frame of another arm, sound.
fn readdressed(bytes: Vec<u8>) -> Vec<u8> {
    let Some(arm) = bytes.get(ARM_AT).copied() else { return bytes };
    let mut found = None;
    FrameParser::new(ArmId(arm)).feed(&bytes, |received| found = Some(received));
    match found {
        Some(Received::Frame(frame)) => Frame { arm: ArmId(arm.wrapping_add(1)), ..frame }.encode().as_slice().to_vec(),
        _ => bytes,
    }
}

impl super::MockController {
    /// Gives a frame of the gateway to the line to the host, where faults of the line happen to it.
    pub fn send_on_line(&mut self, now: MonotonicTime, frame: &[u8]) {
        self.line.send(now, frame);
    }

    /// Bytes that have come to the host by now.
    pub fn poll_line(&mut self, now: MonotonicTime) -> Option<arcnet::Frame> {
        self.line.poll(now)
    }

    /// When the next bytes come to the host.
    pub fn next_on_line(&self) -> Option<MonotonicTime> {
        self.line.next_arrival()
    }

    /// Whether what the host says gets lost on the line.
    pub fn is_line_deaf(&self) -> bool {
        self.line.is_deaf()
    }

    /// The line was cut: what was under way is gone.
    pub fn clear_line(&mut self) {
        self.line.clear();
    }
}

#[allow(clippy::unwrap_used, reason = "tests")]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::gateway_protocol::HostMessage;
    use crate::mock_controller::ReplyFault;

    /// HEARTBEAT stands for any frame.
    fn frame() -> Vec<u8> {
        HostMessage::Heartbeat.frame(ArmId(4), 9, 77).encode().as_slice().to_vec()
    }

    fn after(fault: LineFault, frames: usize) -> Vec<Vec<u8>> {
        let mut line = Line::new(Random::new(1));
        line.inject(fault);
        let (mut now, mut came) = (MonotonicTime::ZERO, Vec::new());
        for _ in 0..frames {
            line.send(now, &frame());
            now = now + std::time::Duration::from_millis(1);
            came.extend(std::iter::from_fn(|| line.poll(now)).map(|bytes| bytes.as_slice().to_vec()));
        }
        came
    }

    #[test]
    fn faults_of_the_line_happen_to_frames() {
        let answers = |kind| LineFault::Answers { kind, count: 2 };
        assert_eq!(after(answers(ReplyFault::Drop), 3), [frame()]);
        assert_eq!(after(answers(ReplyFault::Duplicate), 2).len(), 4);
        assert_eq!(after(LineFault::Silence(true), 3).len(), 0);
        let millis = std::time::Duration::from_millis;
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
}
