//! The Cramér-Rao bound: lower bound of the covariance of a plane estimated from one pair.
//!
//! Both images have independent noise, so the difference of two pixels has twice the variance. The texture is unknown, and so
//! are gain and offset of every channel. With the gradient `g` along rows of the noise-free image, the information on `(d0, du,
//! dv)` is the sum over pixels of `g^2 m m^T / (2 sigma^2)`, `m = (1, u, v)`, minus the part lost to gain and offset.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2, Vector3};
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, RectifiedGeometry, inverse_depth_from_disparity};

/// A pixel of a noise-free channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundSample {
    /// Pixel relative to the reference point of the plane, pixels.
    pub at_px: Vector2<f64>,
    /// Value, grey levels.
    pub value: f64,
    /// Derivative along columns, grey levels per pixel.
    pub gradient: f64,
}

/// Information on `(d0, du, dv)` in one channel with independent noise of `noise_sigma` grey levels in both images; gain and
/// offset between the cameras are unknown. The information of several channels is added.
pub fn channel_information(samples: impl IntoIterator<Item = BoundSample>, noise_sigma: f64) -> Matrix3<f64> {
    let mut plane = Matrix3::zeros();
    let mut cross = Matrix3x2::zeros();
    let mut shade = Matrix2::zeros();
    for sample in samples {
        let m = Vector3::new(1.0, sample.at_px.x, sample.at_px.y) * sample.gradient;
        let s = Vector2::new(sample.value, 1.0);
        plane += m * m.transpose();
        cross += m * s.transpose();
        shade += s * s.transpose();
    }
    let taken = match shade.try_inverse() {
        Some(inverse) => cross * inverse * cross.transpose(),
        None => Matrix3::zeros(),
    };
    (plane - taken) / (2.0 * noise_sigma * noise_sigma)
}

/// Standard deviation of the disparity of one pixel, pixels: both images have independent noise of `noise_sigma` grey levels,
/// and all channels together have a root mean square gradient of `gradient` grey levels per pixel along rows.
pub fn pixel_disparity_sigma(noise_sigma: f64, gradient: f64) -> f64 {
    std::f64::consts::SQRT_2 * noise_sigma / gradient
}

/// Information on `(d0, du, dv)` at the centre of a rectangle of `size_px`, if each pixel measures its own disparity with a
/// standard deviation of `pixel_sigma_px`. This is the value of [`channel_information`] for a homogeneous texture.
pub fn rectangle_information(size_px: &Vector2<f64>, pixel_sigma_px: f64) -> Matrix3<f64> {
    let squares = size_px.component_mul(size_px) / 12.0;
    let each = size_px.product() / (pixel_sigma_px * pixel_sigma_px);
    Matrix3::from_diagonal(&(Vector3::new(1.0, squares.x, squares.y) * each))
}

/// Covariance of `(d0, du, dv)` due to a calibration error of `sigma_px` at the centre and the same error over half the
/// region's side; `half_px` are these half sides.
pub fn calibration_covariance(sigma_px: f64, half_px: &Vector2<f64>) -> Matrix3<f64> {
    let slope = |half: f64| (sigma_px / half.max(1.0)).powi(2);
    Matrix3::from_diagonal(&Vector3::new(sigma_px * sigma_px, slope(half_px.x), slope(half_px.y)))
}

/// Standard deviations of depth and normal that follow from a covariance of `(d0, du, dv)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneSigma {
    /// Standard deviation of the depth on the ray of the plane's centre, metres.
    pub depth_m: f64,
    /// Root mean square of the angle between true and estimated normal, radians.
    pub normal_rad: f64,
}

