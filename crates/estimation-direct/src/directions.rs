//! Directions of the model frame that a single pair determines.
//!
//! The region is the model: its centroid fixes the shifts in the plane, and the image rows fix the rotation about the normal, also on a
//! disc or on stripes. Only the depth and the two tilts come from the right image.

use pb3dp_estimation_core::estimate::{PlaneEstimate, SHIFT_SIGMA_SURE};
use pb3dp_estimation_core::status::Status;

/// Sets [`PlaneEstimate::observed`]. A depth that is not determined makes the estimate `ambiguous`; a tilt that is not determined has
/// made it `weak-tilt` before.
pub(super) fn tell(estimate: &mut PlaneEstimate, tilt_sigma_max_deg: f64) {
    let frame = estimate.model_frame(&estimate.centroid_px);
    let Some((frame, covariance)) = frame.and_then(|frame| Some((frame, frame.covariance?))) else { return };
    let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
    let distance_m = frame.cam_left_from_model.translation_m().norm();
    let (z_sigma_m, z_sigma_max_m) = (estimate.z_sigma_m.unwrap_or(f64::INFINITY), SHIFT_SIGMA_SURE * distance_m);
    let is_precise = z_sigma_m <= z_sigma_max_m;
    if estimate.status.depth_is_sure() && !is_precise {
        estimate.status = Status::Ambiguous;
        estimate.reason.push_str(&format!(
            "; the depth has a standard deviation of {:.1} mm (limit {:.1}): move the cameras nearer or apart, or mark a larger region",
            1e3 * z_sigma_m,
            1e3 * z_sigma_max_m
        ));
    }
    let is_tilt = |axis: usize| sigma(axis) <= tilt_sigma_max_deg.to_radians();
    estimate.observed = Some([true, true, estimate.status.depth_is_sure(), is_tilt(3), is_tilt(4), true]);
}
