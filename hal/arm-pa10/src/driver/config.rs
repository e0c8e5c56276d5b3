//! Settings of a driver: its arm and its link.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{PA10_SPEED_MAX_RAD_PER_S, StatusSignals, Supervision};
use pb3dp_kinematics::{DOF, JointVector};

use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;

/// Minimum number of exchanges before the brakes open.
const WARM_UP_MIN: u32 = 100;

/// Minimum number of cycles at speed 0 before the brakes close.
const REST_CYCLES_MIN: u32 = 5;

/// Maximum torques at the joints, N m, base to tip: the lower values of two sources (INRIA for the PA10-7CE: 158, 158, 68, 68, 17,
/// 17, 17; Orca and the University of Florida: 232, 232, 100, 100, 14.5, 14.5, 14.5).
pub const PA10_TORQUE_MAX_N_M: [f64; DOF] = [158.0, 158.0, 68.0, 68.0, 14.5, 14.5, 14.5];

/// Upper bound of the time without a request of the owner.
const OWNER_TIMEOUT_MAX: Duration = Duration::from_secs(10);

/// Share of the maximum torques that is allowed permanently.
const TORQUE_PART: f64 = 0.8;

/// Upper bound of the time above the permanent torque.
const TORQUE_FOR_MAX: Duration = Duration::from_millis(200);

/// Settings of a driver: its arm and its link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Time between two cyclic commands: 10 ms.
    pub cycle: Duration,
    /// Time-out of the reply to a cyclic command: at most one cycle.
    pub reply_timeout: Duration,
    /// Time-out of the reply to any other message.
    pub control_timeout: Duration,
    /// When a velocity without a successor fades and stops.
    pub watchdog: CommandWatchdog,
    /// Longest time for which an arm holds with open brakes without a request of its owner: at most 10 s.
    pub owner_timeout: Duration,
    /// Exchanges with closed brakes that test the link before the brakes may open: at least 100.
    pub warm_up_exchanges: u32,
    /// Time that brakes take to open, and to close.
    pub brake_time: Duration,
    /// Cycles at speed 0 before the brakes close: at least 5.
    pub rest_cycles: u32,
    /// Deceleration of the joints on `Hold` and `Stop`, rad/s^2: each joint separately.
    pub deceleration_rad_per_s2: JointVector,
    /// Deceleration of the joints on a fault.
    pub emergency_ramp: Duration,
    /// Permanent torque limit of the joints, N m: with more in every measurement for [`Self::torque_for`], while the brakes are
    /// open, the arm is stopped.
    pub torque_max_n_m: JointVector,
    /// Allowed time above the permanent torque.
    pub torque_for: Duration,
    /// Time limit of an activity; exceeding it is a fault.
    pub activity_timeout: Duration,
    /// Use of the limits in the EEPROM.
    pub limits: LimitsCheck,
    /// Supervision by the controller itself (format B).
    pub supervision: Supervision,
    /// How the signals of the arm are noticed. Alarms of format B always count.
    pub signals: StatusSignals,
}

/// Use of the limits in the controller's EEPROM.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LimitsCheck {
    /// None: for arms that do not answer, and for a gateway that answers for them.
    Skip,
    /// Read them before the arm counts as connected.
    Read,
    /// Read them, and stop if an axis differs from these.
    Compare {
        /// Lower limits, rad.
        lower_rad: JointVector,
        /// Upper limits, rad.
        upper_rad: JointVector,
        /// Tolerance, rad.
        tolerance_rad: f64,
    },
}

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DriverConfigError {
    /// The cycle is zero, or so long that the watchdog would trip.
    #[error(
        "a cycle of {cycle:?} is out of range: give more than 0 and at most half of the time after which commands fade \
         ({ramp_after:?})"
    )]
    Cycle {
        /// The configured cycle.
        cycle: Duration,
        /// Time-out of the watchdog.
        ramp_after: Duration,
    },
    /// The reply time-out is zero or longer than a cycle.
    #[error(
        "a reply time-out of {reply_timeout:?} is out of range: give more than 0 and at most the cycle ({cycle:?})"
    )]
    ReplyTimeout {
        /// The configured time-out.
        reply_timeout: Duration,
        /// The configured cycle.
        cycle: Duration,
    },
    /// Too few exchanges or cycles.
    #[error("{what}: {got}, at least {least} are needed")]
    TooFew {
        /// Name of the field.
        what: &'static str,
        /// The configured number.
        got: u32,
        /// The minimum.
        least: u32,
    },
    /// A deceleration is not a positive number.
    #[error("axis {}: a deceleration of {got} rad/s^2 is not a positive, finite number", joint + 1)]
    Deceleration {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The configured number, rad/s^2.
        got: f64,
    },
    /// A torque limit is invalid, or larger than that of the arm.
    #[error(
        "axis {}: a maximum torque of {got} N m is out of range: give more than 0 and at most {most} N m",
        joint + 1
    )]
    Torque {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The configured number, N m.
        got: f64,
        /// The value of the sources, N m.
        most: f64,
    },
    /// The time above the permanent torque is too long.
    #[error("a torque above the limit for {got:?} is too long: give at most {most:?}")]
    TorqueFor {
        /// The configured time.
        got: Duration,
        /// The maximum.
        most: Duration,
    },
    /// The time without requests is shorter than that of a velocity, or too long.
    #[error(
        "{got:?} without a request while the arm holds is out of range: give more than {least:?} and at most {most:?}"
    )]
    OwnerTimeout {
        /// The configured time.
        got: Duration,
        /// Time after which a velocity stops the arm.
        least: Duration,
        /// The maximum.
        most: Duration,
    },
    /// A stop takes longer than an activity is allowed to.
    #[error(
        "axis {}: a stop from maximum speed takes {needed_s:.1} s at {deceleration} rad/s^2, an activity may take {got:?}: \
         increase the deceleration",
        joint + 1
    )]
    StopTimeout {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The configured deceleration, rad/s^2.
        deceleration: f64,
        /// Duration with brakes and messages, s.
        needed_s: f64,
        /// Time limit of an activity.
        got: Duration,
    },
    /// The time limit of an activity is too short.
    #[error("a time limit of {got:?} for an activity is too short: enabling and opening the brakes need {least:?}")]
    ActivityTimeout {
        /// The configured time.
        got: Duration,
        /// The minimum.
        least: Duration,
    },
}