/// Depth and normal from the covariance of `(d0, du, dv)` at the plane's centre (for the bound: the inverse of the
/// information). `None` for a plane at or beyond infinity.
pub fn plane_sigma(
    covariance: &Matrix3<f64>,
    plane: &DisparityPlane,
    geometry: &RectifiedGeometry,
) -> Option<PlaneSigma> {
    let to_q = inverse_depth_from_disparity(geometry, &plane.centre_px);
    let covariance_q = to_q * covariance * to_q.transpose();
    let q = plane.inverse_depth_plane(geometry);
    let z_m = geometry.depth_m(plane.d0_px)?;
    let ray = geometry.left_ray(&plane.centre_px);
    let length = q.norm();
    let n = q / length;
    let turn = (Matrix3::identity() - n * n.transpose()) / length;
    let normal = turn * covariance_q * turn.transpose();
    let sigma = PlaneSigma {
        depth_m: z_m * z_m * (ray.dot(&(covariance_q * ray))).max(0.0).sqrt(),
        normal_rad: normal.trace().max(0.0).sqrt(),
    };
    (sigma.depth_m.is_finite() && sigma.normal_rad.is_finite()).then_some(sigma)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> RectifiedGeometry {
        RectifiedGeometry {
            focal_px: Vector2::new(740.0, 755.0),
            left_principal_px: Vector2::new(318.0, 243.0),
            disparity_offset_px: -4.0,
            baseline_m: 0.1,
        }
    }

    /// A sine along columns of period `2 pi / k`, amplitude `a`: the mean squared gradient is `a^2 k^2 / 2`, and the mean of
    /// gradient times value is zero.
    #[test]
    fn a_sine_gives_what_the_closed_form_says() {
        let (a, k, sigma) = (20.0, 0.5, 3.0);
        let samples = (-60..=60).flat_map(|v| (-63..=63).map(move |u| (f64::from(u), f64::from(v))));
        let information = channel_information(
            samples.map(|(u, v)| BoundSample {
                at_px: Vector2::new(u, v),
                value: 90.0 + a * (k * u + 0.3).sin(),
                gradient: a * k * (k * u + 0.3).cos(),
            }),
            sigma,
        );
        let count = 127.0 * 121.0;
        let expected = count * a * a * k * k / 2.0 / (2.0 * sigma * sigma);
        assert!((information[(0, 0)] / expected - 1.0).abs() < 0.02);
        let rows = (121.0_f64.powi(2) - 1.0) / 12.0;
        assert!((information[(2, 2)] / (expected * rows) - 1.0).abs() < 0.02);
        assert!(information[(0, 2)].abs() < 1e-6 * information[(2, 2)]);

        let pixel_sigma = pixel_disparity_sigma(sigma, a * k / std::f64::consts::SQRT_2);
        let rectangle = rectangle_information(&Vector2::new(127.0, 121.0), pixel_sigma);
        for axis in 0..3 {
            let ratio = rectangle[(axis, axis)] / information[(axis, axis)];
            // With whole periods the agreement would be closer.
            assert!((ratio - 1.0).abs() < 0.03, "axis {axis}: {ratio}");
        }
    }

    #[test]
    fn a_ramp_cannot_be_distinguished_from_an_offset() {
        let ramp = |u: f64| BoundSample { at_px: Vector2::new(u, 0.0), value: 3.0 * u, gradient: 3.0 };
        let information = channel_information((-40..=40).map(|u| ramp(f64::from(u))), 1.0);
        assert!(information[(0, 0)].abs() < 1e-6, "{information}");
    }

    #[test]
    fn sigmas_are_those_of_moved_planes() {
        let g = geometry();
        let plane =
            DisparityPlane { centre_px: Vector2::new(250.0, 300.0), d0_px: 150.0, slope: Vector2::new(0.05, -0.03) };
        let normal = plane.normal_in_cam_left_rect(&g).unwrap();
        for (axis, step) in [(0, 0.01), (1, 1e-4), (2, 1e-4)] {
            let mut change = Vector3::zeros();
            change[axis] = step;
            let moved = plane.with_parameters(&(plane.parameters() + change));
            let sigma = plane_sigma(&(change * change.transpose()), &plane, &g).unwrap();
            let dz = (g.depth_m(moved.d0_px).unwrap() - g.depth_m(plane.d0_px).unwrap()).abs();
            assert!((sigma.depth_m - dz).abs() < 1e-3 * dz + 1e-12, "axis {axis}");
            let angle = normal.cross(&moved.normal_in_cam_left_rect(&g).unwrap()).norm();
            assert!((sigma.normal_rad - angle).abs() < 1e-2 * angle + 1e-12, "axis {axis}: {angle}");
        }
    }

    #[test]
    fn a_plane_beyond_infinity_has_no_sigma() {
        let plane = DisparityPlane { centre_px: Vector2::zeros(), d0_px: -10.0, slope: Vector2::zeros() };
        assert_eq!(plane_sigma(&Matrix3::identity(), &plane, &geometry()), None);
    }
}
