//! Serial arm kinematics from URDF: forward kinematics, Jacobian, limits. The crate uses no device and no file.
//!
//! * [`Chain`] is read from a URDF text and computes the poses of the flange and of every joint, and the Jacobian.
//! * [`JointLimits`] are the position and speed limits from the description.
//! * [`EffectiveLimits`] are the limits of one arm in one run, used by everything that moves or monitors it.
//! * [`clearance()`] is the distance between two arms, [`clearance_within`] a lower bound while their joints move.
//! * [`reach()`] finds the joint angles that bring the flange to a pose.
//! * [`damped_pseudo_inverse`], [`smallest_singular_value`] and [`manipulability`] invert and evaluate a [`Jacobian`].
//!
//! Units are metres, radians and seconds; six or seven revolute joints, as in the description, numbered from the base.

pub mod chain;
mod chain_error;
pub mod clearance;
mod description;
pub mod effective_limits;
pub mod jacobian;
pub mod limits;
pub mod reach;
mod urdf;

use nalgebra::SVector;
use pb3dp_geometry::MonotonicTime;

pub use chain::{Chain, JointFrames};
pub use chain_error::ChainError;
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

/// Largest number of joints of an arm. The description gives the actual number ([`Chain::joints`]).
pub const DOF: usize = 7;

/// One number per joint, base to tip: positions (rad), velocities (rad/s) or accelerations, according to the variable's name.
///
/// For an arm with fewer joints than [`DOF`] the last numbers are unused: they are zero and have a range of [`NO_JOINT_RAD`] to
/// either side. Nothing depends on them, because their columns of the Jacobian are zero.
pub type JointVector = SVector<f64, DOF>;

/// Limit of a joint that does not exist, rad and rad/s: so large that it is never reached.
pub const NO_JOINT_RAD: f64 = 1e3;

/// Measured joint state at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointState {
    /// Time of the measurement, on the program's monotonic clock.
    pub at: MonotonicTime,
    /// Joint angles, rad, never wrapped (some joints rotate by more than half a turn).
    pub position_rad: JointVector,
    /// Joint velocities, rad/s.
    pub velocity_rad_per_s: JointVector,
}
