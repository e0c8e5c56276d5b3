//! The gateway of `docs/arm-protocol.md` as a state machine without I/O and clock.
//!
//! The caller passes received bytes to [`Gateway::handle_host_bytes`] and received frames to [`Gateway::handle_bus_frame`].
//! It polls [`Gateway::poll_host_output`] and [`Gateway::poll_bus_frame`] until both return nothing, and then waits for input
//! or for [`Gateway::next_deadline`]. The bus side is separate from the host's
//! [`pb3dp_arm_pa10::driver::Driver`]: the driver proves a link and forwards an operator's requests; the gateway follows the table
//! of the document ([`table`]). Each monitors the other.
//!
//! Guarantees:
//! * Commands with open brakes are sent in the states `holding` and `moving` and in the stop order, and nowhere else.
//! * No command outside the motion limits is followed: it stops the arm, as does an axis that could not stop in its range.
//! * No speed is sent once the last command of the host is as old as the watchdog allows.
//! * Every cause of a stop latches. Only a reset clears it, only if the controller shows that the cause is gone, and only to `idle`.
//! * Each valid frame of the host gets exactly one answer.
//! * Nothing is allocated after construction.

mod bus;
mod codes;
mod config;
mod host;
mod limits;
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
    FaultReport, FrameBytes, FrameParser, GatewayState, ParserCounters, Received, StopCause,
};
use pb3dp_geometry::MonotonicTime;

pub use bus::BusCounters;
pub use config::{CYCLE_RANGE, GatewayConfig, GatewayConfigError, RAMP_AFTER_MIN};
pub use machine::CycleCounters;

/// The gateway of one arm.
#[derive(Clone, Debug)]
pub struct Gateway {
    parser: FrameParser,
    /// Time of the last bytes from the host.
    last_bytes: MonotonicTime,
    machine: Machine,
}

/// Status of a gateway, for its log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatewayStatus {
    /// Current state.
    pub state: GatewayState,
    /// Why the gateway stopped the arm, until a reset.
    pub cause: StopCause,
    /// Axis and status word of the cause, if they show it, until a reset.
    pub found: Option<FaultReport>,
    /// A host sent HELLO, and is there.
    pub has_host: bool,
    /// The controller has not answered the stop order: the arm may move, and the gateway repeats the stop order.
    pub stop_unacknowledged: bool,
    /// Counters of the cycle.
    pub cycle: CycleCounters,
    /// Counters of the bus.
    pub bus: BusCounters,
    /// Counters of the host's bytes.
    pub bytes: ParserCounters,
    /// Frames of the host that are missing in the sequence.
    pub host_lost: u64,
    /// Frames of the host that were repeated, overtaken or waited too long.
    pub host_stale: u64,
    /// Answers that were dropped because the output queue was full.
    pub answers_dropped: u64,
}

impl Gateway {
    /// Creates a gateway in an unknown state of the arm, which may be driven with open brakes: the gateway closes the brakes, sends E,
    /// becomes `idle` and waits for HELLO. If it finds the arm in motion, it latches.
    ///
    /// # Errors
    /// If the configuration contradicts itself or a value is out of range.
    pub fn new(config: GatewayConfig, now: MonotonicTime) -> Result<Self, GatewayConfigError> {
        config.check()?;
        Ok(Self { parser: FrameParser::new(config.arm), last_bytes: now, machine: Machine::new(config, now) })
    }

    /// The configuration.
    pub fn config(&self) -> &GatewayConfig {
        &self.machine.config
    }

    /// Handles bytes from the host, in pieces of up to 600 bytes. In larger pieces, answers may be dropped
    /// unless [`Self::poll_host_output`] is called in between.
    pub fn handle_host_bytes(&mut self, now: MonotonicTime, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.last_bytes = now;
        }
        let machine = &mut self.machine;
        self.parser.feed(bytes, |received| handle_received(machine, now, &received));
        self.count_damage();
    }

    /// The host is disconnected: a line error, a closed connection or an unplugged adapter. Another host may connect.
    pub fn handle_host_gone(&mut self, now: MonotonicTime) {
        self.parser.restart();
        self.machine.handle_host_gone(now);
    }

    /// The next bytes for the host: call this until it returns `None`.
    pub fn poll_host_output(&mut self, now: MonotonicTime) -> Option<FrameBytes> {
        self.machine.host.poll(now, self.machine.config.arm)
    }

    /// Handles a frame from the bus. Frames between other nodes are ignored.
    pub fn handle_bus_frame(&mut self, now: MonotonicTime, frame: &[u8]) {
        self.machine.handle_bus_frame(now, frame);
    }

    /// The frame that is due on the bus, if any: at most one per cycle.
    pub fn poll_bus_frame(&mut self, now: MonotonicTime) -> Option<Frame> {
        if self.parser.is_within_frame() && now.saturating_since(self.last_bytes) >= SILENCE {
            let machine = &mut self.machine;
            self.parser.handle_silence(|received| handle_received(machine, now, &received));
            self.count_damage();
        }
        self.machine.tick(now)
    }

    /// Start of the next cycle: call [`Self::poll_bus_frame`] then, whatever happens before.
    pub fn next_deadline(&self) -> MonotonicTime {
        self.machine.next_cycle
    }

    /// Begins the stop order, as a host's stop request does: for a caller that ends the program. Repeating it is harmless.
    pub fn stop(&mut self, now: MonotonicTime) {
        self.machine.stop(now);
    }

    /// Sets the switch: on local the arm stops and latches (`local-control`), and no host resets it.
    pub fn set_local(&mut self, now: MonotonicTime, is_local: bool) {
        self.machine.is_local = is_local;
        self.machine.check_switch(now);
    }

    /// Whether the control mode is off and no message for the controller is due.
    pub fn is_at_rest(&self) -> bool {
        matches!(self.machine.work, Work::Steady) && !self.machine.is_cycling()
    }

    /// Current status.
    pub fn status(&self) -> GatewayStatus {
        let Machine { state, cause, found, host, bus, cycles, .. } = &self.machine;
        GatewayStatus {
            state: *state,
            cause: *cause,
            found: *found,
            has_host: host.is_greeted,
            stop_unacknowledged: self.machine.stop_unacknowledged,
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
