//! The joints of emulated arms.

use std::time::Duration;

use pb3dp_kinematics::{JointLimits, JointVector};
use pb3dp_sim::joint_dynamics::JointPlantConfig;

/// Joints of a PA-10 from public sources; the drives are fast enough for a stop within some 10 ms.
pub fn plant_config() -> JointPlantConfig {
    let max = JointVector::from([180.0f64, 97.0, 180.0, 143.0, 270.0, 180.0, 270.0].map(f64::to_radians));
    let speed = JointVector::from([1.0, 1.0, 2.0, 2.0, 2.0, 6.2, 6.2]);
    JointPlantConfig {
        limits: JointLimits::new(-max, max, speed).unwrap(),
        acceleration_max_rad_per_s2: JointVector::repeat(40.0),
        velocity_time_constant: Duration::from_millis(5),
        command_delay: Duration::ZERO,
        angle_quantum_rad: 0.0,
        history: Duration::from_secs(1),
    }
}
