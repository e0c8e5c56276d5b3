//! The host side: checks received frames, remembers who waits for an answer, and queues the output.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Arrival, DelayMeter, FaultReport, Frame, FrameBytes, GatewayMessage, HostMessage, MessageError, Reject,
    RejectReason, SequenceTracker,
};
use pb3dp_geometry::MonotonicTime;

use super::bus::{Requester, count, micros};

/// Answers that wait to be written. A frame of the host has at least 19 bytes, so 32 answers are enough for pieces of 600 bytes.
const OUTBOX_MAX: usize = 32;

/// Why a frame is refused, with the detail of that reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Refused(pub RejectReason, pub u32);

/// A message in the output queue, and when it was queued.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    message: GatewayMessage,
    sequence: u16,
    since: MonotonicTime,
}

/// Output queue to the host, in order.
#[derive(Clone, Debug)]
struct Outbox {
    ring: [Option<Waiting>; OUTBOX_MAX],
    first: usize,
    length: usize,
}

/// State of the host side.
#[derive(Clone, Debug)]
pub(super) struct Host {
    /// A HELLO was accepted, and the host has been there since.
    pub is_greeted: bool,
    /// Time between two commands, as the host reported it.
    pub cycle: Duration,
    /// Time of the last decoded frame.
    pub last_received: MonotonicTime,
    pub sequence: SequenceTracker,
    /// Frames that waited in a buffer for too long.
    pub waited: u64,
    /// Answers that were dropped because the output queue was full.
    pub answers_dropped: u64,
    delay: DelayMeter,
    faults: u16,
    outbox: Outbox,
}

impl Host {
    pub fn new() -> Self {
        Self {
            is_greeted: false,
            cycle: Duration::ZERO,
            last_received: MonotonicTime::ZERO,
            sequence: SequenceTracker::default(),
            waited: 0,
            answers_dropped: 0,
            delay: DelayMeter::default(),
            faults: 0,
            outbox: Outbox { ring: [None; OUTBOX_MAX], first: 0, length: 0 },
        }
    }

    /// The host is disconnected: its queued output is discarded.
    pub fn forget(&mut self) {
        self.is_greeted = false;
        self.outbox = Outbox { ring: [None; OUTBOX_MAX], first: 0, length: 0 };
    }

    /// A HELLO was accepted: sequence and clock of the host start again.
    pub fn greet(&mut self, now: MonotonicTime, frame: &Frame, cycle: Duration) {
        self.is_greeted = true;
        self.cycle = cycle;
        self.last_received = now;
        self.sequence.restart();
        self.sequence.handle(frame.sequence);
        self.delay = DelayMeter::default();
        self.delay.handle(frame.timestamp_us, micros(now));
    }

    /// The message in a frame, if the host has sent HELLO and the frame is new and in time.
    pub fn judge(
        &mut self,
        now: MonotonicTime,
        frame: &Frame,
        delay_allowed: Duration,
    ) -> Result<HostMessage, Refused> {
        let delay = self.delay.handle(frame.timestamp_us, micros(now));
        if self.sequence.handle(frame.sequence) == Arrival::Stale {
            return Err(Refused(RejectReason::Stale, 0));
        }
        let message = HostMessage::decode(frame).map_err(|error| refusal_of(&error))?;
        self.last_received = now;
        if matches!(message, HostMessage::Command(_)) && delay > delay_allowed {
            count(&mut self.waited);
            return Err(Refused(RejectReason::Stale, u32::try_from(delay.as_micros()).unwrap_or(u32::MAX)));
        }
        Ok(message)
    }

    /// Queues an answer with the sequence number of the frame that it answers.
    pub fn answer(&mut self, now: MonotonicTime, requester: &Requester, message: GatewayMessage) {
        self.put(Waiting { message, sequence: requester.sequence, since: now });
    }

    pub fn refuse(&mut self, now: MonotonicTime, requester: &Requester, refused: Refused) {
        let Refused(reason, detail) = refused;
        let reject = Reject { reason, frame_type: requester.frame_type, detail };
        self.answer(now, requester, GatewayMessage::Reject(reject));
    }

    pub fn report(&mut self, now: MonotonicTime, report: FaultReport) {
        if self.is_greeted {
            self.put(Waiting { message: GatewayMessage::Fault(report), sequence: self.faults, since: now });
        }
        self.faults = self.faults.wrapping_add(1);
    }

    /// The next frame to write.
    pub fn poll(
        &mut self,
        now: MonotonicTime,
        arm: pb3dp_arm_pa10_protocol::gateway_protocol::ArmId,
    ) -> Option<FrameBytes> {
        let Waiting { mut message, sequence, since } = self.outbox.pop()?;
        if let GatewayMessage::State(state) = &mut message {
            let waited = u32::try_from(now.saturating_since(since).as_micros()).unwrap_or(u32::MAX);
            state.sample_age_us = state.sample_age_us.saturating_add(waited);
        }
        Some(message.frame(arm, sequence, micros(now)).encode())
    }

    fn put(&mut self, waiting: Waiting) {
        if !self.outbox.push(waiting) {
            count(&mut self.answers_dropped);
        }
    }
}

impl Outbox {
    fn push(&mut self, waiting: Waiting) -> bool {
        if self.length == OUTBOX_MAX {
            return false;
        }
        self.ring[(self.first + self.length) % OUTBOX_MAX] = Some(waiting);
        self.length += 1;
        true
    }

    fn pop(&mut self) -> Option<Waiting> {
        let waiting = self.ring[self.first].take()?;
        self.first = (self.first + 1) % OUTBOX_MAX;
        self.length -= 1;
        Some(waiting)
    }
}

/// Maps a decoding error to the reason of the refusal.
pub(super) fn refusal_of(error: &MessageError) -> Refused {
    match error {
        MessageError::Type { .. } => Refused(RejectReason::UnknownType, 0),
        MessageError::Length { expected, .. } => {
            Refused(RejectReason::WrongLength, u32::try_from(*expected).unwrap_or(u32::MAX))
        }
        MessageError::Value { .. } | MessageError::Codec(_) => Refused(RejectReason::BadValue, 0),
    }
}
