//! From the velocity of the hand to joint velocities within the limits.
//!
//! Whatever has to be slowed down is slowed down as a whole, so that the hand keeps its direction.

use nalgebra::Point3;
use pb3dp_geometry::Twist;
use pb3dp_geometry::frames::Base;
use pb3dp_kinematics::{
    Chain, DOF, Damping, Jacobian, JointFrames, JointLimits, JointVector, damped_pseudo_inverse,
    smallest_singular_value,
};

use crate::config::{CartesianSpeed, SpeedConfig};

/// What makes the hand slower than the law wants; the strongest one is named.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limitation {
    /// The largest speed of the hand.
    HandSpeed,
    /// The speed limit of a joint, counted from 0 at the base.
    JointSpeed {
        /// Index from the base.
        joint: usize,
    },
    /// A joint is near an end of its range and moves towards it.
    JointRange {
        /// Index from the base.
        joint: usize,
    },
    /// The start after a rest.
    SoftStart,
}

/// The Jacobian of the hand at one moment.
#[derive(Clone, Copy, Debug)]
pub struct HandJacobian {
    jacobian: Jacobian,
    smallest_singular_value: f64,
}

impl HandJacobian {
    /// Jacobian of the point `hand_origin_in_base` (metres), which is fixed to the flange.
    pub fn new(chain: &Chain, frames: &JointFrames, hand_origin_in_base: &Point3<f64>) -> Self {
        let jacobian = chain.jacobian_at(frames, hand_origin_in_base);
        Self { jacobian, smallest_singular_value: smallest_singular_value(&jacobian) }
    }

    /// Smallest singular value, metres and radians.
    pub fn smallest_singular_value(&self) -> f64 {
        self.smallest_singular_value
    }

    /// Velocity of the hand's origin and its angular velocity, in `base`, at these joint velocities (rad/s).
    pub fn twist(&self, velocity_rad_per_s: &JointVector) -> Twist<Base> {
        Twist::from_vector(&(self.jacobian * velocity_rad_per_s))
    }

    /// Joint velocities (rad/s) that give the hand this velocity, damped near singular poses.
    pub fn joint_velocity(&self, twist: &Twist<Base>, damping: &Damping) -> JointVector {
        damped_pseudo_inverse(&self.jacobian, damping) * twist.to_vector()
    }
}

/// Joint velocities after all limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitedVelocity {
    /// Joint velocities, rad/s.
    pub velocity_rad_per_s: JointVector,
    /// Share of the wanted speed that is left, 0 to 1.
    pub share: f64,
    /// What took most of it; `None` if nothing did.
    pub limited_by: Option<Limitation>,
}

/// Scales a twist down to the hand's largest speed.
pub fn limit_twist(twist: &Twist<Base>, most: &CartesianSpeed) -> (Twist<Base>, f64) {
    let linear = share_of(twist.linear_m_per_s.norm(), most.linear_m_per_s);
    let share = linear.min(share_of(twist.angular_rad_per_s.norm(), most.angular_rad_per_s));
    (Twist::new(twist.linear_m_per_s * share, twist.angular_rad_per_s * share), share)
}

/// Scales joint velocities down to the joints' speeds and to what the distance to the ends of their ranges allows.
pub fn limit_joints(
    velocity_rad_per_s: &JointVector,
    position_rad: &JointVector,
    limits: &JointLimits,
    config: &SpeedConfig,
) -> LimitedVelocity {
    let mut share = 1.0;
    let mut limited_by = None;
    for joint in 0..DOF {
        let velocity = velocity_rad_per_s[joint];
        let most = limits.velocity_max_rad_per_s()[joint] * config.joint_speed_scale;
        let room_rad = if velocity > 0.0 {
            limits.position_max_rad()[joint] - position_rad[joint]
        } else {
            position_rad[joint] - limits.position_min_rad()[joint]
        };
        let most_here = room_rad.max(0.0) * config.limit_approach_per_s;
        for (most, limitation) in
            [(most, Limitation::JointSpeed { joint }), (most_here, Limitation::JointRange { joint })]
        {
            let left = share_of(velocity.abs(), most);
            if left < share {
                share = left;
                limited_by = Some(limitation);
            }
        }
    }
    LimitedVelocity { velocity_rad_per_s: velocity_rad_per_s * share, share, limited_by }
}

fn share_of(speed: f64, most: f64) -> f64 {
    if speed > most { most / speed } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn limits() -> JointLimits {
        let max = JointVector::from([2.9, 1.5, 2.9, 2.2, 4.3, 2.7, 4.3]);
        JointLimits::new(-max, max, JointVector::from([1.0, 1.0, 2.0, 2.0, 6.0, 6.0, 6.0])).unwrap()
    }

    const CONFIG: SpeedConfig = SpeedConfig {
        tracking: CartesianSpeed { linear_m_per_s: 0.5, angular_rad_per_s: 1.0 },
        joint_speed_scale: 0.5,
        limit_approach_per_s: 2.0,
        soft_start_s: 0.0,
    };

    #[test]
    fn a_twist_keeps_its_direction() {
        let twist = Twist::new(Vector3::new(0.3, 0.0, -0.4), Vector3::new(0.0, -2.5, 0.0));
        let (slow, share) = limit_twist(&twist, &CONFIG.tracking);
        assert!((share - 0.4).abs() < 1e-12);
        assert!((slow.to_vector() - twist.to_vector() * 0.4).norm() < 1e-12);
        let (same, share) = limit_twist(&slow, &CONFIG.tracking);
        assert_eq!((share, same), (1.0, slow));
    }

    #[test]
    fn the_joint_that_is_most_too_fast_decides() {
        let wanted = JointVector::from([0.75, -1.5, 0.2, 0.0, 0.0, 0.0, 4.0]);
        let limited = limit_joints(&wanted, &JointVector::zeros(), &limits(), &CONFIG);
        assert_eq!(limited.limited_by, Some(Limitation::JointSpeed { joint: 1 }));
        assert!((limited.velocity_rad_per_s - wanted / 3.0).norm() < 1e-12, "{limited:?}");
        let limited = limit_joints(&(wanted * 0.3), &JointVector::zeros(), &limits(), &CONFIG);
        assert_eq!((limited.limited_by, limited.share), (None, 1.0));
    }

    #[test]
    fn a_joint_near_its_end_slows_outwards_and_not_inwards() {
        let mut position = JointVector::zeros();
        position[3] = -2.15;
        let outwards = JointVector::from([0.1, 0.0, 0.0, -0.4, 0.0, 0.0, 0.0]);
        let limited = limit_joints(&outwards, &position, &limits(), &CONFIG);
        assert_eq!(limited.limited_by, Some(Limitation::JointRange { joint: 3 }));
        assert!((limited.velocity_rad_per_s - outwards * 0.25).norm() < 1e-12, "{limited:?}");
        assert_eq!(limit_joints(&-outwards, &position, &limits(), &CONFIG).share, 1.0);
        position[3] = -2.25;
        assert_eq!(limit_joints(&outwards, &position, &limits(), &CONFIG).share, 0.0);
        assert_eq!(limit_joints(&-outwards, &position, &limits(), &CONFIG).share, 1.0);
    }
}
