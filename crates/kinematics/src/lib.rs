//! Serial arm kinematics from URDF: forward kinematics, Jacobian, limits. No device, no file.
//!
//! * [`Chain`] is read from a URDF text and answers where the flange and every joint are, and how they move.
//! * [`JointLimits`] are the position and speed limits that the description states.
//! * [`EffectiveLimits`] are what one arm may do in one run: everything that moves it, or watches it, receives them.
//! * [`clearance()`] is the room between two arms, [`clearance_within`] what is left of it while their joints move.
//! * [`reach()`] finds the joint angles that bring the flange to a pose.
//! * [`damped_pseudo_inverse`], [`smallest_singular_value`] and [`manipulability`] judge and invert a [`Jacobian`].
//!
//! Metres, radians, seconds; six or seven revolute joints, as the description has them, counted from the base.

pub mod chain;
pub mod clearance;
pub mod effective_limits;
pub mod jacobian;
pub mod limits;
pub mod reach;
mod urdf;

use nalgebra::SVector;
use pb3dp_geometry::MonotonicTime;

pub use chain::{Chain, JointFrames};
pub use clearance::{
    ArmPart, ArmShape, ArmShapeError, Capsule, Carrier, Clearance, PlacedArm, clearance, clearance_within,
};
pub use effective_limits::{EffectiveLimits, EffectiveLimitsError, StatedLimits};
pub use jacobian::{
    Damping, DampingError, Jacobian, PseudoInverse, SingularForm, damped_pseudo_inverse, manipulability,
    singular_values, smallest_singular_value,
};
pub use limits::{JointLimits, JointLimitsError, PositionViolation};
pub use reach::{NotReached, reach};
pub use urdf::ChainError;

/// The most joints that an arm can have. How many it has says its description ([`Chain::joints`]).
pub const DOF: usize = 7;

/// One number per joint, base to tip: positions (rad), velocities (rad/s) or accelerations, as the name of the variable says.
///
/// Of an arm with fewer joints than [`DOF`] the last numbers belong to none: they are zero, have a range of [`NO_JOINT_RAD`] to either
/// side, and nothing that the arm does depends on them, for their columns of the Jacobian are zero.
pub type JointVector = SVector<f64, DOF>;

/// In place of a limit where there is no joint, rad and rad/s: so wide that nothing comes near it.
pub const NO_JOINT_RAD: f64 = 1e3;

/// Measured joints at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointState {
    /// When they were measured, on the program's monotonic clock.
    pub at: MonotonicTime,
    /// Joint angles, rad, never wrapped (some joints turn by more than half a turn).
    pub position_rad: JointVector,
    /// Joint velocities, rad/s.
    pub velocity_rad_per_s: JointVector,
}
