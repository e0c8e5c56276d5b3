//! Replies on their way to the host, with faults.

use std::collections::BTreeMap;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::arcnet::Frame;
use pb3dp_geometry::MonotonicTime;

use super::fault::ReplyFault;
use super::random::Random;

/// Sender, sequence number and letter within a frame.
const SENDER_AT: usize = 0;
const SEQUENCE_AT: usize = 4;
const LETTER_AT: usize = 5;

/// Delay between the copies of a duplicated frame.
const SECOND_COPY_AFTER: Duration = Duration::from_micros(50);

/// Replies on their way.
#[derive(Clone, Debug)]
pub(super) struct Outbox {
    random: Random,
    under_way: Vec<(MonotonicTime, Frame)>,
    /// Sent after its successor.
    held_back: Option<Frame>,
    pending: BTreeMap<ReplyFault, u32>,
    delayed: (u32, Duration),
    pub slow: Duration,
    pub silent: bool,
}

impl Outbox {
    pub fn new(random: Random) -> Self {
        Self {
            random,
            under_way: Vec::new(),
            held_back: None,
            pending: BTreeMap::new(),
            delayed: (0, Duration::ZERO),
            slow: Duration::ZERO,
            silent: false,
        }
    }

    pub fn spoil(&mut self, kind: ReplyFault, count: u32) {
        self.pending.insert(kind, count);
    }

    pub fn delay(&mut self, count: u32, by: Duration) {
        self.delayed = (count, by);
    }

    /// Drops all pending replies.
    pub fn clear(&mut self) {
        self.under_way.clear();
        self.held_back = None;
    }

    /// Whether this fault applies to the next reply; counts it.
    pub fn suffers(&mut self, kind: ReplyFault) -> bool {
        match self.pending.get_mut(&kind) {
            Some(count) if *count > 0 => {
                *count -= 1;
                true
            }
            _ => false,
        }
    }

    /// Sends a reply that leaves the controller at `due`.
    pub fn send(&mut self, due: MonotonicTime, frame: &Frame) {
        if self.silent || self.suffers(ReplyFault::Drop) {
            return;
        }
        let mut due = due + self.slow;
        if self.delayed.0 > 0 {
            self.delayed.0 -= 1;
            due = due + self.delayed.1;
        }
        let frame = self.damaged(frame);
        if self.held_back.is_none() && self.suffers(ReplyFault::Reorder) {
            self.held_back = Some(frame);
            return;
        }
        self.under_way.push((due, frame));
        if let Some(earlier) = self.held_back.take() {
            self.under_way.push((due + SECOND_COPY_AFTER, earlier));
        }
        if self.suffers(ReplyFault::Duplicate) {
            self.under_way.push((due + SECOND_COPY_AFTER, frame));
        }
    }

    fn damaged(&mut self, frame: &Frame) -> Frame {
        let mut bytes = frame.as_slice().to_vec();
        for (kind, at) in [
            (ReplyFault::WrongNode, SENDER_AT),
            (ReplyFault::WrongSequence, SEQUENCE_AT),
            (ReplyFault::WrongLetter, LETTER_AT),
        ] {
            if self.suffers(kind)
                && let Some(byte) = bytes.get_mut(at)
            {
                // Any other value, with equal probability.
                *byte = byte.wrapping_add(1 + self.random.below(255) as u8);
            }
        }
        if self.suffers(ReplyFault::Corrupt) {
            let at = self.random.below(bytes.len());
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << self.random.below(8);
            }
        }
        if self.suffers(ReplyFault::Truncate) {
            bytes.truncate(self.random.below(bytes.len()));
        }
        // No byte was added.
        Frame::from_slice(&bytes).unwrap_or(*frame)
    }

    /// Arrival time of the next frame.
    pub fn next_arrival(&self) -> Option<MonotonicTime> {
        self.under_way.iter().map(|(due, _)| *due).min()
    }

    /// A frame that has arrived, the earliest first.
    pub fn poll(&mut self, now: MonotonicTime) -> Option<Frame> {
        // Of frames that are due at the same time, the first one sent is returned first.
        let index = (0..self.under_way.len()).min_by_key(|&index| self.under_way[index].0)?;
        (self.under_way[index].0 <= now).then(|| self.under_way.remove(index).1)
    }
}
