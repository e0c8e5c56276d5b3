//! Board corners touched with the arm, compared with the positions computed from the cameras.

use nalgebra::{Isometry3, Point3};
use pb3dp_geometry::StereoRig;

use super::{VerifyError, corner_in_cam_left};
use crate::fit::View;

/// A board corner and the position at which it was touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Column and row of the corner.
    pub board_corner: [u32; 2],
    /// Position of the tool tip in the arm's `base`, metres.
    pub in_base_m: Point3<f64>,
}

/// A touched corner with its position computed from the cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchResult {
    /// The touched corner.
    pub touch: Touch,
    /// Position computed from the cameras, in `base`, metres: the mean of all stops.
    pub measured_in_base_m: Point3<f64>,
    /// Root mean square scatter of the stops, metres.
    pub scatter_m: f64,
    /// Stops at which both cameras saw the corner.
    pub stops: usize,
}

impl TouchResult {
    /// Distance between both positions, metres.
    pub fn error_m(&self) -> f64 {
        (self.measured_in_base_m - self.touch.in_base_m).norm()
    }
}

/// Positions of touched corners computed from the cameras; `base_from_cam_left` is the camera pose of each view, from the
/// hand-eye calibration and the arm.
///
/// # Errors
/// No view shows a corner.
pub fn touched(
    rig: &StereoRig,
    views: &[View<2>],
    base_from_cam_left: &[Isometry3<f64>],
    touches: &[Touch],
) -> Result<Vec<TouchResult>, VerifyError> {
    touches.iter().map(|touch| touched_one(rig, views, base_from_cam_left, *touch)).collect()
}

fn touched_one(
    rig: &StereoRig,
    views: &[View<2>],
    base_from_cam_left: &[Isometry3<f64>],
    touch: Touch,
) -> Result<TouchResult, VerifyError> {
    let [column, row] = touch.board_corner;
    let positions = views.iter().zip(base_from_cam_left).filter_map(|(view, base_from_cam_left)| {
        Some(base_from_cam_left * corner_in_cam_left(rig, view, touch.board_corner)?)
    });
    let positions: Vec<Point3<f64>> = positions.collect();
    if positions.is_empty() {
        return Err(VerifyError::Corner { column, row });
    }
    let count = positions.len() as f64;
    let mean = Point3::from(positions.iter().map(|point| point.coords).sum::<nalgebra::Vector3<f64>>() / count);
    let scatter_m = (positions.iter().map(|point| (point - mean).norm_squared()).sum::<f64>() / count).sqrt();
    Ok(TouchResult { touch, measured_in_base_m: mean, scatter_m, stops: positions.len() })
}
