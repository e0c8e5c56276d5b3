//! Forces on a joint other than its drive: brake, friction, gravity.

use std::time::Duration;

use pb3dp_kinematics::{DOF, JointVector};

use super::motion::Drive;
use super::{JointPlantConfig, JointPlantError};

/// Indices of the joints that gravity moves if nothing holds them: S2, E1 and W1. The others rotate about the links.
const PITCH_JOINTS: [usize; 3] = [1, 3, 5];

/// What holds or moves a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AxisMode {
    /// The drive: follows velocity commands.
    #[default]
    Servo,
    /// The brake: the joint stops and holds.
    Brake,
    /// Nothing: the joint falls or coasts.
    Free,
    /// A drive that follows this velocity instead of the commands, even above the speed limit.
    Driven {
        /// The velocity, rad/s.
        velocity_rad_per_s: f64,
    },
}

/// Friction, brakes and gravity of the joints.
#[derive(Clone, Debug, PartialEq)]
pub struct JointMechanics {
    /// Velocity error of a drive caused by dry friction, rad/s; a smaller command does not move the joint.
    pub servo_friction_rad_per_s: JointVector,
    /// Deceleration of a joint by its closed brake, rad/s^2.
    pub brake_deceleration_rad_per_s2: JointVector,
    /// Gravitational acceleration of an unheld joint, rad/s^2, with the arm stretched out horizontally. Only S2, E1 and W1 fall.
    /// The effective share follows from the sum of their angles, which is exact while S3 and E2 are at 0, and stays constant from
    /// the moment when the joint became free.
    pub gravity_rad_per_s2: JointVector,
    /// Dry friction of an unheld joint, rad/s^2.
    pub free_friction_rad_per_s2: JointVector,
    /// Time constant of the viscous friction of an unheld joint, above 0.
    pub free_time_constant: Duration,
}

impl Default for JointMechanics {
    /// Drives without friction, fast brakes; free joints fall roughly like those of an arm of 35 kg with harmonic drives. These
    /// values are not based on measurements.
    fn default() -> Self {
        Self {
            servo_friction_rad_per_s: JointVector::zeros(),
            brake_deceleration_rad_per_s2: JointVector::repeat(50.0),
            gravity_rad_per_s2: JointVector::from([0.0, 6.0, 0.0, 9.0, 0.0, 12.0, 0.0]),
            free_friction_rad_per_s2: JointVector::repeat(1.0),
            free_time_constant: Duration::from_millis(300),
        }
    }
}

impl JointMechanics {
    pub(super) fn check(&self) -> Result<(), JointPlantError> {
        positive("brake_deceleration_rad_per_s2", &self.brake_deceleration_rad_per_s2)?;
        for (name, values) in [
            ("servo_friction_rad_per_s", &self.servo_friction_rad_per_s),
            ("gravity_rad_per_s2", &self.gravity_rad_per_s2),
            ("free_friction_rad_per_s2", &self.free_friction_rad_per_s2),
        ] {
            in_range(name, values, |value| value >= 0.0, "zero or a positive, finite number")?;
        }
        if self.free_time_constant.is_zero() {
            let allowed = "longer than 0 s";
            return Err(JointPlantError::Config { name: "free_time_constant", joint: None, value: 0.0, allowed });
        }
        Ok(())
    }

    /// Drive parameters of the joints at these angles.
    pub(super) fn drives(
        &self,
        config: &JointPlantConfig,
        modes: &[AxisMode; DOF],
        position_rad: &JointVector,
    ) -> [Drive; DOF] {
        let limits = &config.limits;
        let gravity = self.gravity_on(modes, position_rad);
        std::array::from_fn(|i| {
            let servo = Drive {
                acceleration_max: config.acceleration_max_rad_per_s2[i],
                time_constant: config.velocity_time_constant.as_secs_f64(),
                velocity_max: limits.velocity_max_rad_per_s()[i],
                friction: self.servo_friction_rad_per_s[i],
                stops: [limits.position_min_rad()[i], limits.position_max_rad()[i]],
            };
            match modes[i] {
                AxisMode::Servo => servo,
                AxisMode::Driven { velocity_rad_per_s } => {
                    Drive { velocity_max: servo.velocity_max.max(velocity_rad_per_s.abs()), ..servo }
                }
                AxisMode::Brake => {
                    let acceleration_max = self.brake_deceleration_rad_per_s2[i];
                    Drive { acceleration_max, time_constant: 0.0, friction: 0.0, ..servo }
                }
                AxisMode::Free => {
                    let time_constant = self.free_time_constant.as_secs_f64();
                    let friction = self.free_friction_rad_per_s2[i];
                    // Only forces limit the acceleration: never saturated, at any speed that a joint reaches.
                    let acceleration_max =
                        gravity[i].abs() + friction + 100.0 * (1.0 + servo.velocity_max) / time_constant;
                    let velocity_max = f64::MAX;
                    Drive { acceleration_max, time_constant, velocity_max, friction: friction * time_constant, ..servo }
                }
            }
        })
    }

    /// Terminal velocities of the joints, without friction.
    pub(super) fn targets(
        &self,
        modes: &[AxisMode; DOF],
        position_rad: &JointVector,
        commanded_rad_per_s: &JointVector,
    ) -> JointVector {
        let gravity = self.gravity_on(modes, position_rad);
        JointVector::from(std::array::from_fn::<f64, DOF, _>(|i| match modes[i] {
            AxisMode::Servo => commanded_rad_per_s[i],
            AxisMode::Driven { velocity_rad_per_s } => velocity_rad_per_s,
            AxisMode::Brake => 0.0,
            AxisMode::Free => gravity[i] * self.free_time_constant.as_secs_f64(),
        }))
    }

    /// Gravitational acceleration in this pose, rad/s^2: away from upright. `None` if every joint is held.
    fn gravity_on(&self, modes: &[AxisMode; DOF], position_rad: &JointVector) -> JointVector {
        let mut gravity = JointVector::zeros();
        if !modes.contains(&AxisMode::Free) {
            return gravity;
        }
        let mut tilt = 0.0;
        for joint in PITCH_JOINTS {
            tilt += position_rad[joint];
            gravity[joint] = self.gravity_rad_per_s2[joint] * tilt.sin();
        }
        gravity
    }
}

/// Checks that parameters are positive and finite.
pub(super) fn positive(name: &'static str, values: &JointVector) -> Result<(), JointPlantError> {
    in_range(name, values, |value| value > 0.0, "a positive, finite number")
}

fn in_range(
    name: &'static str,
    values: &JointVector,
    is_allowed: fn(f64) -> bool,
    allowed: &'static str,
) -> Result<(), JointPlantError> {
    match values.iter().position(|&value| !(value.is_finite() && is_allowed(value))) {
        Some(joint) => Err(JointPlantError::Config { name, joint: Some(joint), value: values[joint], allowed }),
        None => Ok(()),
    }
}
