//! Settings of a gateway: its arm, its bus and its host.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{
    SequenceModulus, Signal, SignalSource, StatusSignals, Supervision, TorqueScale, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, BRAKE_TIME_MAX, Firmware, Geometry, MotionLimits};
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;

/// Allowed cycle on the bus: the controller expects 2 ms, or a slower cycle (its ROM holds the period).
pub const CYCLE_RANGE: std::ops::RangeInclusive<Duration> = Duration::from_millis(1)..=Duration::from_millis(10);

/// Least age of a command at which the arm fades it: a host may send only one command per 10 ms.
pub const RAMP_AFTER_MIN: Duration = Duration::from_millis(20);

/// Settings of a gateway: its arm, its bus and its host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatewayConfig {
    /// The arm number that every frame must carry.
    pub arm: ArmId,
    /// The wire format of the controller.
    pub format: WireFormat,
    /// Number of messages after which the sequence number of the bus wraps.
    pub modulus: SequenceModulus,
    /// The geometry of the arm, forwarded to hosts.
    pub geometry: Geometry,
    /// Time between two exchanges: 2 ms.
    pub cycle: Duration,
    /// How late a cycle may begin before the gateway stops the arm: one cycle. Allow more only on machines that drive no arm, such
    /// as test machines; at most the time after which a silent host stops the arm.
    pub lateness_allowed: Duration,
    /// When a command without a successor fades and stops.
    pub watchdog: CommandWatchdog,
    /// The time-out of the servo controller, if it is known: forwarded to hosts.
    pub controller_watchdog: Option<Duration>,
    /// Time that brakes take to open, and to close.
    pub brake_time: Duration,
    /// Whether speeds are interpolated linearly between two commands.
    pub interpolates: bool,
    /// Supervision by the controller itself (format B).
    pub supervision: Supervision,
    /// How the signals of the arm are noticed. Alarms of format B always count. No brake opens while one is unknown.
    pub signals: StatusSignals,
    /// Joint torque per torque count.
    pub torque_scale: TorqueScale,
    /// Name and version, for hosts.
    pub firmware: Firmware,
    /// Motion limits: a command outside them stops the arm.
    pub limits: MotionLimits,
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GatewayConfigError {
    /// The cycle is out of range.
    #[error("a bus cycle of {got:?} is out of range: give 1 to 10 ms, and 2 ms unless the controller's ROM differs")]
    Cycle {
        /// The configured cycle.
        got: Duration,
    },
    /// The allowed lateness is too short or too long.
    #[error(
        "an allowed lateness of {got:?} is out of range: give at least one cycle ({cycle:?}), and less than the time \
         after which a silent host stops the arm ({stop_after:?})"
    )]
    Lateness {
        /// The configured lateness.
        got: Duration,
        /// The configured cycle.
        cycle: Duration,
        /// The configured time-out of the host.
        stop_after: Duration,
    },
    /// The brake time is zero or too long.
    #[error("a brake time of {got:?} is out of range: give more than 0 and at most 5 s; 200 ms if it is not measured")]
    BrakeTime {
        /// The configured time.
        got: Duration,
    },
    /// The watchdog would slow down the arm of a host that keeps its cycle.
    #[error("commands fade after {got:?}, at least 20 ms are needed: a host may send only one command per 10 ms")]
    Watchdog {
        /// The configured time.
        got: Duration,
    },
    /// Format A has no field for supervision.
    #[error("supervision by the controller exists in format B only: disable it, or choose format B if the arm uses it")]
    Supervision,
    /// This gateway has no inputs.
    #[error("{}: this gateway has no wired input; state the bits of a status word", .got.key())]
    Wired {
        /// The signal.
        got: Signal,
    },
    /// Every arm has an emergency stop and power.
    #[error("{}: every arm has this signal; state the bits of a status word", .got.key())]
    Absent {
        /// The signal.
        got: Signal,
    },
}

impl GatewayConfig {
    /// A configuration for an arm with this number, wire format and motion limits; the other values are those of the sources.
    pub fn new(arm: ArmId, format: WireFormat, firmware: Firmware, limits: MotionLimits) -> Self {
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
            signals: StatusSignals::ORCA,
            torque_scale: TorqueScale::of_format(format),
            firmware,
            limits,
        }
    }

    /// Checks all values.
    ///
    /// # Errors
    /// The first value that is out of range, with the range.
    pub fn check(&self) -> Result<(), GatewayConfigError> {
        let Self { cycle, lateness_allowed, watchdog, .. } = *self;
        if !CYCLE_RANGE.contains(&cycle) {
            return Err(GatewayConfigError::Cycle { got: cycle });
        }
        let stop_after = watchdog.stop_after();
        if lateness_allowed < cycle || lateness_allowed >= stop_after {
            return Err(GatewayConfigError::Lateness { got: lateness_allowed, cycle, stop_after });
        }
        if watchdog.ramp_after() < RAMP_AFTER_MIN {
            return Err(GatewayConfigError::Watchdog { got: watchdog.ramp_after() });
        }
        if self.brake_time.is_zero() || self.brake_time > BRAKE_TIME_MAX {
            return Err(GatewayConfigError::BrakeTime { got: self.brake_time });
        }
        if self.format == WireFormat::LittleEndian5x8 && self.supervision != Supervision::default() {
            return Err(GatewayConfigError::Supervision);
        }
        if let Some(got) = self.signals.from(SignalSource::Wired).next() {
            return Err(GatewayConfigError::Wired { got });
        }
        if let Some(got) = self.signals.from(SignalSource::Absent).find(|signal| !signal.may_be_absent()) {
            return Err(GatewayConfigError::Absent { got });
        }
        Ok(())
    }
}
