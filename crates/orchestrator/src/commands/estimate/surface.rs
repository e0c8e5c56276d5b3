//! The visible surface of a region as a PLY file.

use std::path::Path;

use anyhow::Result;
use pb3dp_cell::result_lines::SurfaceLine;
use pb3dp_estimation::estimator::VisiblePoint;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_geometry::frames::CamLeft;
use pb3dp_record::point_cloud::{SurfacePoint, write_ply};

/// Writes the points in `cam_left`, and tells what they are worth.
///
/// # Errors
/// If the file cannot be written.
pub fn write(file: &Path, visible: &[VisiblePoint]) -> Result<SurfaceLine> {
    let measured = visible.iter().filter(|point| point.is_measured).count();
    let point = |point: &VisiblePoint| SurfacePoint {
        position_m: point.position_in_cam_left_m,
        normal: None,
        sigma_m: point.sigma_m,
        rgb: point.rgb,
        is_measured: point.is_measured,
    };
    let points: Vec<SurfacePoint> = visible.iter().map(point).collect();
    write_ply::<CamLeft>(file, &points)?;
    let mut sigmas_mm: Vec<f64> = visible.iter().map(|point| 1e3 * point.sigma_m).collect();
    let middle = sigmas_mm.len() / 2;
    let sigma_median_mm = *sigmas_mm.select_nth_unstable_by(middle, f64::total_cmp).1;
    tracing::info!(
        "{}: {} points of the visible surface, {:.0} % of them with a match of their own, standard deviation {sigma_median_mm:.2} mm (median of all); \
         the status is that of the plane",
        file.display(),
        points.len(),
        100.0 * measured as f64 / points.len() as f64
    );
    Ok(SurfaceLine { file: file.display().to_string(), points: points.len(), measured, sigma_median_mm })
}

/// Why a surface was not written. With a pose that is sure, calibration and images are right: only the range can be closer to the object.
pub fn not_written(file: &Path, error: &EstimationError, estimate: &PlaneEstimate) -> String {
    let sure = estimate.pose.filter(|_| estimate.status.depth_is_sure());
    let why = match (error, sure) {
        (EstimationError::NoSurface { matched_percent, needed_percent }, Some(pose)) => format!(
            "{matched_percent:.0} % of the region's pixels have a match in the right image, a surface needs {needed_percent:.0} %: give the \
             depth range of the object, which is about {:.0} mm away (--z-range), or mark a part with more texture",
            1e3 * pose.z_m
        ),
        _ => error.to_string(),
    };
    format!("--surface {}: not written: {why}", file.display())
}
