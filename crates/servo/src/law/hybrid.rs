//! 2 1/2-D visual servoing, for comparison: the image position of one point and the logarithm of its depth control the translation,
//! the remaining rotation controls the rotation. E. Malis, F. Chaumette and S. Boudet, "2 1/2 D visual servoing", IEEE Transactions
//! on Robotics and Automation 15(2), 1999; in the form of F. Chaumette and S. Hutchinson, "Visual servo control, Part II: Advanced
//! approaches", IEEE Robotics and Automation Magazine 14(1), 2007.
//!
//! The point is the model's origin at (X, Y, Z) in front of the camera. It appears at (x, y) = (X / Z, Y / Z); the desired image
//! position is (x*, y*) at the depth Z*. With v and w the camera's velocity and angular velocity in its own axes, and r the
//! rotation vector from the desired camera to the current one,
//!
//! ```text
//! e = (x - x*, y - y*, ln(Z / Z*)),      e' = Lv v / Z + Lw w
//!
//!      [-1  0  x]          [ x y    -(1+x^2)   y ]
//! Lv = [ 0 -1  y]     Lw = [1+y^2    -x y     -x ]
//!      [ 0  0 -1]          [ -y        x       0 ]
//!
//! w = -gain r,      v = -gain Z inv(Lv) (e - Lw r)
//! ```
//!
//! so that both e and r decrease exponentially, without a singularity in front of the camera: the point moves along a straight line
//! in the image, and the camera rotates about one axis.

use nalgebra::{Matrix3, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, Twist, so3};

use super::DEPTH_MIN_M;

/// Velocity of the left camera, in its own axes. `None` if the model's origin is not in front of the camera.
pub fn camera_twist(
    gain_per_s: f64,
    cam_left_from_model: &Pose<CamLeft, Model>,
    desired_from_model: &Pose<CamLeft, Model>,
) -> Option<Twist<CamLeft>> {
    let (current, wanted) = (cam_left_from_model.translation_m(), desired_from_model.translation_m());
    if !(current.z > DEPTH_MIN_M && wanted.z > DEPTH_MIN_M) {
        return None;
    }
    let (x, y) = (current.x / current.z, current.y / current.z);
    let error = Vector3::new(x - wanted.x / wanted.z, y - wanted.y / wanted.z, (current.z / wanted.z).ln());
    // From the axes of the current camera to those of the desired one: the inverse of the model's rotation.
    let turn = so3::log(&(desired_from_model.rotation() * cam_left_from_model.rotation().inverse()));
    let of_turn = Matrix3::new(
        x * y,
        -(1.0 + x * x),
        y, //
        1.0 + y * y,
        -x * y,
        -x, //
        -y,
        x,
        0.0,
    );
    let left = error - of_turn * turn;
    // inv(Lv), from the last row up.
    let along = Vector3::new(-left.x - x * left.z, -left.y - y * left.z, -left.z);
    Some(Twist::new(along * (-gain_per_s * current.z), turn * -gain_per_s))
}

#[cfg(test)]
mod tests {
    use super::super::image_based::tests::{moved, pose};
    use super::*;

    /// Image position, depth and rotation converge at the same rate, also from a large distance and a rotation of 100 degrees.
    #[test]
    fn all_errors_fall_exponentially() {
        let desired = pose([0.05, -0.02, 0.5], [0.1, 0.0, -0.2]);
        let begin = pose([-0.1, 0.15, 0.9], [0.4, -0.3, 1.6]);
        let errors = |current: &Pose<CamLeft, Model>| {
            let (p, d) = (current.translation_m(), desired.translation_m());
            let turn = current.rotation().angle_to(&desired.rotation());
            [p.x / p.z - d.x / d.z, p.y / p.z - d.y / d.z, (p.z / d.z).ln(), turn]
        };
        let (mut current, first) = (begin, errors(&begin));
        for _ in 0..2000 {
            current = moved(&current, &camera_twist(1.0, &current, &desired).unwrap(), 1e-3);
        }
        for (now, first) in errors(&current).into_iter().zip(first) {
            assert!((now / first / (-2.0_f64).exp() - 1.0).abs() < 5e-3, "{now} of {first}");
        }
    }

    /// Here the rotation that makes image-based servoing retreat causes a pure rotation.
    #[test]
    fn a_turn_about_the_optical_axis_leaves_the_camera_where_it_is() {
        let desired = pose([0.0, 0.0, 0.5], [0.0; 3]);
        let twist = camera_twist(2.0, &pose([0.0, 0.0, 0.5], [0.0, 0.0, 1.5]), &desired).unwrap();
        assert!(twist.linear_m_per_s.norm() < 1e-12, "{twist:?}");
        assert!((twist.angular_rad_per_s - Vector3::new(0.0, 0.0, 3.0)).norm() < 1e-12, "{twist:?}");
    }

    #[test]
    fn an_invisible_target_gives_no_twist() {
        let desired = pose([0.0, 0.0, 0.5], [0.0; 3]);
        assert!(camera_twist(1.0, &pose([0.0, 0.0, -0.5], [0.0; 3]), &desired).is_none());
        assert!(camera_twist(1.0, &pose([0.0, 0.0, f64::NAN], [0.0; 3]), &desired).is_none());
        assert!(camera_twist(1.0, &desired, &pose([0.0, 0.0, 0.0], [0.0; 3])).is_none());
    }
}
