//! The position-based law of the paper's authors.
//!
//! ```text
//! v_d = K_Pp r + K_Vp r'            w_d = K_Po R de + K_Vo w
//! ```
//!
//! The publication leaves some symbols open. Here they mean:
//! * `r`: from the hand's origin to the desired one, in `base`; `r'`: its rate, the velocity of the desired hand (from the
//!   smoothed observations) minus the measured velocity of the hand (from the joints);
//! * `de`: vector part of the quaternion `hand_from_hand_desired` with its sign chosen for a non-negative scalar part (so the
//!   shorter rotation is taken); `R`: `base_from_hand`, so that `R de` is in `base`; its length is
//!   sin(angle/2), not the angle;
//! * `w`: the rate of the orientation error, angular velocity of the desired hand minus that of the hand.
//!
//! The velocity of the hand is measured, so K_Vp is no feed-forward: the hand lags a target with constant speed by 1/K_Pp for every
//! K_Vp.

use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, Hand};
use pb3dp_geometry::{Pose, Twist};

use crate::config::Gains;

/// Error of the hand pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandError {
    /// `r`: from the hand's origin to the desired one, in `base`, metres.
    pub position_in_base_m: Vector3<f64>,
    /// `R de`: vector part of the error quaternion, in `base`, length at most 1.
    pub quaternion_vector_in_base: Vector3<f64>,
    /// Angle of the remaining rotation, radians, 0 to pi.
    pub angle_rad: f64,
}

impl HandError {
    /// Error of a hand at `base_from_hand` whose desired pose is `base_from_hand_desired`.
    pub fn new(base_from_hand: &Pose<Base, Hand>, base_from_hand_desired: &Pose<Base, Hand>) -> Self {
        let position_in_base_m = base_from_hand_desired.translation_m() - base_from_hand.translation_m();
        let hand_from_desired = base_from_hand.rotation().inverse() * base_from_hand_desired.rotation();
        let shorter = if hand_from_desired.w < 0.0 { -1.0 } else { 1.0 };
        let vector_in_hand = hand_from_desired.vector() * shorter;
        let angle_rad = 2.0 * vector_in_hand.norm().atan2(hand_from_desired.w.abs());
        Self { position_in_base_m, quaternion_vector_in_base: base_from_hand.rotation() * vector_in_hand, angle_rad }
    }
}

/// Desired velocity of the hand: of its origin, and angular, in `base`.
///
/// `desired` and `hand` are the velocities of the desired and of the present hand: of their origins, and angular, in `base`.
pub fn hand_twist(gains: &Gains, error: &HandError, desired: &Twist<Base>, hand: &Twist<Base>) -> Twist<Base> {
    let position_rate = desired.linear_m_per_s - hand.linear_m_per_s;
    let orientation_rate = desired.angular_rad_per_s - hand.angular_rad_per_s;
    Twist::new(
        error.position_in_base_m * gains.position_per_s + position_rate * gains.velocity,
        error.quaternion_vector_in_base * gains.orientation_per_s + orientation_rate * gains.angular_velocity,
    )
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    fn pose(translation: [f64; 3], rotation_vector: [f64; 3]) -> Pose<Base, Hand> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(rotation_vector));
        Pose::from_parts(Vector3::from(translation), rotation)
    }

    #[test]
    fn error_is_in_base_and_its_vector_is_the_sine_of_half_the_angle() {
        let hand = pose([0.3, -0.2, 0.9], [0.4, 1.1, -0.3]);
        let turn_in_base = Vector3::new(-0.2, 0.5, 0.3);
        let turned = UnitQuaternion::from_scaled_axis(turn_in_base) * hand.rotation();
        let desired = Pose::from_parts(Vector3::new(0.1, 0.25, 0.7), turned);
        let error = HandError::new(&hand, &desired);
        assert!((error.position_in_base_m - Vector3::new(-0.2, 0.45, -0.2)).norm() < 1e-12);
        let angle = turn_in_base.norm();
        assert!((error.angle_rad - angle).abs() < 1e-12);
        let expected = turn_in_base / angle * (0.5 * angle).sin();
        assert!((error.quaternion_vector_in_base - expected).norm() < 1e-12, "{error:?}");
    }

    #[test]
    fn both_quaternions_of_a_rotation_give_the_same_shorter_way() {
        let hand = pose([0.0; 3], [0.2, -0.7, 0.4]);
        // 200 degrees about an axis are 160 degrees about the opposite axis.
        let axis = Vector3::new(1.0, -2.0, 2.0) / 3.0;
        let long = UnitQuaternion::from_scaled_axis(axis * 200f64.to_radians());
        let desired = long * hand.rotation();
        for rotation in [desired, UnitQuaternion::new_unchecked(-desired.into_inner())] {
            let error = HandError::new(&hand, &Pose::from_parts(Vector3::zeros(), rotation));
            assert!((error.angle_rad - 160f64.to_radians()).abs() < 1e-9, "{error:?}");
            let expected = -axis * 80f64.to_radians().sin();
            assert!((error.quaternion_vector_in_base - expected).norm() < 1e-12, "{error:?}");
        }
    }

    #[test]
    fn law_is_the_published_sum() {
        let gains = Gains { position_per_s: 3.0, velocity: 0.5, orientation_per_s: 5.0, angular_velocity: 0.2 };
        let error = HandError {
            position_in_base_m: Vector3::new(0.1, -0.2, 0.3),
            quaternion_vector_in_base: Vector3::new(-0.3, 0.1, 0.2),
            angle_rad: 0.7,
        };
        let desired = Twist::new(Vector3::new(0.02, 0.04, -0.06), Vector3::new(0.5, 0.0, -0.5));
        let hand = Twist::new(Vector3::new(0.04, 0.0, 0.02), Vector3::new(0.0, 1.0, 0.0));
        let twist = hand_twist(&gains, &error, &desired, &hand);
        assert!((twist.linear_m_per_s - Vector3::new(0.29, -0.58, 0.86)).norm() < 1e-12, "{twist:?}");
        assert!((twist.angular_rad_per_s - Vector3::new(-1.4, 0.3, 0.9)).norm() < 1e-12, "{twist:?}");
    }
}
