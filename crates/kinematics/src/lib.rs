//! Serial arm kinematics from URDF: forward kinematics, Jacobian, limits. No device.

use nalgebra::SVector;

/// Joints of the arms that this project drives (PA-10, seven revolute joints).
pub const DOF: usize = 7;

/// One number per joint, base to tip: positions (rad), velocities (rad/s) or accelerations, as the name of the variable says.
pub type JointVector = SVector<f64, DOF>;
