//! Classical image-based visual servoing, for comparison: the points of the model move to their desired positions in the left
//! image, each along a straight line. F. Chaumette and S. Hutchinson, "Visual servo control, Part I: Basic approaches", IEEE
//! Robotics and Automation Magazine 13(4), 2006, equations (2) to (5) and (11).
//!
//! A point at (X, Y, Z) in front of the camera appears at (x, y) = (X / Z, Y / Z). If the camera moves with velocity v and angular
//! velocity w, both in its own axes, the point moves by
//!
//! ```text
//! [x']   [-1/Z   0   x/Z    x y    -(1+x^2)   y ] [v]
//! [y'] = [  0  -1/Z  y/Z   1+y^2    -x y     -x ] [w]
//! ```
//!
//! With these rows of all points stacked to L, at the current image positions and depths (from the estimated pose), and e the
//! stacked differences between the points and their desired positions, the camera moves with
//!
//! ```text
//! (v, w) = -gain pinv(L) e
//! ```
//!
//! so that e decreases exponentially if the points allow it. The path of the hand is not controlled: for a large rotation
//! about the optical axis the points move straight through the middle of the image, and the camera retreats ("Chaumette's
//! conundrum", Part II, 2007), to infinity for 180 degrees.

use nalgebra::{Matrix6, Point3, SMatrix, SVector, Vector6};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, Twist};

use super::DEPTH_MIN_M;

/// Points of the model: the corners of a square around its origin, in its plane.
const POINTS: usize = 4;
/// Two image coordinates per point.
const ROWS: usize = 2 * POINTS;
/// A point in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ImagePoint {
    x: f64,
    y: f64,
    depth_m: f64,
}

impl ImagePoint {
    fn of(point: &Point3<f64>) -> Option<Self> {
        let depth_m = point.z;
        (depth_m > DEPTH_MIN_M).then(|| Self { x: point.x / depth_m, y: point.y / depth_m, depth_m })
    }

    /// Interaction matrix of the point: image velocity per velocity (m/s) and angular velocity (rad/s) in camera axes.
    fn interaction(&self) -> SMatrix<f64, 2, 6> {
        let Self { x, y, depth_m } = *self;
        let near = 1.0 / depth_m;
        SMatrix::<f64, 2, 6>::new(
            -near,
            0.0,
            x * near,
            x * y,
            -(1.0 + x * x),
            y, //
            0.0,
            -near,
            y * near,
            1.0 + y * y,
            -x * y,
            -x,
        )
    }
}

