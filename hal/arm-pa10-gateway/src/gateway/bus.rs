//! The bus side: numbers the messages, matches replies to them, and checks the replies.

use pb3dp_arm_pa10_protocol::arcnet::{self, Frame, FrameError, Route};
use pb3dp_arm_pa10_protocol::codec::{
    ArmReply, COUNTS_PER_TURN, CodecError, ControlMessage, ControlPacket, EepromAxis, Letter, ReplyMessage, WireFormat,
};
use pb3dp_geometry::MonotonicTime;

use super::config::GatewayConfig;

/// A reply to one of this many newest messages counts as late, an older one as mismatched.
const LATE_MESSAGES_MAX: u8 = 16;

/// An angle beyond two turns from zero is invalid.
const ANGLE_COUNTS_MAX: u32 = 2 * COUNTS_PER_TURN.unsigned_abs();

/// Counters of the bus since the gateway started. They saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Messages sent.
    pub exchanges: u64,
    /// Messages without a reply in time.
    pub lost: u64,
    /// Replies that came too late.
    pub late: u64,
    /// Replies with a wrong number, letter or length.
    pub mismatched: u64,
}

/// A frame of the host that waits for its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Requester {
    pub sequence: u16,
    pub frame_type: u8,
}

/// A message that waits for its reply.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outstanding {
    packet: ControlPacket,
    /// Cycles that have begun since the message was sent.
    pub cycles: u32,
}

/// A classified frame of the bus.
#[derive(Clone, Debug)]
pub(super) enum Arrived {
    /// No expected reply; it is counted.
    Nothing,
    /// The expected measurement.
    Sample(ArmReply),
    /// The expected table of an axis; none if it has another layout.
    Eeprom(Option<EepromAxis>),
    /// Another expected reply.
    Done,
    /// A reply which shows that this is not the configured arm.
    Unusable,
}

/// State of the bus side.
#[derive(Clone, Debug, Default)]
pub(super) struct Bus {
    pub outstanding: Option<Outstanding>,
    pub counters: BusCounters,
    /// Messages in a row without a usable reply.
    pub misses: u32,
    /// The wire format of the received replies.
    pub detected_format: Option<WireFormat>,
    last_sequence: u8,
}

impl Bus {
    /// Encodes a message; its reply is expected from now on.
    pub fn send(&mut self, config: &GatewayConfig, message: ControlMessage) -> Result<Frame, CodecError> {
        let packet = ControlPacket { sequence: config.modulus.reduce(self.counters.exchanges), message };
        let frame = arcnet::encode(Route::TO_CONTROLLER, &packet.encode(config.format)?)?;
        count(&mut self.counters.exchanges);
        self.last_sequence = packet.sequence;
        self.outstanding = Some(Outstanding { packet, cycles: 0 });
        Ok(frame)
    }

    /// The expected reply did not come.
    pub fn give_up(&mut self) {
        self.outstanding = None;
        count(&mut self.counters.lost);
        self.misses = self.misses.saturating_add(1);
    }

    /// Handles a frame of the bus.
    pub fn handle_frame(&mut self, config: &GatewayConfig, frame: &[u8]) -> Arrived {
        let packet = match arcnet::decode(Route::TO_HOST, frame) {
            Ok(packet) => packet,
            // Frames between other nodes are normal.
            Err(FrameError::Route { .. }) => return Arrived::Nothing,
            Err(_) => return self.mismatch(),
        };
        // A decoded frame has at least a number and a letter.
        let [sequence, letter, data @ ..] = packet else { return self.mismatch() };
        let asked = match &self.outstanding {
            Some(outstanding) if outstanding.packet.sequence == *sequence => outstanding.packet.message,
            _ => return self.old(config, *sequence),
        };
        if *letter != asked.letter().byte() {
            return self.mismatch();
        }
        match ReplyMessage::decode_data(config.format, &asked, *letter, data) {
            Ok(ReplyMessage::Cyclic(reply)) => self.sample(config, &reply),
            Ok(ReplyMessage::Eeprom(table)) => self.used(Arrived::Eeprom(Some(table))),
            Ok(ReplyMessage::Done(_)) => self.used(Arrived::Done),
            Err(CodecError::OtherFormat { got, .. }) => {
                self.detected_format = Some(got);
                count(&mut self.counters.mismatched);
                Arrived::Unusable
            }
            Err(_) if asked.letter() == Letter::ReadEeprom => self.used(Arrived::Eeprom(None)),
            Err(_) => self.mismatch(),
        }
    }

    fn sample(&mut self, config: &GatewayConfig, reply: &ArmReply) -> Arrived {
        self.detected_format = Some(config.format);
        if reply.axes.iter().any(|axis| axis.angle.0.unsigned_abs() > ANGLE_COUNTS_MAX) {
            count(&mut self.counters.mismatched);
            return Arrived::Unusable;
        }
        self.used(Arrived::Sample(*reply))
    }

    fn used(&mut self, arrived: Arrived) -> Arrived {
        self.misses = 0;
        self.outstanding = None;
        arrived
    }

    fn mismatch(&mut self) -> Arrived {
        count(&mut self.counters.mismatched);
        Arrived::Nothing
    }

    /// A reply to a message that is no longer outstanding.
    fn old(&mut self, config: &GatewayConfig, sequence: u8) -> Arrived {
        let modulus = config.modulus.reduce(u64::MAX);
        let behind = self.last_sequence.wrapping_sub(sequence) & modulus;
        let is_late = sequence <= modulus && behind < LATE_MESSAGES_MAX && self.counters.exchanges > 0;
        count(if is_late { &mut self.counters.late } else { &mut self.counters.mismatched });
        Arrived::Nothing
    }
}

pub(super) fn count(counter: &mut u64) {
    *counter = counter.saturating_add(1);
}

/// Monotonic time in µs, the unit of the frames.
pub(super) fn micros(now: MonotonicTime) -> u64 {
    now.as_nanos() / 1000
}
