//! A mock PA-10 as the tests of the wrappers use it.

#![allow(dead_code, reason = "not every test needs everything")]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10::{MockArm, MockArmConfig};
use pb3dp_hal_api::{Clock, JointCommand};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_middleware::{GuardConfig, LimiterConfig, StartPose};
use pb3dp_kinematics::{Chain, JointLimits, JointVector};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig, PA10_ANGLE_QUANTUM_RAD};

pub const CYCLE: Duration = Duration::from_millis(10);

pub fn hard_limits() -> JointLimits {
    let urdf = include_str!("../../../../configs/robots/pa10_gen2.urdf");
    *Chain::from_urdf_str(urdf, "base_link", "flange").unwrap().limits()
}

pub fn acceleration() -> JointVector {
    JointVector::from([2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0])
}

/// A twentieth of a second to the largest acceleration.
pub fn jerk() -> JointVector {
    acceleration() * 20.0
}

/// The mock arm rests when it hears nothing for so long.
pub const COMMAND_TIMEOUT: Duration = Duration::from_millis(60);

/// For an arm in cycles of up to 20 ms, with 15 ms of delay and 30 ms of lag.
pub fn limiter_config(speed_scale: f64) -> LimiterConfig {
    let (operating_min_rad, operating_max_rad) = LimiterConfig::pa10_operating_range_rad();
    LimiterConfig {
        hard_limits: hard_limits(),
        operating_min_rad,
        operating_max_rad,
        speed_scale,
        acceleration_max_rad_per_s2: acceleration(),
        jerk_max_rad_per_s3: jerk(),
        reaction_time: Duration::from_millis(65),
        command_timeout: COMMAND_TIMEOUT,
        fade: None,
        stale_after: Duration::from_millis(50),
        start: StartPose::Anywhere,
    }
}

pub fn guard_config(speed_scale: f64) -> GuardConfig {
    let (mechanical_min_rad, mechanical_max_rad) = GuardConfig::pa10_mechanical_range_rad();
    GuardConfig {
        hard_limits: hard_limits(),
        mechanical_min_rad,
        mechanical_max_rad,
        speed_scale,
        acceleration_max_rad_per_s2: acceleration(),
        delay: Duration::from_millis(15),
        lag: Duration::from_millis(30),
        tracking_error_max_rad: GuardConfig::TRACKING_ERROR_MAX_RAD,
        tracking_error_for: GuardConfig::TRACKING_ERROR_FOR,
    }
}

pub fn velocity(joint: usize, value: f64) -> JointCommand {
    let mut velocity = JointVector::zeros();
    velocity[joint] = value;
    JointCommand::Velocity(velocity)
}

/// The drives are as strong as the wrappers take them to be.
pub fn mock_arm(clock: &Arc<VirtualClock>, start: JointVector) -> MockArm {
    let config = JointPlantConfig {
        limits: hard_limits(),
        acceleration_max_rad_per_s2: acceleration(),
        velocity_time_constant: Duration::from_millis(30),
        command_delay: Duration::from_millis(15),
        angle_quantum_rad: PA10_ANGLE_QUANTUM_RAD,
        history: Duration::from_secs(120),
    };
    let plant = Arc::new(Mutex::new(JointPlant::new(config, start, clock.now()).unwrap()));
    let config = MockArmConfig { name: "vs-robot".to_owned(), cycle: CYCLE, command_timeout: COMMAND_TIMEOUT };
    MockArm::new(config, plant, Arc::clone(clock) as Arc<dyn Clock>)
}
