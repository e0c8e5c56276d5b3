//! The model frame on its plane, and its covariance derived from the covariance of the plane.

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Rotation3, Unit, UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use crate::plane_hypothesis::PlaneHypothesis;

/// Step sizes of the numerical derivatives, metres and radians. Chosen: the second-order error is below 1e-9 of the derivative.
const STEP: f64 = 1e-5;

/// The frame of a model on its plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelFrame {
    /// Pose of the model frame.
    pub cam_left_from_model: Pose<CamLeft, Model>,
    /// Covariance of `xi = (rho, phi)` in `true pose = pose * exp(xi)`, metres and radians; `None` if the method does not
    /// provide it.
    pub covariance: Option<Matrix6<f64>>,
}

/// The frame on a plane with its origin at `origin_in_cam_left` (metres), z along the normal away from the camera, and x as
/// close to the camera's x axis as the plane allows.
pub fn model_frame_on_plane(
    origin_in_cam_left: Vector3<f64>,
    normal_in_cam_left: &Vector3<f64>,
) -> Option<Pose<CamLeft, Model>> {
    let z = Unit::try_new(-normal_in_cam_left, 1e-9)?;
    let x = Unit::try_new(Vector3::x() - z.into_inner() * z.x, 1e-9)?;
    let y = z.cross(&x);
    let rotation = Matrix3::from_columns(&[x.into_inner(), y, z.into_inner()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Pose::from_parts(origin_in_cam_left, rotation))
}

/// The model frame of a hypothesis on the ray `centre_ray` (third component 1).
fn frame_of(plane: &PlaneHypothesis, centre_ray: &Vector3<f64>) -> Option<Pose<CamLeft, Model>> {
    model_frame_on_plane(centre_ray * plane.z_m, &-plane.normal())
}

/// Covariance of `xi = (rho, phi)` in `true pose = pose * exp(xi)` (metres and radians, axes of the model), propagated from the
/// covariance of `(z, theta_x, theta_y)` of its plane: `J C J^T` with the derivatives of the frame.
///
/// Its rank is 3: by definition the origin is on its ray and x is along the image rows, so neither contributes uncertainty.
pub fn frame_covariance(
    plane: &PlaneHypothesis,
    centre_ray: &Vector3<f64>,
    plane_covariance: &Matrix3<f64>,
) -> Option<Matrix6<f64>> {
    let pose_from_cam = frame_of(plane, centre_ray)?.inverse();
    let mut jacobian = Matrix6x3::zeros();
    for column in 0..3 {
        let moved = |sign: f64| {
            let mut step = Vector3::zeros();
            step[column] = sign * STEP;
            let moved = PlaneHypothesis {
                z_m: plane.z_m + step.x,
                theta_x_rad: plane.theta_x_rad + step.y,
                theta_y_rad: plane.theta_y_rad + step.z,
            };
            Some((pose_from_cam * frame_of(&moved, centre_ray)?).log())
        };
        jacobian.set_column(column, &((moved(1.0)? - moved(-1.0)?) / (2.0 * STEP)));
    }
    Some(jacobian * plane_covariance * jacobian.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_lies_in_the_plane_and_looks_away() {
        let normal = Vector3::new(0.3, -0.2, -0.9).normalize();
        let pose = model_frame_on_plane(Vector3::new(0.1, 0.2, 0.6), &normal).unwrap();
        assert!((pose.transform_vector(&Vector3::z()) + normal).norm() < 1e-12);
        let x = pose.transform_vector(&Vector3::x());
        assert!(x.dot(&normal).abs() < 1e-12 && x.x > 0.9);
        assert!((pose.rotation_matrix().determinant() - 1.0).abs() < 1e-12);
        assert!(model_frame_on_plane(Vector3::zeros(), &Vector3::x()).is_none(), "seen edge-on: no frame");
    }

    /// The frames of randomly drawn planes have the stated covariance.
    #[test]
    fn the_covariance_is_that_of_drawn_planes() {
        let plane = PlaneHypothesis { z_m: 0.52, theta_x_rad: 0.31, theta_y_rad: -0.42 };
        let ray = Vector3::new(0.21, -0.13, 1.0);
        let root = Matrix3::new(4e-4, 0.0, 0.0, -2e-4, 3e-3, 0.0, 1e-4, 1e-3, 2e-3);
        let stated = frame_covariance(&plane, &ray, &(root * root.transpose())).unwrap();
        let pose_from_cam = frame_of(&plane, &ray).unwrap().inverse();
        let (mut random, mut found) = (crate::rng::SplitMix64::new(7), Matrix6::zeros());
        let count = 20_000;
        for _ in 0..count {
            let step = root * Vector3::from_fn(|_, _| random.normal());
            let drawn = PlaneHypothesis {
                z_m: plane.z_m + step.x,
                theta_x_rad: plane.theta_x_rad + step.y,
                theta_y_rad: plane.theta_y_rad + step.z,
            };
            let xi = (pose_from_cam * frame_of(&drawn, &ray).unwrap()).log();
            found += xi * xi.transpose() / f64::from(count);
        }
        let scale = stated.diagonal().map(|variance| variance.sqrt().max(1e-7));
        let off = (found - stated).zip_map(&(scale * scale.transpose()), |off, scale| off / scale);
        assert!(off.amax() < 0.05, "{off}");
        assert!(stated.symmetric_eigenvalues().iter().filter(|value| **value > 1e-12).count() == 3);
    }
}
