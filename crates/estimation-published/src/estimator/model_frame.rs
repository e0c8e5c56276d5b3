//! Axes of the model frame, and their propagation while the rotation about the normal is not observed.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// `cam_left_from_model` in the first frame: z along the plane's normal away from the camera, x the image's x axis projected
/// into the plane, y completes the right-handed frame.
pub(super) fn first_rotation(normal_away: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = normal_away.normalize();
    // The image's x axis is along the normal only for a plane seen edge-on, which no search range contains.
    let along = Vector3::x() - z * z.x;
    let x = if along.norm_squared() > 1e-12 { along.normalize() } else { Vector3::y().cross(&z).normalize() };
    let y = z.cross(&x);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z])))
}

/// The reference rotation, rotated by the smallest rotation that aligns its z axis with `normal_away`. Of all rotations with
/// that normal it is the smallest change, so it implies nothing about the rotation about the normal.
pub(super) fn with_normal(reference: &UnitQuaternion<f64>, normal_away: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = reference * Vector3::z();
    // The quaternion (1 + cos a, sin a axis) is 2 cos(a / 2) times that of the rotation by a; no angle is needed.
    let doubled = Quaternion::from_parts(1.0 + z.dot(normal_away), z.cross(normal_away));
    // For an inverted normal the axis is undefined; no search range contains it.
    let turn = UnitQuaternion::try_new(doubled, 1e-6).unwrap_or_default();
    let mut turned = turn * reference;
    turned.renormalize();
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_frame_follows_its_definition() {
        let normal = Vector3::new(0.3, -0.2, 0.9).normalize();
        let axes = first_rotation(&normal);
        assert!((axes * Vector3::z() - normal).norm() < 1e-12);
        let x = axes * Vector3::x();
        assert!(x.dot(&normal).abs() < 1e-12 && x.x > 0.9);
        // Only the projection of the image's x axis remains in the plane.
        assert!(x.dot(&Vector3::x().cross(&normal)).abs() < 1e-12);
        assert!((axes * Vector3::y()).y > 0.0, "y points down as in the camera");
    }

    #[test]
    fn a_new_normal_turns_the_frame_least_and_the_old_one_not_at_all() {
        let reference = first_rotation(&Vector3::new(-0.25, 0.1, 0.95).normalize());
        let same = with_normal(&reference, &(reference * Vector3::z()));
        assert!(same.angle_to(&reference) < 1e-9);
        let normal = Vector3::new(0.2, 0.3, 0.9).normalize();
        let turned = with_normal(&reference, &normal);
        assert!((turned * Vector3::z() - normal).norm() < 1e-12);
        let between_normals = (reference * Vector3::z()).angle(&normal);
        assert!((turned.angle_to(&reference) - between_normals).abs() < 1e-9, "the smallest rotation");
    }
}
