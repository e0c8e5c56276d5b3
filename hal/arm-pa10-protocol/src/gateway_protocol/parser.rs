//! Frames out of a stream of bytes that may be damaged.

use super::frame::{FRAME_BYTES_MAX, Head, SYNC, decode_sound, head};
use super::{ArmId, Frame};

/// What the parser found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A frame for or from the arm of this link.
    Frame(Frame),
    /// A sound frame of another arm: cables or configurations are swapped. It must not be acted on.
    OtherArm(Frame),
}

/// How much of a stream was damaged. Counts stop at their maximum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ParserCounters {
    /// Sound frames of this link's arm.
    pub frames: u64,
    /// Sound frames of another arm.
    pub wrong_arm: u64,
    /// Frames with a sound header and a wrong CRC.
    pub crc_errors: u64,
    /// Sync bytes that were followed by no sound header.
    pub header_errors: u64,
    /// Sound headers of another version of the protocol.
    pub other_version: u64,
    /// Frames whose rest did not come before the line fell silent.
    pub truncated: u64,
    /// How often bytes had to be skipped to find the next frame.
    pub resyncs: u64,
    /// Bytes skipped.
    pub skipped_bytes: u64,
}

/// Finds frames in a stream of bytes.
///
/// After damage it goes on one byte behind the sync bytes that led nowhere, among the bytes it already has, so a frame that
/// arrives whole is never lost by what stood before it. It delivers such a frame at the latest when as many bytes have come as
/// the damaged frame announced, or when [`Self::handle_silence`] tells that no more will come. Memory is fixed.
#[derive(Clone, Debug)]
pub struct FrameParser {
    arm: ArmId,
    buffer: [u8; FRAME_BYTES_MAX],
    length: usize,
    /// Bytes are being skipped since the last sound frame.
    skipping: bool,
    counters: ParserCounters,
}

impl FrameParser {
    /// A parser for the link of one arm.
    pub fn new(arm: ArmId) -> Self {
        Self { arm, buffer: [0; FRAME_BYTES_MAX], length: 0, skipping: false, counters: ParserCounters::default() }
    }

    /// What was found so far.
    pub fn counters(&self) -> &ParserCounters {
        &self.counters
    }

    /// Whether a frame has begun whose rest is missing: if no byte comes for the silence of the protocol, call
    /// [`Self::handle_silence`].
    pub fn is_within_frame(&self) -> bool {
        self.length > 0
    }

    /// Takes bytes as they come, in pieces of any size, and hands on each frame in them.
    pub fn feed(&mut self, mut bytes: &[u8], mut each: impl FnMut(Received)) {
        while !bytes.is_empty() {
            // There is room: a full buffer holds a whole frame or something to skip, and was emptied before.
            let taken = bytes.len().min(FRAME_BYTES_MAX - self.length);
            let (now, later) = bytes.split_at(taken);
            self.buffer[self.length..self.length + taken].copy_from_slice(now);
            self.length += taken;
            bytes = later;
            self.scan(&mut each);
        }
    }

    /// The line has been silent for so long that an incomplete frame will not be completed: looks for frames in its bytes.
    pub fn handle_silence(&mut self, mut each: impl FnMut(Received)) {
        if self.length > 0 {
            count(&mut self.counters.truncated);
        }
        while self.length > 0 {
            self.skip(1);
            self.scan(&mut each);
        }
    }

    /// Forgets what was begun, for a link that is opened anew. The counters stay.
    pub fn restart(&mut self) {
        self.length = 0;
        self.skipping = false;
    }

    fn scan(&mut self, each: &mut impl FnMut(Received)) {
        loop {
            let found = head(&self.buffer[..self.length]);
            match found {
                Head::Incomplete => return,
                Head::NoSync => {}
                Head::BadHeader => count(&mut self.counters.header_errors),
                Head::OtherVersion => count(&mut self.counters.other_version),
                Head::BadCrc => count(&mut self.counters.crc_errors),
                Head::Sound { length } => {
                    self.deliver(length, each);
                    continue;
                }
            }
            let rest = &self.buffer[1..self.length];
            let next = rest.iter().position(|byte| *byte == SYNC[0]).unwrap_or(rest.len());
            self.skip(1 + next);
        }
    }

    fn deliver(&mut self, length: usize, each: &mut impl FnMut(Received)) {
        let frame = decode_sound(&self.buffer[..length]);
        self.skipping = false;
        self.drop_front(length);
        if frame.arm == self.arm {
            count(&mut self.counters.frames);
            each(Received::Frame(frame));
        } else {
            count(&mut self.counters.wrong_arm);
            each(Received::OtherArm(frame));
        }
    }

    fn skip(&mut self, bytes: usize) {
        if !self.skipping {
            count(&mut self.counters.resyncs);
        }
        self.skipping = true;
        self.counters.skipped_bytes = self.counters.skipped_bytes.saturating_add(bytes as u64);
        self.drop_front(bytes);
    }

    fn drop_front(&mut self, bytes: usize) {
        self.buffer.copy_within(bytes..self.length, 0);
        self.length -= bytes;
    }
}

fn count(counter: &mut u64) {
    *counter = counter.saturating_add(1);
}
