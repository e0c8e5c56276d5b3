//! Planes of the rectified pair, as the raw left camera sees them.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::estimate::PlanePose;

use super::disparity_plane::{DisparityPlane, RectifiedGeometry};

/// Conversion of planes from the rectified pair to the raw left camera.
pub(super) struct RawView {
    pub(super) geometry: RectifiedGeometry,
    /// Rotation `cam_left_from_cam_left_rect`.
    pub(super) turn: Matrix3<f64>,
    /// Ray of the region's centroid, third component 1.
    pub(super) ray: Vector3<f64>,
}

impl RawView {
    pub(super) fn inverse_depth_plane(&self, plane: &DisparityPlane) -> Vector3<f64> {
        self.turn * plane.inverse_depth_plane(&self.geometry)
    }

    pub(super) fn pose(&self, plane: &DisparityPlane) -> Option<PlanePose> {
        PlanePose::from_inverse_depth_plane(self.inverse_depth_plane(plane), &self.ray)
    }
}
