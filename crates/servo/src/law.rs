//! Control laws: from the error of the hand to its velocity.

pub mod feed_forward;
pub mod hybrid;
pub mod image_based;
pub mod pose_based;

use pb3dp_geometry::frames::{Base, CamLeft, Hand};
use pb3dp_geometry::{Pose, Twist};

/// Minimum depth of a point in front of the camera, metres.
const DEPTH_MIN_M: f64 = 1e-3;

/// Velocity of the hand's origin and its angular velocity, in `base`, for this twist of the camera on the hand.
pub fn hand_twist_of_camera(
    camera: &Twist<CamLeft>,
    base_from_hand: &Pose<Base, Hand>,
    hand_from_cam_left: &Pose<Hand, CamLeft>,
) -> Twist<Base> {
    let base_from_cam = *base_from_hand * *hand_from_cam_left;
    let in_base = camera.expressed_in(&base_from_cam);
    let lever = base_from_hand.translation_m() - base_from_cam.translation_m();
    let angular = in_base.angular_rad_per_s;
    Twist::new(in_base.linear_m_per_s + angular.cross(&lever), angular)
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    /// Hand and camera are one rigid body: a small motion of the camera moves the hand with it.
    #[test]
    fn the_hand_moves_as_the_camera_on_it() {
        let turned = |x, y, z| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z));
        let base_from_hand = Pose::from_parts(Vector3::new(0.6, -0.2, 0.4), turned(0.3, 1.1, -0.4));
        let hand_from_cam = Pose::from_parts(Vector3::new(-0.05, 0.07, 0.02), turned(-0.1, 0.15, 0.3));
        let twist = Twist::<CamLeft>::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(-0.4, 0.2, 0.7));
        let h = 1e-6;
        let step = Pose::<CamLeft, CamLeft>::from_parts(
            twist.linear_m_per_s * h,
            UnitQuaternion::from_scaled_axis(twist.angular_rad_per_s * h),
        );
        let after = base_from_hand * hand_from_cam * step * hand_from_cam.inverse();
        let found = hand_twist_of_camera(&twist, &base_from_hand, &hand_from_cam);
        let linear = (after.translation_m() - base_from_hand.translation_m()) / h;
        let angular = (after.rotation() * base_from_hand.rotation().inverse()).scaled_axis() / h;
        assert!((found.linear_m_per_s - linear).norm() < 1e-5, "{found:?} {linear}");
        assert!((found.angular_rad_per_s - angular).norm() < 1e-5, "{found:?} {angular}");
    }
}
