//! Settings of a gateway: its arm, its bus and its host.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, Supervision, TorqueScale, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, BRAKE_TIME_MAX, Firmware, Geometry};
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;

/// Cycles on the bus that make sense: a controller that wants one every 2 ms, or a slower one (the period stands in its ROM).
const CYCLE_RANGE: std::ops::RangeInclusive<Duration> = Duration::from_millis(1)..=Duration::from_millis(10);

/// Settings of a gateway: its arm, its bus and its host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatewayConfig {
    /// The arm that every frame must name.
    pub arm: ArmId,
    /// The wire format in which the controller is spoken to.
    pub format: WireFormat,
    /// After how many messages the sequence number of the bus starts again.
    pub modulus: SequenceModulus,
    /// The geometry of the arm, passed on to hosts.
    pub geometry: Geometry,
    /// Time between two exchanges: 2 ms.
    pub cycle: Duration,
    /// How late a cycle may begin before the arm is stopped: one cycle. More is for machines that are not fit to drive an arm, as
    /// those that run tests; at most the time after which a silent host stops the arm.
    pub lateness_allowed: Duration,
    /// When a command whose successor stays away fades and stops.
    pub watchdog: CommandWatchdog,
    /// The time-out of the servo controller, if it is known: passed on to hosts.
    pub controller_watchdog: Option<Duration>,
    /// How long brakes take to open, and to close.
    pub brake_time: Duration,
    /// Whether speeds go from one command to the next on a straight line (dialect `gateway-v1`).
    pub interpolates: bool,
    /// What the controller itself is to watch (format B, dialect `gateway-v1`).
    pub supervision: Supervision,
    /// Bits of the controller's status word (format B) that mean an emergency stop: none until the rig has shown their polarity.
    pub emergency_stop_bits: u16,
    /// What torque counts are at the joints.
    pub torque_scale: TorqueScale,
    /// Name and version, for hosts.
    pub firmware: Firmware,
}

/// Why a configuration is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GatewayConfigError {
    /// The cycle is out of range.
    #[error("a cycle of {got:?} on the bus: give 1 to 10 ms; the controller wants 2 ms unless its ROM says otherwise")]
    Cycle {
        /// The cycle given.
        got: Duration,
    },
    /// A late cycle is noticed too early or too late.
    #[error(
        "a cycle that may begin {got:?} late: give at least one cycle ({cycle:?}), and less than the time after which a silent \
         host stops the arm ({stop_after:?})"
    )]
    Lateness {
        /// The lateness given.
        got: Duration,
        /// Of the configuration.
        cycle: Duration,
        /// Of the configuration.
        stop_after: Duration,
    },
    /// The brakes take no time or too much.
    #[error("brakes that take {got:?} to open: give more than 0 and at most 5 s; 200 ms if nobody has measured it")]
    BrakeTime {
        /// The time given.
        got: Duration,
    },
    /// The watchdog would slow down the arm of a host that keeps its time.
    #[error("commands fade after {got:?}: hosts send one every 10 ms at the slowest, so give at least 20 ms")]
    Watchdog {
        /// The time given.
        got: Duration,
    },
    /// Format A has no field for it.
    #[error(
        "supervision by the controller exists in format B only: switch it off, or choose that format if the arm speaks it"
    )]
    Supervision,
    /// Format A has no status words with a known meaning.
    #[error(
        "emergency-stop bits 0x{got:04x} of a controller with format A, whose status words nobody can read: give none"
    )]
    EmergencyStopBits {
        /// The bits given.
        got: u16,
    },
}

impl GatewayConfig {
    /// An arm with this number and wire format; the rest as the sources suggest it.
    pub fn new(arm: ArmId, format: WireFormat, firmware: Firmware) -> Self {
        let cycle = Duration::from_millis(2);
        Self {
            arm,
            format,
            modulus: SequenceModulus::Modulo128,
            geometry: Geometry::Unknown,
            cycle,
            lateness_allowed: cycle,
            watchdog: CommandWatchdog::default(),
            controller_watchdog: None,
            brake_time: Duration::from_millis(200),
            interpolates: true,
            supervision: Supervision::default(),
            emergency_stop_bits: 0,
            torque_scale: TorqueScale::of_format(format),
            firmware,
        }
    }

    /// Whether it can be driven by.
    ///
    /// # Errors
    /// Which value cannot be, and which can.
    pub fn check(&self) -> Result<(), GatewayConfigError> {
        let Self { cycle, lateness_allowed, watchdog, .. } = *self;
        if !CYCLE_RANGE.contains(&cycle) {
            return Err(GatewayConfigError::Cycle { got: cycle });
        }
        let stop_after = watchdog.stop_after();
        if lateness_allowed < cycle || lateness_allowed >= stop_after {
            return Err(GatewayConfigError::Lateness { got: lateness_allowed, cycle, stop_after });
        }
        if watchdog.ramp_after() < Duration::from_millis(20) {
            return Err(GatewayConfigError::Watchdog { got: watchdog.ramp_after() });
        }
        if self.brake_time.is_zero() || self.brake_time > BRAKE_TIME_MAX {
            return Err(GatewayConfigError::BrakeTime { got: self.brake_time });
        }
        if self.format == WireFormat::LittleEndian5x8 {
            if self.supervision != Supervision::default() {
                return Err(GatewayConfigError::Supervision);
            }
            if self.emergency_stop_bits != 0 {
                return Err(GatewayConfigError::EmergencyStopBits { got: self.emergency_stop_bits });
            }
        }
        Ok(())
    }
}
