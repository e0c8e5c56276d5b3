//! Directions of the model frame that a single pair determines.
//!
//! The region is the model: its centroid fixes the shifts in the plane, and the image rows fix the rotation about the normal, also on a
//! disc or on stripes. Only the depth and the two tilts come from the right image.

use pb3dp_estimation_core::estimate::{PlaneEstimate, SHIFT_SIGMA_SURE};
use pb3dp_estimation_core::status::Status;

/// Sets [`PlaneEstimate::observed`]. A depth that is not determined makes the estimate `weak-depth`, and `ambiguous` if its deviation is
/// unknown; a tilt that is not determined has made it `weak-tilt` before.
pub(super) fn tell(estimate: &mut PlaneEstimate, tilt_sigma_max_deg: f64) {
    let frame = estimate.model_frame(&estimate.centroid_px);
    let Some((frame, covariance)) = frame.and_then(|frame| Some((frame, frame.covariance?))) else { return };
    let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
    let distance_m = frame.cam_left_from_model.translation_m().norm();
    let z_sigma_max_m = SHIFT_SIGMA_SURE * distance_m;
    if estimate.status.depth_is_sure() && estimate.z_sigma_m.is_none_or(|sigma_m| sigma_m > z_sigma_max_m) {
        let (status, deviation) = match estimate.z_sigma_m {
            Some(sigma_m) => (Status::WeakDepth, format!("a standard deviation of {:.1} mm", 1e3 * sigma_m)),
            None => (Status::Ambiguous, "an unknown standard deviation".to_owned()),
        };
        estimate.status = status;
        estimate.reason.push_str(&format!(
            "; the depth has {deviation} (limit {:.1} mm): move the cameras nearer or apart, or mark a larger region",
            1e3 * z_sigma_max_m
        ));
    }
    let is_tilt = |axis: usize| sigma(axis) <= tilt_sigma_max_deg.to_radians();
    estimate.observed = Some([true, true, estimate.status.depth_is_sure(), is_tilt(3), is_tilt(4), true]);
}