impl DriverConfig {
    /// A configuration for a link with this cycle; the other values are those of the sources.
    pub fn with_cycle(cycle: Duration) -> Self {
        Self {
            cycle,
            reply_timeout: cycle,
            control_timeout: Duration::from_millis(100),
            watchdog: CommandWatchdog::default(),
            owner_timeout: Duration::from_secs(5),
            warm_up_exchanges: WARM_UP_MIN,
            brake_time: Duration::from_millis(200),
            rest_cycles: REST_CYCLES_MIN,
            deceleration_rad_per_s2: JointVector::from([2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0]),
            emergency_ramp: Duration::from_millis(30),
            torque_max_n_m: JointVector::from(PA10_TORQUE_MAX_N_M) * TORQUE_PART,
            torque_for: Duration::from_millis(50),
            activity_timeout: Duration::from_secs(10),
            limits: LimitsCheck::Skip,
            supervision: Supervision::default(),
            signals: StatusSignals::ORCA,
        }
    }

    pub(super) fn check(&self) -> Result<(), DriverConfigError> {
        let (cycle, ramp_after) = (self.cycle, self.watchdog.ramp_after());
        if cycle.is_zero() || cycle * 2 > ramp_after {
            return Err(DriverConfigError::Cycle { cycle, ramp_after });
        }
        if self.reply_timeout.is_zero() || self.reply_timeout > cycle {
            return Err(DriverConfigError::ReplyTimeout { reply_timeout: self.reply_timeout, cycle });
        }
        for (what, got, least) in [
            ("warm-up exchanges", self.warm_up_exchanges, WARM_UP_MIN),
            ("cycles at rest before the brakes close", self.rest_cycles, REST_CYCLES_MIN),
        ] {
            if got < least {
                return Err(DriverConfigError::TooFew { what, got, least });
            }
        }
        for (joint, &most) in PA10_TORQUE_MAX_N_M.iter().enumerate() {
            let got = self.deceleration_rad_per_s2[joint];
            if !(got.is_finite() && got > 0.0) {
                return Err(DriverConfigError::Deceleration { joint, got });
            }
            let got = self.torque_max_n_m[joint];
            if !(got > 0.0 && got <= most) {
                return Err(DriverConfigError::Torque { joint, got, most });
            }
        }
        let (got, least, most) = (self.owner_timeout, self.watchdog.stop_after(), OWNER_TIMEOUT_MAX);
        if got <= least || got > most {
            return Err(DriverConfigError::OwnerTimeout { got, least, most });
        }
        if self.torque_for > TORQUE_FOR_MAX {
            return Err(DriverConfigError::TorqueFor { got: self.torque_for, most: TORQUE_FOR_MAX });
        }
        let least = self.cycle * self.warm_up_exchanges * 2 + self.brake_time * 2;
        for (joint, &speed) in PA10_SPEED_MAX_RAD_PER_S.iter().enumerate() {
            let deceleration = self.deceleration_rad_per_s2[joint];
            // As numbers: a quotient may exceed the range of a duration.
            let needed_s = speed / deceleration + (self.cycle * (self.rest_cycles + 3) + self.brake_time).as_secs_f64();
            if needed_s > self.activity_timeout.as_secs_f64() {
                return Err(DriverConfigError::StopTimeout {
                    joint,
                    deceleration,
                    needed_s,
                    got: self.activity_timeout,
                });
            }
        }
        if self.activity_timeout < least {
            return Err(DriverConfigError::ActivityTimeout { got: self.activity_timeout, least });
        }
        Ok(())
    }
}