/// Velocity of the left camera, in its own axes, that moves the corners of a square of the model (`half_width_m` on either side of
/// its origin) to their desired image positions. `None` if a corner is not in front of the camera, or the corners do not determine
/// all six degrees of freedom.
pub fn camera_twist(
    gain_per_s: f64,
    half_width_m: f64,
    cam_left_from_model: &Pose<CamLeft, Model>,
    desired_from_model: &Pose<CamLeft, Model>,
) -> Option<Twist<CamLeft>> {
    let mut interaction = SMatrix::<f64, ROWS, 6>::zeros();
    let mut error = SVector::<f64, ROWS>::zeros();
    for (corner, (side, up)) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].into_iter().enumerate() {
        let point = Point3::new(side * half_width_m, up * half_width_m, 0.0);
        let current = ImagePoint::of(&cam_left_from_model.transform_point(&point))?;
        let wanted = ImagePoint::of(&desired_from_model.transform_point(&point))?;
        let row = 2 * corner;
        interaction.fixed_rows_mut::<2>(row).copy_from(&current.interaction());
        (error[row], error[row + 1]) = (current.x - wanted.x, current.y - wanted.y);
    }
    let normal: Matrix6<f64> = interaction.transpose() * interaction;
    let solved: Vector6<f64> = normal.cholesky()?.solve(&(interaction.transpose() * error));
    Some(Twist::from_vector(&(solved * -gain_per_s)))
}

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    pub(in crate::law) fn pose(translation: [f64; 3], rotation_vector: [f64; 3]) -> Pose<CamLeft, Model> {
        Pose::from_parts(translation.into(), UnitQuaternion::from_scaled_axis(Vector3::from(rotation_vector)))
    }

    /// Pose of the model after the camera has moved by a small step of the twist.
    pub(in crate::law) fn moved(
        current: &Pose<CamLeft, Model>,
        twist: &Twist<CamLeft>,
        step_s: f64,
    ) -> Pose<CamLeft, Model> {
        let (v, w) = (twist.linear_m_per_s * step_s, twist.angular_rad_per_s * step_s);
        let old_from_new = Pose::<CamLeft, CamLeft>::from_parts(v, UnitQuaternion::from_scaled_axis(w));
        old_from_new.inverse() * *current
    }

    #[test]
    fn the_rows_are_the_derivatives_of_the_projection() {
        let point = Point3::new(0.07, -0.04, 0.6);
        let current = ImagePoint::of(&point).unwrap();
        let rows = current.interaction();
        for axis in 0..6 {
            let mut unit = Vector6::zeros();
            unit[axis] = 1.0;
            let twist = Twist::<CamLeft>::from_vector(&unit);
            let h = 1e-6;
            let at = |side: f64| {
                let of_point = pose([point.x, point.y, point.z], [0.0; 3]);
                ImagePoint::of(&Point3::from(moved(&of_point, &twist, side * h).translation_m())).unwrap()
            };
            let (after, before) = (at(1.0), at(-1.0));
            assert!(((after.x - before.x) / (2.0 * h) - rows[(0, axis)]).abs() < 1e-7, "axis {axis}");
            assert!(((after.y - before.y) / (2.0 * h) - rows[(1, axis)]).abs() < 1e-7, "axis {axis}");
        }
    }

    #[test]
    fn the_points_go_straight_and_the_camera_arrives() {
        let desired = pose([0.05, 0.0, 0.5], [0.0, 0.0, 0.0]);
        let mut current = pose([-0.04, 0.06, 0.8], [0.3, -0.2, 0.5]);
        let corner =
            |pose: &Pose<CamLeft, Model>| ImagePoint::of(&pose.transform_point(&Point3::new(0.06, 0.06, 0.0))).unwrap();
        let (from, to) = (corner(&current), corner(&desired));
        let mut aside: f64 = 0.0;
        for _ in 0..2000 {
            let twist = camera_twist(1.0, 0.06, &current, &desired).unwrap();
            current = moved(&current, &twist, 0.01);
            let now = corner(&current);
            let (way_x, way_y) = (to.x - from.x, to.y - from.y);
            let off = (now.x - from.x) * way_y - (now.y - from.y) * way_x;
            aside = aside.max(off.abs() / way_x.hypot(way_y));
        }
        assert!((current.inverse() * desired).log().norm() < 1e-6, "{current:?}");
        assert!(aside < 0.02, "{aside} from the straight line");
    }

    /// Chaumette's conundrum: a pure rotation about the optical axis makes the camera retreat, faster for a larger angle.
    #[test]
    fn before_a_large_turn_about_the_optical_axis_the_camera_backs_away() {
        let desired = pose([0.0, 0.0, 0.5], [0.0; 3]);
        let back = |angle: f64| {
            let twist = camera_twist(1.0, 0.06, &pose([0.0, 0.0, 0.5], [0.0, 0.0, angle]), &desired).unwrap();
            -twist.linear_m_per_s.z
        };
        // Speed of the retreat at a gain of 1/s: (1 - cos(angle)) times the depth.
        assert!((back(1.5) - 0.5 * (1.0 - 1.5_f64.cos())).abs() < 1e-9 && back(0.3) > 0.0);
    }

    #[test]
    fn an_invisible_target_gives_no_twist() {
        let desired = pose([0.0, 0.0, 0.5], [0.0; 3]);
        assert!(camera_twist(1.0, 0.06, &pose([0.0, 0.0, -0.5], [0.0; 3]), &desired).is_none());
        assert!(camera_twist(1.0, 0.06, &pose([0.0, 0.0, f64::NAN], [0.0; 3]), &desired).is_none());
        // Seen from the side, with one edge behind the camera.
        assert!(camera_twist(1.0, 0.06, &pose([0.0, 0.0, 0.05], [0.0, 1.5, 0.0]), &desired).is_none());
    }
}
