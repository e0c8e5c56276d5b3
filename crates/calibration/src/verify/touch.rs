//! Corners of the board that somebody has touched with the arm, beside where the cameras say they are.

use nalgebra::{Isometry3, Point3};
use pb3dp_geometry::StereoRig;

use super::{VerifyError, corner_in_cam_left};
use crate::fit::View;

/// A corner of the board and where it was touched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Column and row of the corner.
    pub board_corner: [u32; 2],
    /// Where the arm's tip was, in the arm's `base`, metres.
    pub in_base_m: Point3<f64>,
}

/// A touched corner as the cameras see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchResult {
    /// What was touched.
    pub touch: Touch,
    /// Where the cameras say it is, in `base`, metres: the mean of all stops.
    pub seen_in_base_m: Point3<f64>,
    /// Root mean square of the stops around that mean, metres.
    pub scatter_m: f64,
    /// Stops at which both cameras saw it.
    pub stops: usize,
}

impl TouchResult {
    /// How far both are apart, metres.
    pub fn error_m(&self) -> f64 {
        (self.seen_in_base_m - self.touch.in_base_m).norm()
    }
}

/// Where touched corners are by the cameras; `base_from_cam_left` is that of each view, from hand-eye calibration and arm.
///
/// # Errors
/// A corner that no view shows.
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
    let seen = views.iter().zip(base_from_cam_left).filter_map(|(view, base_from_cam_left)| {
        Some(base_from_cam_left * corner_in_cam_left(rig, view, touch.board_corner)?)
    });
    let seen: Vec<Point3<f64>> = seen.collect();
    if seen.is_empty() {
        return Err(VerifyError::Corner { column, row });
    }
    let count = seen.len() as f64;
    let mean = Point3::from(seen.iter().map(|point| point.coords).sum::<nalgebra::Vector3<f64>>() / count);
    let scatter_m = (seen.iter().map(|point| (point - mean).norm_squared()).sum::<f64>() / count).sqrt();
    Ok(TouchResult { touch, seen_in_base_m: mean, scatter_m, stops: seen.len() })
}
