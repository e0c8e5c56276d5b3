//! Whole numbers of the wire, and what they are in SI units.

use std::f64::consts::TAU;

use pb3dp_kinematics::{DOF, JointVector};

/// Maximum speeds of the joints, rad/s, base to tip: about 57, 115 and 360 degrees/s by the data sheet.
pub const PA10_SPEED_MAX_RAD_PER_S: [f64; DOF] = [1.0, 1.0, 2.0, 2.0, TAU, TAU, TAU];

use super::{Axis, CodecError, WireFormat};

/// Turns of a motor per turn of its joint, on every axis (SDU, Orca).
pub const GEAR_RATIO: f64 = 50.0;

/// Angle counts per turn of a joint: 16384 per turn of the motor, times the gear (SDU, Orca).
pub const COUNTS_PER_TURN: i32 = 16384 * 50;

/// Speed counts per rad/s, in both formats (SDU, Orca).
const SPEED_COUNTS_PER_RAD_PER_S: f64 = 5000.0;

/// Torque counts of format B at the rated torque of the motor (Orca).
const TORQUE_COUNTS_AT_RATED: f64 = 4096.0;

/// Rated torques of the motors, N m on the motor's side (Orca, for a PA10-6CE; the axis that it lacks like its neighbour).
const RATED_MOTOR_TORQUE_N_M: [f64; DOF] = [4.64, 4.64, 2.0, 2.0, 0.29, 0.29, 0.29];

/// Torque counts per N m in format A (SDU), which does not say on which side of the gear.
const FORMAT_A_TORQUE_N_M: f64 = 0.001;

/// A joint angle as the controller counts it: 7.67e-6 rad. Never wrapped, as some joints turn by more than half a turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AngleCounts(pub i32);

impl AngleCounts {
    /// The angle, rad.
    pub fn to_rad(self) -> f64 {
        f64::from(self.0) * (TAU / f64::from(COUNTS_PER_TURN))
    }

    /// The count nearest to an angle of `axis`, rad.
    ///
    /// # Errors
    /// If the angle is not finite or has no count.
    pub fn from_rad(axis: Axis, angle_rad: f64) -> Result<Self, CodecError> {
        let counts = (angle_rad * (f64::from(COUNTS_PER_TURN) / TAU)).round();
        let possible = counts >= f64::from(i32::MIN) && counts <= f64::from(i32::MAX);
        // The comparison is false for NaN; after it the cast is exact.
        if possible { Ok(Self(counts as i32)) } else { Err(CodecError::AngleRange { axis, angle_rad }) }
    }
}

/// A joint speed as the controller counts it: 2e-4 rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SpeedCounts(pub i16);

impl SpeedCounts {
    /// At rest.
    pub const ZERO: Self = Self(0);

    /// The speed, rad/s.
    pub fn to_rad_per_s(self) -> f64 {
        f64::from(self.0) / SPEED_COUNTS_PER_RAD_PER_S
    }

    /// The count nearest to a speed of `axis`, rad/s.
    ///
    /// # Errors
    /// If the speed is not finite or beyond what 16 bits hold (6.55 rad/s): it is neither clamped nor wrapped.
    pub fn from_rad_per_s(axis: Axis, speed_rad_per_s: f64) -> Result<Self, CodecError> {
        let counts = (speed_rad_per_s * SPEED_COUNTS_PER_RAD_PER_S).round();
        let possible = counts >= f64::from(i16::MIN) && counts <= f64::from(i16::MAX);
        // The comparison is false for NaN; after it the cast is exact.
        if possible { Ok(Self(counts as i16)) } else { Err(CodecError::SpeedRange { axis, speed_rad_per_s }) }
    }
}

/// A measured torque as the controller counts it. Its unit depends on format and axis: [`TorqueScale`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TorqueCounts(pub i16);

/// N m at the joint per torque count, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueScale {
    joint_n_m_per_count: JointVector,
}

impl TorqueScale {
    /// Any scale: N m at the joint per count.
    pub fn new(joint_n_m_per_count: JointVector) -> Self {
        Self { joint_n_m_per_count }
    }

    /// What the sources say: format B counts 1/4096 of the motor's rated torque (Orca), format A 0.001 N m (SDU). For format A it
    /// is unknown whether at the motor or at the joint; the motor is assumed, which gives the larger torques.
    pub fn of_format(format: WireFormat) -> Self {
        let rated = JointVector::from(RATED_MOTOR_TORQUE_N_M);
        Self::new(match format {
            WireFormat::LittleEndian5x8 => JointVector::repeat(FORMAT_A_TORQUE_N_M * GEAR_RATIO),
            WireFormat::BigEndian6x10 => rated * (GEAR_RATIO / TORQUE_COUNTS_AT_RATED),
        })
    }

    /// A measured torque at the joint, N m.
    pub fn to_joint_n_m(&self, axis: Axis, counts: TorqueCounts) -> f64 {
        f64::from(counts.0) * self.joint_n_m_per_count[axis.index()]
    }

    /// The count nearest to a torque at the joint, N m.
    ///
    /// # Errors
    /// If the torque is not finite or beyond what 16 bits hold.
    pub fn from_joint_n_m(&self, axis: Axis, torque_n_m: f64) -> Result<TorqueCounts, CodecError> {
        let counts = (torque_n_m / self.joint_n_m_per_count[axis.index()]).round();
        let possible = counts >= f64::from(i16::MIN) && counts <= f64::from(i16::MAX);
        if possible { Ok(TorqueCounts(counts as i16)) } else { Err(CodecError::TorqueRange { axis, torque_n_m }) }
    }
}
