//! The visible surface of a region as a PLY file.

use std::path::Path;

use anyhow::Result;
use pb3dp_estimation::estimator::VisiblePoint;
use pb3dp_geometry::frames::CamLeft;
use pb3dp_record::point_cloud::{SurfacePoint, write_ply};

/// Writes the points in `cam_left`; none, with a warning, if the right image shows none of the depth range.
///
/// # Errors
/// If the file cannot be written.
pub fn write(file: &Path, visible: &[VisiblePoint]) -> Result<()> {
    if visible.is_empty() {
        tracing::warn!(
            "{}: not written: the right image shows no depth of the range; check --z-range and the calibration",
            file.display()
        );
        return Ok(());
    }
    let point = |point: &VisiblePoint| SurfacePoint {
        position_m: point.position_in_cam_left_m,
        normal: None,
        sigma_m: point.sigma_m,
        rgb: point.rgb,
    };
    let points: Vec<SurfacePoint> = visible.iter().map(point).collect();
    write_ply::<CamLeft>(file, &points)?;
    tracing::info!("{} surface points: {}", points.len(), file.display());
    Ok(())
}
