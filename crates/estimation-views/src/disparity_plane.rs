//! A plane in a rectified pair: the disparity is an affine function of the left pixel.

use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_geometry::StereoRig;

/// Geometry of the rectified pair, for the conversion between disparity and depth.
///
/// Rays are those of the rectified left camera, third component 1; pixels are rectified pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectifiedGeometry {
    /// Focal lengths of both cameras, pixels.
    pub focal_px: Vector2<f64>,
    /// Principal point of the left camera, pixels.
    pub left_principal_px: Vector2<f64>,
    /// Column of the right camera's principal point minus that of the left camera, pixels. Added to a disparity it gives `fx B
    /// / z`.
    pub disparity_offset_px: f64,
    /// Baseline, metres.
    pub baseline_m: f64,
}

impl RectifiedGeometry {
    /// The geometry of a rectified rig; meaningless for any other rig.
    pub fn of_rectified(rig: &StereoRig) -> Self {
        let (left, right) = (rig.left().pinhole(), rig.right().pinhole());
        Self {
            focal_px: Vector2::new(left.fx, left.fy),
            left_principal_px: Vector2::new(left.cx, left.cy),
            disparity_offset_px: right.cx - left.cx,
            baseline_m: rig.baseline_m(),
        }
    }

    /// Focal length times baseline: disparity (offset included) times depth, pixel metres.
    #[inline]
    pub fn focal_baseline_px_m(&self) -> f64 {
        self.focal_px.x * self.baseline_m
    }

    /// Disparity of a depth, pixels: column in the left image minus column in the right one.
    #[inline]
    pub fn disparity_px(&self, z_m: f64) -> f64 {
        self.focal_baseline_px_m() / z_m - self.disparity_offset_px
    }

    /// Depth of a disparity, metres; `None` at and beyond infinity.
    #[inline]
    pub fn depth_m(&self, disparity_px: f64) -> Option<f64> {
        let full = disparity_px + self.disparity_offset_px;
        (full > 0.0).then(|| self.focal_baseline_px_m() / full)
    }

    /// Ray of a left pixel, third component 1.
    #[inline]
    pub fn left_ray(&self, pixel: &Vector2<f64>) -> Vector3<f64> {
        (pixel - self.left_principal_px).component_div(&self.focal_px).push(1.0)
    }
}

/// Range of searched disparities, in rectified pixels of the full image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisparityRange {
    /// Disparity of the farthest depth.
    pub lowest: f64,
    /// Disparity of the nearest depth.
    pub highest: f64,
}

/// Disparity `d(u, v) = d0 + du (u - u0) + dv (v - v0)` in rectified pixels of the full image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisparityPlane {
    /// `(u0, v0)`: reference pixel of `d0` in the left image.
    pub centre_px: Vector2<f64>,
    /// Disparity at the centre, pixels: left column minus right column.
    pub d0_px: f64,
    /// Slope along columns and rows, pixels per pixel.
    pub slope: Vector2<f64>,
}

impl DisparityPlane {
    /// Disparity at a left pixel, pixels.
    #[inline]
    pub fn at(&self, pixel: &Vector2<f64>) -> f64 {
        self.d0_px + self.slope.dot(&(pixel - self.centre_px))
    }

    /// The same plane with another reference pixel.
    #[inline]
    pub fn centred_at(&self, centre_px: Vector2<f64>) -> Self {
        Self { centre_px, d0_px: self.at(&centre_px), slope: self.slope }
    }

    /// `(d0, du, dv)`.
    #[inline]
    pub fn parameters(&self) -> Vector3<f64> {
        Vector3::new(self.d0_px, self.slope.x, self.slope.y)
    }

    /// The plane with other parameters `(d0, du, dv)` at the same centre.
    #[inline]
    pub fn with_parameters(&self, p: &Vector3<f64>) -> Self {
        Self { centre_px: self.centre_px, d0_px: p.x, slope: Vector2::new(p.y, p.z) }
    }

