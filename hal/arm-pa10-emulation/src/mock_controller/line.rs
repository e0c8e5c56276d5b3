//! The line between host and gateway, with faults of frames.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::arcnet;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Frame, FrameParser, Received};
use pb3dp_geometry::MonotonicTime;

use super::fault::{LineFault, Side};
use super::outbox::Outbox;
use super::random::Random;

/// Offset of the arm number in a frame.
const ARM_AT: usize = 3;

/// A slow reader accepts at once what arrives in this time.
const READ_AT_ONCE: Duration = Duration::from_millis(10);

/// The line between host and gateway.
#[derive(Clone, Debug)]
pub(super) struct Line {
    outbox: Outbox,
    wrong_arm: u32,
    is_deaf: bool,
    reader: Option<SlowReader>,
    /// Clock offset, µs.
    host_clock_us: i64,
    gateway_clock_us: i64,
    /// Finds the frames of the host, to change their times.
    parser: FrameParser,
}

impl Line {
    pub fn new(random: Random) -> Self {
        Self {
            outbox: Outbox::new(random),
            wrong_arm: 0,
            is_deaf: false,
            reader: None,
            host_clock_us: 0,
            gateway_clock_us: 0,
            // Frames of any arm are forwarded.
            parser: FrameParser::new(ArmId(0)),
        }
    }

    pub fn inject(&mut self, fault: LineFault) {
        match fault {
            LineFault::Answers { kind, count } => self.outbox.spoil(kind, count),
            LineFault::WrongArm { count } => self.wrong_arm = count,
            LineFault::Delay { count, by } => self.outbox.delay(count, by),
            LineFault::Slow(by) => self.outbox.slow = by,
            LineFault::Silence(on) => self.outbox.silent = on,
            LineFault::Deaf(on) => self.is_deaf = on,
            LineFault::SlowReader { bytes_per_second } => {
                self.reader = bytes_per_second.map(|rate| SlowReader { rate, next: MonotonicTime::ZERO });
            }
            LineFault::ClockJump { side: Side::Host, by_us } => {
                self.host_clock_us = self.host_clock_us.wrapping_add(by_us);
            }
            LineFault::ClockJump { side: Side::Gateway, by_us } => {
                self.gateway_clock_us = self.gateway_clock_us.wrapping_add(by_us);
            }
        }
    }

    /// Number of bytes of the host that the gateway accepts now, at most.
    pub fn readable(&self, now: MonotonicTime) -> usize {
        self.reader.map_or(usize::MAX, |reader| reader.readable(now))
    }

    /// Time at which it accepts bytes again, if it accepts none now.
    pub fn reads_again(&self) -> Option<MonotonicTime> {
        self.reader.filter(|reader| reader.rate > 0).map(|reader| reader.next)
    }

    /// Bytes of the host, and the part that reaches the gateway.
    pub fn hear(&mut self, now: MonotonicTime, bytes: &[u8], mut gateway: impl FnMut(&[u8])) {
        if let Some(reader) = &mut self.reader {
            reader.take(now, bytes.len());
        }
        if self.is_deaf {
            return;
        }
        if self.host_clock_us == 0 {
            return gateway(bytes);
        }
        let by_us = self.host_clock_us;
        self.parser.feed(bytes, |received| {
            let (Received::Frame(frame) | Received::OtherArm(frame)) = received;
            gateway(&postdated(&frame, by_us).encode());
        });
    }

    /// A frame on its way to the host.
    pub fn send(&mut self, now: MonotonicTime, frame: &[u8]) {
        let mut frame = frame.to_vec();
        if self.wrong_arm > 0 {
            self.wrong_arm -= 1;
            frame = readdressed(frame);
        }
        if self.gateway_clock_us != 0 {
            frame = changed(frame, |frame| postdated(&frame, self.gateway_clock_us));
        }
        // Frames of the gateway are shorter than those of the bus.
        if let Some(frame) = arcnet::Frame::from_slice(&frame) {
            self.outbox.send(now, &frame);
        }
    }

    /// Bytes that have arrived at the host.
    pub fn poll(&mut self, now: MonotonicTime) -> Option<arcnet::Frame> {
        self.outbox.poll(now)
    }

    pub fn next_arrival(&self) -> Option<MonotonicTime> {
        self.outbox.next_arrival()
    }

    /// Drops the content of the line.
    pub fn clear(&mut self) {
        self.outbox.clear();
        self.parser.restart();
    }
}

/// A slow reader.
#[derive(Clone, Copy, Debug)]
struct SlowReader {
    /// Bytes per second.
    rate: u32,
    /// When the next byte is taken.
    next: MonotonicTime,
}

impl SlowReader {
    /// Unused reading time is lost.
    fn next(&self, now: MonotonicTime) -> MonotonicTime {
        self.next.max(now - READ_AT_ONCE)
    }

    fn readable(&self, now: MonotonicTime) -> usize {
        let next = self.next(now);
        if self.rate == 0 || now < next {
            return 0;
        }
        1 + (now.saturating_since(next).as_secs_f64() * f64::from(self.rate)) as usize
    }

    fn take(&mut self, now: MonotonicTime, bytes: usize) {
        if self.rate > 0 {
            self.next = self.next(now) + Duration::from_secs_f64(bytes as f64 / f64::from(self.rate));
        }
    }
}

/// The same frame with another time.
fn postdated(frame: &Frame, by_us: i64) -> Frame {
    Frame { timestamp_us: frame.timestamp_us.wrapping_add_signed(by_us), ..*frame }
}

/// The same frame with another arm number and a valid checksum.
fn readdressed(bytes: Vec<u8>) -> Vec<u8> {
    changed(bytes, |frame| Frame { arm: ArmId(frame.arm.0.wrapping_add(1)), ..frame })
}

/// A frame with changed content and a valid checksum.
fn changed(bytes: Vec<u8>, change: impl FnOnce(Frame) -> Frame) -> Vec<u8> {
    let Some(arm) = bytes.get(ARM_AT).copied() else { return bytes };
    let mut found = None;
    FrameParser::new(ArmId(arm)).feed(&bytes, |received| found = Some(received));
    match found {
        Some(Received::Frame(frame)) => change(frame).encode().as_slice().to_vec(),
        _ => bytes,
    }
}

impl super::MockController {
    /// Sends a frame of the gateway over the line, with its faults.
    pub fn send_on_line(&mut self, now: MonotonicTime, frame: &[u8]) {
        self.line.send(now, frame);
    }

    /// Bytes that have arrived at the host by now.
    pub fn poll_line(&mut self, now: MonotonicTime) -> Option<arcnet::Frame> {
        self.line.poll(now)
    }

    /// Time of the next arrival at the host.
    pub fn next_on_line(&self) -> Option<MonotonicTime> {
        self.line.next_arrival()
    }

    /// Number of bytes of the host that the gateway accepts from the line now, at most.
    pub fn readable_on_line(&self, now: MonotonicTime) -> usize {
        self.line.readable(now)
    }

    /// Time at which it accepts bytes again, if it is slow.
    pub fn reads_line_again(&self) -> Option<MonotonicTime> {
        self.line.reads_again()
    }

    /// Sends bytes of the host over the line; returns those that arrive at the gateway now.
    pub fn hear_on_line(&mut self, now: MonotonicTime, bytes: &[u8], gateway: impl FnMut(&[u8])) {
        self.line.hear(now, bytes, gateway);
    }

    /// The line was cut: drops its content.
    pub fn clear_line(&mut self) {
        self.line.clear();
    }
}
