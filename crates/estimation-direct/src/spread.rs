//! The covariance of a plane as depth and tilts, and the chance that another plane is the answer.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::estimate::{PlaneEstimate, PlanePose};
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, inverse_depth_from_disparity};
use pb3dp_estimation_views::raw_view::RawView;

/// Root mean square angle between the pole of a half-sphere and normals distributed uniformly over it, `sqrt(pi - 2)`, radians:
/// upper bound of the uncertainty of a normal that faces the camera.
const ANY_NORMAL_RAD: f64 = 1.0684;

/// An estimate is tilted beyond the range if it exceeds the limit by this many standard deviations. 95 % of normal errors.
const TILT_SIGMAS: f64 = 2.0;

/// Uncertainty of a plane in `cam_left`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spread {
    /// Covariance of `(z, theta_x, theta_y)`: metres and radians.
    pub(super) covariance: Matrix3<f64>,
    pub(super) normal_sigma_rad: f64,
}

impl Spread {
    pub(super) fn of(covariance: &Matrix3<f64>, plane: &DisparityPlane, pose: &PlanePose, view: &RawView) -> Self {
        let j = view.turn * inverse_depth_from_disparity(&view.geometry, &plane.centre_px);
        let q_covariance = j * covariance * j.transpose();
        let q = pose.inverse_depth_plane;
        // z = 1 / (q . ray), theta_x = atan2(-qy, r) with r = |(qx, qz)|, theta_y = atan2(qx, qz).
        let (r2, n2) = (q.x * q.x + q.z * q.z, q.norm_squared());
        let r = r2.sqrt();
        let dz = view.ray * (-pose.z_m * pose.z_m);
        let dx = Vector3::new(q.x * q.y / r, -r, q.z * q.y / r) / n2;
        let dy = Vector3::new(q.z, 0.0, -q.x) / r2;
        let jacobian = Matrix3::from_rows(&[dz.transpose(), dx.transpose(), dy.transpose()]);
        let normal = q / q.norm();
        let across = (Matrix3::identity() - normal * normal.transpose()) / q.norm();
        let normal_sigma_rad = (across * q_covariance * across.transpose()).trace().max(0.0).sqrt().min(ANY_NORMAL_RAD);
        Self { covariance: jacobian * q_covariance * jacobian.transpose(), normal_sigma_rad }
    }

    /// Whether a tilt of `pose` exceeds a limit by more than its uncertainty.
    pub(super) fn is_tilted_beyond(&self, pose: &PlanePose, limit_rad: f64) -> bool {
        let is_beyond = |(axis, tilt_rad): (usize, f64)| {
            tilt_rad.abs() - limit_rad > TILT_SIGMAS * self.covariance[(axis + 1, axis + 1)].max(0.0).sqrt()
        };
        tilts_rad(pose).into_iter().enumerate().any(is_beyond)
    }
}

/// Rotations about x and y of a plane that faces the camera.
fn tilts_rad(pose: &PlanePose) -> [f64; 2] {
    let q = pose.inverse_depth_plane;
    [(-q.y).atan2(q.x.hypot(q.z)), q.x.atan2(q.z)]
}