    /// The inverse-depth plane in the rectified left camera, 1/m: `q . ray` is the inverse depth.
    #[inline]
    pub fn inverse_depth_plane(&self, geometry: &RectifiedGeometry) -> Vector3<f64> {
        inverse_depth_from_disparity(geometry, &self.centre_px) * self.parameters()
            + Vector3::new(0.0, 0.0, geometry.disparity_offset_px / geometry.focal_baseline_px_m())
    }

    /// The disparity plane of an inverse-depth plane of the rectified left camera.
    pub fn from_inverse_depth_plane(q: &Vector3<f64>, geometry: &RectifiedGeometry, centre_px: Vector2<f64>) -> Self {
        let full = q * geometry.focal_baseline_px_m();
        Self {
            centre_px,
            d0_px: full.dot(&geometry.left_ray(&centre_px)) - geometry.disparity_offset_px,
            slope: full.xy().component_div(&geometry.focal_px),
        }
    }

    /// Unit normal in the rectified left camera, towards the camera; `None` for a plane through the optical centre.
    pub fn normal_in_cam_left_rect(&self, geometry: &RectifiedGeometry) -> Option<Vector3<f64>> {
        let q = self.inverse_depth_plane(geometry);
        let length = q.norm();
        (length.is_finite() && length > 0.0).then(|| -q / length)
    }
}

/// The linear part of the map from `(d0, du, dv)` at `centre_px` to the inverse-depth plane, 1/m; used to propagate
/// covariances.
#[inline]
pub fn inverse_depth_from_disparity(geometry: &RectifiedGeometry, centre_px: &Vector2<f64>) -> Matrix3<f64> {
    let (f, c) = (geometry.focal_px, geometry.left_principal_px - centre_px);
    Matrix3::new(0.0, f.x, 0.0, 0.0, 0.0, f.y, 1.0, c.x, c.y) / geometry.focal_baseline_px_m()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> RectifiedGeometry {
        RectifiedGeometry {
            focal_px: Vector2::new(740.0, 755.0),
            left_principal_px: Vector2::new(311.0, 252.0),
            disparity_offset_px: 12.5,
            baseline_m: 0.1,
        }
    }

    /// A point of a plane, projected into both cameras by hand.
    #[test]
    fn disparity_agrees_with_projected_points() {
        let g = geometry();
        let (normal, distance_m) = (Vector3::new(0.3, -0.2, 0.93).normalize(), 0.55);
        let q = normal / distance_m;
        let plane = DisparityPlane::from_inverse_depth_plane(&q, &g, Vector2::new(290.0, 201.0));
        for pixel in [Vector2::new(100.0, 80.0), Vector2::new(420.5, 333.0)] {
            let ray = g.left_ray(&pixel);
            let point = ray * (distance_m / normal.dot(&ray));
            let right_column = g.focal_px.x * (point.x - g.baseline_m) / point.z + g.left_principal_px.x + 12.5;
            assert!((plane.at(&pixel) - (pixel.x - right_column)).abs() < 1e-9);
            let z_m = g.depth_m(plane.at(&pixel)).unwrap();
            assert!((z_m - point.z).abs() < 1e-12 && (g.disparity_px(z_m) - plane.at(&pixel)).abs() < 1e-9);
        }
        assert!((plane.inverse_depth_plane(&g) - q).norm() < 1e-12);
        assert!((plane.normal_in_cam_left_rect(&g).unwrap() + normal).norm() < 1e-12);
        let moved = plane.centred_at(Vector2::new(3.0, 400.0));
        assert!((moved.inverse_depth_plane(&g) - q).norm() < 1e-12);
        assert_eq!(plane.with_parameters(&plane.parameters()), plane);
    }

    #[test]
    fn there_is_no_depth_beyond_infinity() {
        assert_eq!(geometry().depth_m(-12.5), None);
        assert_eq!(geometry().depth_m(-20.0), None);
    }
}
