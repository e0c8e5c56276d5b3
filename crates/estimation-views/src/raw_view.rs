//! Planes of the rectified pair, as the raw left camera sees them.

use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_estimation_core::estimate::PlanePose;
use pb3dp_estimation_core::rig_errors::{PlanePlace, RigErrors};
use pb3dp_estimation_core::row_offset::RowOffset;

use super::disparity_plane::{DisparityPlane, RectifiedGeometry};

/// Conversion of planes from the rectified pair to the raw left camera.
pub struct RawView {
    /// Geometry of the rectified pair.
    pub geometry: RectifiedGeometry,
    /// Rotation `cam_left_from_cam_left_rect`.
    pub turn: Matrix3<f64>,
    /// Ray of the region's centroid, third component 1.
    pub ray: Vector3<f64>,
    /// Known errors of the rig, which are taken out.
    pub errors: Option<RigErrors>,
}

impl RawView {
    /// The inverse-depth plane in the raw left camera, 1/m.
    pub fn inverse_depth_plane(&self, plane: &DisparityPlane) -> Vector3<f64> {
        let columns = self.errors.map_or(Vector3::zeros(), |errors| errors.of_plane(&self.place(plane)));
        self.turn * plane.with_parameters(&(plane.parameters() - columns)).inverse_depth_plane(&self.geometry)
    }

    /// The pose of a plane in the raw left camera; `None` if the plane is not in front of it on the ray of the centroid.
    pub fn pose(&self, plane: &DisparityPlane) -> Option<PlanePose> {
        PlanePose::from_inverse_depth_plane(self.inverse_depth_plane(plane), &self.ray)
    }

    /// The share of the rig's remaining errors in the covariance of a plane.
    pub fn covariance_of_errors(&self, plane: &DisparityPlane) -> Matrix3<f64> {
        self.errors.map_or(Matrix3::zeros(), |errors| errors.plane_covariance(&self.place(plane)))
    }

    /// Depth at a left pixel with this disparity, metres, as a rectified camera without errors measures it.
    pub fn depth_m(&self, at_px: &Vector2<f64>, disparity_px: f64) -> Option<f64> {
        let plane = DisparityPlane { centre_px: *at_px, d0_px: disparity_px, slope: Vector2::zeros() };
        let columns_px = self.errors.map_or(0.0, |errors| errors.of_plane(&self.place(&plane)).x);
        self.geometry.depth_m(disparity_px - columns_px)
    }

    /// Row offset of a plane in the rectified pair that the errors explain, pixels.
    pub fn row_offset_px(&self, plane: &DisparityPlane) -> f64 {
        let place = self.place(plane);
        let rows = self.errors.map_or(0.0, |errors| errors.row_offset(&place.right_ray(), place.disparity).0);
        rows * self.geometry.focal_px.y
    }

    /// The row offsets near the region, at a depth, that the errors explain.
    pub fn rows(&self, depth_m: f64) -> RowOffset {
        let geometry = &self.geometry;
        let ray = self.turn.transpose() * self.ray;
        let disparity = geometry.baseline_m / (depth_m * ray.z);
        let place = PlanePlace { ray: ray.xy() / ray.z, disparity, focal_px: geometry.focal_px };
        self.errors.map_or_else(RowOffset::default, |errors| rows_near(&errors, &place, geometry))
    }

    fn place(&self, plane: &DisparityPlane) -> PlanePlace {
        let geometry = &self.geometry;
        let disparity = (plane.d0_px + geometry.disparity_offset_px) / geometry.focal_px.x;
        PlanePlace { ray: geometry.left_ray(&plane.centre_px).xy(), disparity, focal_px: geometry.focal_px }
    }
}

/// The row offsets near a place.
pub fn rows_near(errors: &RigErrors, place: &PlanePlace, geometry: &RectifiedGeometry) -> RowOffset {
    let right = place.right_ray();
    let (offset, _) = errors.row_offset(&right, place.disparity);
    let [by_x, by_y] = errors.row_slope(&right);
    let right_principal_px = geometry.left_principal_px + Vector2::new(geometry.disparity_offset_px, 0.0);
    let [fx, fy] = [geometry.focal_px.x, geometry.focal_px.y];
    RowOffset {
        centre_px: right.component_mul(&geometry.focal_px) + right_principal_px,
        offset_px: fy * offset,
        slope: Vector2::new(by_x * fy / fx, by_y),
    }
}
