//! Settings of an emulated controller.

use std::f64::consts::TAU;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{AngleCounts, Axis, COUNTS_PER_TURN, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{AxisMotion, LimitOutOfRange, MotionLimits};
use pb3dp_kinematics::{JointLimits, JointLimitsError, JointVector};
use pb3dp_sim::joint_dynamics::{JointPlantConfig, PA10_ANGLE_QUANTUM_RAD};

/// Limits of a PA10-7C(E) by MHI's model data and two drivers: +-177, 91, 174, 137, 255, 165, 255 degrees; S2 by OpenRAVE, others give 94.
const SERVO_LIMITS_DEG: [f64; Axis::COUNT] = [177.0, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0];

/// Mechanical stops, degrees (INRIA, for a PA10-7CE).
const END_STOPS_DEG: [f64; Axis::COUNT] = [180.0, 97.0, 180.0, 143.0, 270.0, 180.0, 270.0];

/// Maximum joint speeds, rad/s (INRIA; E2 is slower by another source).
const SPEED_MAX_RAD_PER_S: [f64; Axis::COUNT] = [1.0, 1.0, 2.0, 2.0, TAU, TAU, TAU];

/// Speed limits of the robot descriptions, rad/s: E2 by the slower source.
const SPEED_LIMITS_RAD_PER_S: [f64; Axis::COUNT] = [1.0, 1.0, 2.0, 2.0, 2.0, TAU, TAU];

/// Acceleration limits of the built-in setups, rad/s^2 (docs/arm-limits.md).
const ACCELERATION_LIMITS_RAD_PER_S2: [f64; Axis::COUNT] = [2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0];

/// Jerk limits of the built-in setups, rad/s^3 (docs/arm-limits.md).
const JERK_LIMITS_RAD_PER_S3: [f64; Axis::COUNT] = [80.0, 80.0, 80.0, 80.0, 200.0, 200.0, 200.0];

/// Joints of a PA10-7C(E) for an emulated arm. No source states their accelerations and lags: these drives are as fast as a stop
/// within a tenth of a second needs.
///
/// # Errors
/// Never, because these limits are valid.
pub fn pa10_joints() -> Result<JointPlantConfig, JointLimitsError> {
    let stops = JointVector::from(END_STOPS_DEG.map(f64::to_radians));
    Ok(JointPlantConfig {
        limits: JointLimits::new(-stops, stops, JointVector::from(SPEED_MAX_RAD_PER_S))?,
        acceleration_max_rad_per_s2: JointVector::repeat(40.0),
        velocity_time_constant: Duration::from_millis(5),
        command_delay: Duration::ZERO,
        angle_quantum_rad: PA10_ANGLE_QUANTUM_RAD,
        history: Duration::from_secs(2),
    })
}

/// Settings of an emulated controller.
#[derive(Clone, Debug, PartialEq)]
pub struct MockControllerConfig {
    /// Wire format.
    pub format: WireFormat,
    /// Time without a message in control mode after which it stops: sources state 6, 10 or 400 ms. `None`: it continues with the
    /// last velocities, which one source also reports.
    pub watchdog: Option<Duration>,
    /// From a message to its reply, on the bus and in the controller.
    pub reply_delay: Duration,
    /// Time that a brake takes to open: until then it holds.
    pub brake_open: Duration,
    /// Time that a brake takes to close: until then it does not hold.
    pub brake_close: Duration,
    /// Lower software limits in the EEPROM, rad.
    pub lower_limit_rad: JointVector,
    /// Upper software limits in the EEPROM, rad.
    pub upper_limit_rad: JointVector,
    /// Whether it answers the letter A. If not, S clears the alarms whose cause is gone.
    pub knows_clear_alarm: bool,
}

/// Why a controller cannot be emulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MockControllerError {
    /// The time-out is zero.
    #[error("a watchdog of 0 s would stop the arm between two commands: give 6 ms or more, or none")]
    Watchdog,
    /// The limits do not include zero.
    #[error("{axis}: limits of {lower_rad} to {upper_rad} rad are not a range around 0 within two turns; correct them")]
    Limits {
        /// Which axis.
        axis: Axis,
        /// The lower limit given, rad.
        lower_rad: f64,
        /// The upper limit given, rad.
        upper_rad: f64,
    },
}

impl MockControllerConfig {
    /// A controller with this format and a time-out of 6 ms; the other values are those of the sources.
    pub fn new(format: WireFormat) -> Self {
        let limits = JointVector::from(SERVO_LIMITS_DEG.map(f64::to_radians));
        Self {
            format,
            watchdog: Some(Duration::from_millis(6)),
            reply_delay: Duration::from_micros(400),
            brake_open: Duration::from_millis(150),
            brake_close: Duration::from_millis(50),
            lower_limit_rad: -limits,
            upper_limit_rad: limits,
            knows_clear_alarm: true,
        }
    }

    /// Motion limits for a gateway before this controller: those of the built-in setups, with the range of the EEPROM.
    ///
    /// # Errors
    /// If the range is none that the protocol can state.
    pub fn motion_limits(&self) -> Result<MotionLimits, LimitOutOfRange> {
        MotionLimits::new(&std::array::from_fn(|axis| AxisMotion {
            speed_max_rad_per_s: SPEED_LIMITS_RAD_PER_S[axis],
            acceleration_max_rad_per_s2: ACCELERATION_LIMITS_RAD_PER_S2[axis],
            jerk_max_rad_per_s3: JERK_LIMITS_RAD_PER_S3[axis],
            range_rad: [self.lower_limit_rad[axis], self.upper_limit_rad[axis]],
        }))
    }

    /// Lower and upper limit of an axis in the counts of the EEPROM.
    pub(super) fn limits(&self, axis: Axis) -> Result<[AngleCounts; 2], MockControllerError> {
        let (lower_rad, upper_rad) = (self.lower_limit_rad[axis.index()], self.upper_limit_rad[axis.index()]);
        let wrong = MockControllerError::Limits { axis, lower_rad, upper_rad };
        let counts = |angle_rad| AngleCounts::from_rad(axis, angle_rad).map_err(|_| wrong);
        let (lower, upper) = (counts(lower_rad)?, counts(upper_rad)?);
        let possible = lower.0 < 0 && upper.0 > 0 && lower.0 >= -2 * COUNTS_PER_TURN && upper.0 <= 2 * COUNTS_PER_TURN;
        if possible { Ok([lower, upper]) } else { Err(wrong) }
    }
}
