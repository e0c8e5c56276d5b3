//! Serial arm kinematics from URDF: forward kinematics, Jacobian, limits. No device.

use nalgebra::SVector;
use pb3dp_geometry::MonotonicTime;

/// Joints of the arms that this project drives (PA-10, seven revolute joints).
pub const DOF: usize = 7;

/// One number per joint, base to tip: positions (rad), velocities (rad/s) or accelerations, as the name of the variable says.
pub type JointVector = SVector<f64, DOF>;

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