/// Counts the second surface of an ambiguous region as a possible answer, as probable as its share of the region: its squared difference from
/// the answer is added to the variances. `share`: that of the answer.
pub(super) fn include_second(estimate: &mut PlaneEstimate, share: f64) {
    let (Some(first), Some(second)) = (&estimate.pose, &estimate.second_plane) else { return };
    let probability = second.share / (second.share + share).max(1e-9);
    let parameters = |pose: &PlanePose| {
        let [x_rad, y_rad] = tilts_rad(pose);
        Vector3::new(pose.z_m, x_rad, y_rad)
    };
    let apart = parameters(&second.pose) - parameters(first);
    let turn_rad = first.normal_in_cam_left.angle(&second.pose.normal_in_cam_left);
    if let Some(covariance) = &mut estimate.plane_covariance {
        *covariance += apart * apart.transpose() * probability;
        estimate.z_sigma_m = Some(covariance[(0, 0)].sqrt());
    }
    let normal_rad = |sigma: f64| sigma.hypot(turn_rad * probability.sqrt()).min(ANY_NORMAL_RAD);
    estimate.normal_sigma_rad = estimate.normal_sigma_rad.map(normal_rad);
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use pb3dp_estimation_core::estimate::SecondPlane;
    use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;
    use pb3dp_estimation_core::status::Status;
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole};

    use super::*;
    use pb3dp_estimation_views::disparity_plane::RectifiedGeometry;

    fn view() -> RawView {
        let turn = pb3dp_geometry::so3::exp(&Vector3::new(0.03, -0.06, 0.02)).to_rotation_matrix();
        RawView {
            geometry: RectifiedGeometry {
                focal_px: Vector2::new(740.0, 755.0),
                left_principal_px: Vector2::new(311.0, 252.0),
                disparity_offset_px: 12.5,
                baseline_m: 0.1,
            },
            turn: *turn.matrix(),
            ray: Vector3::new(0.12, -0.07, 1.0),
            errors: None,
        }
    }

    fn plane() -> DisparityPlane {
        DisparityPlane { centre_px: Vector2::new(380.0, 210.0), d0_px: 133.0, slope: Vector2::new(0.06, -0.04) }
    }

    /// Checks against numerical differences of the plane's parameters, not against the formula.
    #[test]
    fn the_covariance_is_that_of_small_changes() {
        let (view, plane) = (view(), plane());
        let psi = |p: &Vector3<f64>| {
            let q = view.inverse_depth_plane(&plane.with_parameters(p));
            let psi = PlaneHypothesis::from_inverse_depth_plane(&q, &view.ray).unwrap();
            Vector3::new(psi.z_m, psi.theta_x_rad, psi.theta_y_rad)
        };
        let p0 = plane.parameters();
        let steps = [1e-4, 1e-7, 1e-7];
        let jacobian = Matrix3::from_columns(&[0, 1, 2].map(|i| {
            let step = Vector3::ith(i, steps[i]);
            (psi(&(p0 + step)) - psi(&(p0 - step))) / (2.0 * steps[i])
        }));
        let root = Matrix3::new(0.05, 0.0, 0.0, 1e-4, 3e-4, 0.0, -2e-4, 1e-4, 4e-4);
        let covariance = root * root.transpose();
        let pose = view.pose(&plane).unwrap();
        let spread = Spread::of(&covariance, &plane, &pose, &view);
        let expected = jacobian * covariance * jacobian.transpose();
        for i in 0..3 {
            for j in 0..3 {
                let scale = (expected[(i, i)] * expected[(j, j)]).sqrt();
                assert!((spread.covariance[(i, j)] - expected[(i, j)]).abs() < 1e-4 * scale, "{i} {j}");
            }
        }
        // A rotation by theta_y moves the normal by cos theta_x of it.
        let cosine = psi(&p0).y.cos();
        let sum = expected[(1, 1)] + cosine * cosine * expected[(2, 2)];
        assert!((spread.normal_sigma_rad - sum.sqrt()).abs() < 1e-4 * sum.sqrt());
    }

    #[test]
    fn no_normal_is_known_worse_than_one_that_may_be_any() {
        let (view, plane) = (view(), plane());
        let pose = view.pose(&plane).unwrap();
        let sigma = |scale: f64| Spread::of(&(Matrix3::identity() * scale), &plane, &pose, &view).normal_sigma_rad;
        assert!(sigma(1e-8) < 0.01 && sigma(1.0) == ANY_NORMAL_RAD, "{} {}", sigma(1e-8), sigma(1.0));
        // Simpson's rule over the squared angle, weighted by the ring of normals at that angle.
        let value = |i: usize| {
            (std::f64::consts::FRAC_PI_2 * i as f64 / 1000.0).powi(2)
                * (std::f64::consts::FRAC_PI_2 * i as f64 / 1000.0).sin()
        };
        let inner: f64 = (1..1000).map(|i| value(i) * if i % 2 == 1 { 4.0 } else { 2.0 }).sum();
        let mean = (value(0) + inner + value(1000)) * std::f64::consts::FRAC_PI_2 / 3000.0;
        assert!((mean.sqrt() - ANY_NORMAL_RAD).abs() < 1e-4, "{}", mean.sqrt());
    }

    /// Depths of 0.8 and 1.2 m, of which the second is true in 3 of 8 cases: the mean square error of the first answer.
    #[test]
    fn an_ambiguous_answer_contains_the_second_surface() {
        let pinhole = Pinhole { fx: 740.0, fy: 755.0, cx: 311.0, cy: 252.0 };
        let camera = Camera::new(ImageSize { width: 640, height: 480 }, pinhole, Distortion::None).unwrap();
        let pose = |q: Vector3<f64>| PlanePose::from_inverse_depth_plane(q, &Vector3::z()).unwrap();
        let (first, second) = (pose(Vector3::new(0.1, -0.2, 1.0 / 0.8)), pose(Vector3::new(-0.05, 0.1, 1.0 / 1.2)));
        let angle_rad = first.normal_in_cam_left.angle(&second.normal_in_cam_left);
        let mut estimate = PlaneEstimate {
            pose: Some(first),
            second_plane: Some(SecondPlane { pose: second, share: 0.3 }),
            z_sigma_m: Some(0.001),
            normal_sigma_rad: Some(0.02),
            plane_covariance: Some(Matrix3::from_diagonal(&Vector3::new(1e-6, 2e-4, 2e-4))),
            ..PlaneEstimate::without_pose(Status::Ambiguous, String::new(), Vector2::zeros(), camera)
        };
        include_second(&mut estimate, 0.5);
        let z_m = estimate.z_sigma_m.unwrap();
        assert!((z_m - (1e-6_f64 + 0.375 * 0.4 * 0.4).sqrt()).abs() < 1e-12, "{z_m}");
        let normal_rad = estimate.normal_sigma_rad.unwrap();
        assert!((normal_rad - (0.0004 + 0.375 * angle_rad * angle_rad).sqrt()).abs() < 1e-12, "{normal_rad}");
        let covariance = estimate.plane_covariance.unwrap();
        assert!(covariance[(0, 1)] != 0.0 && (covariance - covariance.transpose()).norm() < 1e-15);

        let alone = PlaneEstimate { second_plane: None, ..estimate.clone() };
        let mut same = alone.clone();
        include_second(&mut same, 0.5);
        assert_eq!(same, alone);
    }
}
