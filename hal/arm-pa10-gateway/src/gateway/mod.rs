//! The gateway of `docs/arm-protocol.md` without I/O and clock: bytes of the host on one side, ARCNET frames on the other.
//!
//! The owner of the two lines hands in their bytes ([`Gateway::handle_host_bytes`], [`Gateway::handle_bus_frame`]), asks for
//! what is to be sent ([`Gateway::poll_host_output`], [`Gateway::poll_bus_frame`]) until there is nothing more, and waits for the
//! next of either or for [`Gateway::next_deadline`]. The bus side is a machine of its own and not the host's
//! [`pb3dp_arm_pa10::driver::Driver`]: that one proves a link and carries an operator's requests, this one follows the table of the document
//! ([`table`]), and both watch each other.
//!
//! What it promises:
//! * Commands with open brakes go out in the states `holding` and `moving` and in the stop order, and nowhere else.
//! * No speed is sent once the last command of the host is as old as the watchdog allows.
//! * What stops the arm latches. Only a reset leaves it, only if the controller shows that the cause is gone, and only to `idle`.
//! * Each sound frame of the host gets exactly one answer.
//! * Nothing is allocated after construction.

mod bus;
mod codes;
mod config;
mod host;
mod listening;
mod machine;
mod motion;
mod replies;
mod requests;
pub mod table;

use machine::{Machine, Work};
use pb3dp_arm_pa10::link::SILENCE;
use pb3dp_arm_pa10_protocol::arcnet::Frame;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Dialect, FaultReport, FrameBytes, FrameParser, GatewayState, ParserCounters, Received, StopCause,
};
use pb3dp_geometry::MonotonicTime;

pub use bus::BusCounters;
pub use config::{GatewayConfig, GatewayConfigError};
pub use machine::CycleCounters;

/// The gateway of one arm.
#[derive(Clone, Debug)]
pub struct Gateway {
    parser: FrameParser,
    /// When bytes of the host came last.
    last_bytes: MonotonicTime,
    machine: Machine,
}

/// How a gateway is, for its log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatewayStatus {
    /// What it is doing.
    pub state: GatewayState,
    /// Why it stopped the arm, until it is reset.
    pub cause: StopCause,
    /// What the cause was found in, until it is reset: axis and status word, where they show it.
    pub found: Option<FaultReport>,
    /// The dialect of the host that said HELLO, if one did.
    pub host: Option<Dialect>,
    /// The controller has not answered the stop order: the arm may move, and the stop order is repeated.
    pub is_unheard: bool,
    /// Counts of the cycle.
    pub cycle: CycleCounters,
    /// Counts of the bus.
    pub bus: BusCounters,
    /// Counts of the host's bytes.
    pub bytes: ParserCounters,
    /// Frames of the host that are missing by their sequence.
    pub host_lost: u64,
    /// Frames of the host that were repeated, overtaken or waited too long.
    pub host_stale: u64,
    /// Answers that found no place, as nobody took the ones before.
    pub answers_dropped: u64,
}

impl Gateway {
    /// A gateway that knows nothing of its arm, which may be driven with open brakes: it closes them, sends E, is `idle` and waits
    /// for HELLO. An arm that it finds in motion is latched.
    ///
    /// # Errors
    /// If the configuration contradicts itself or leaves less than the requirements allow.
    pub fn new(config: GatewayConfig, now: MonotonicTime) -> Result<Self, GatewayConfigError> {
        config.check()?;
        Ok(Self { parser: FrameParser::new(config.arm), last_bytes: now, machine: Machine::new(config, now) })
    }

    /// What it was told.
    pub fn config(&self) -> &GatewayConfig {
        &self.machine.config
    }

    /// Bytes from the host, in pieces of any size up to 600 bytes: answers of more frames than that holds may find no place
    /// unless [`Self::poll_host_output`] takes them in between.
    pub fn handle_host_bytes(&mut self, now: MonotonicTime, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.last_bytes = now;
        }
        let machine = &mut self.machine;
        self.parser.feed(bytes, |received| handle_received(machine, now, &received));
        self.count_damage();
    }

    /// The host is gone: a line error, the end of a connection, an adapter that was unplugged. Another one may come.
    pub fn handle_host_gone(&mut self, now: MonotonicTime) {
        self.parser.restart();
        self.machine.handle_host_gone(now);
    }

    /// The next bytes for the host: ask again until there are none.
    pub fn poll_host_output(&mut self, now: MonotonicTime) -> Option<FrameBytes> {
        self.machine.host.poll(now, self.machine.config.arm)
    }

    /// A frame from the bus. Frames between other nodes are left alone.
    pub fn handle_bus_frame(&mut self, now: MonotonicTime, frame: &[u8]) {
        self.machine.handle_bus_frame(now, frame);
    }

    /// The frame that is due on the bus, if one is: at most one in each cycle.
    pub fn poll_bus_frame(&mut self, now: MonotonicTime) -> Option<Frame> {
        if self.parser.is_within_frame() && now.saturating_since(self.last_bytes) >= SILENCE {
            let machine = &mut self.machine;
            self.parser.handle_silence(|received| handle_received(machine, now, &received));
            self.count_damage();
        }
        self.machine.tick(now)
    }

    /// When the next cycle begins: ask [`Self::poll_bus_frame`] then, whatever happens before.
    pub fn next_deadline(&self) -> MonotonicTime {
        self.machine.next_cycle
    }

    /// The stop order, as when a host asks for it: for a caller that ends the program. Harmless when repeated.
    pub fn stop(&mut self, now: MonotonicTime) {
        self.machine.stop(now);
    }

    /// Whether the control mode is off and nothing is to be said to the controller.
    pub fn is_at_rest(&self) -> bool {
        matches!(self.machine.work, Work::Steady) && !self.machine.is_cycling()
    }

    /// How it is.
    pub fn status(&self) -> GatewayStatus {
        let Machine { state, cause, found, host, bus, cycles, .. } = &self.machine;
        GatewayStatus {
            state: *state,
            cause: *cause,
            found: *found,
            host: host.dialect,
            is_unheard: self.machine.is_unheard,
            cycle: *cycles,
            bus: bus.counters,
            bytes: *self.parser.counters(),
            host_lost: host.sequence.lost(),
            host_stale: host.sequence.stale().saturating_add(host.waited),
            answers_dropped: host.answers_dropped,
        }
    }

    fn count_damage(&mut self) {
        let ParserCounters { crc_errors, header_errors, truncated, other_version, .. } = self.parser.counters();
        self.machine.damaged = crc_errors + header_errors + truncated + other_version;
    }
}

fn handle_received(machine: &mut Machine, now: MonotonicTime, received: &Received) {
    match received {
        Received::Frame(frame) => machine.handle_frame(now, frame),
        Received::OtherArm(frame) => machine.handle_other_arm(now, frame),
    }
}
