//! The recovered surfaces as PLY files.

use std::path::Path;

use anyhow::Result;
use pb3dp_estimation::estimator;
use pb3dp_geometry::frames::Model;
use pb3dp_record::point_cloud::{SurfacePoint, write_ply};

use super::walk::TrackedTarget;
use crate::commands::output_file::numbered;

/// Writes the surface of each target to `file`. Several targets get numbered files: `crab.ply` becomes `crab-0.ply`, `crab-1.ply`.
/// Positions and normals are in `model`, colours are from the first left image.
///
/// # Errors
/// If a file cannot be written.
pub fn write_all(file: &Path, targets: &[TrackedTarget]) -> Result<()> {
    for (index, target) in targets.iter().enumerate() {
        let file = if targets.len() > 1 { numbered(file, index) } else { file.to_path_buf() };
        let found = target.tracker().surface();
        if found.is_empty() {
            tracing::warn!("{}: not written: the target was never found, so there is no surface", file.display());
            continue;
        }
        let point = |point: &estimator::SurfacePoint| SurfacePoint {
            position_m: point.position_in_model_m,
            normal: Some(point.normal_in_model),
            sigma_m: point.sigma_m,
            rgb: point.rgb,
            is_measured: true,
        };
        let points: Vec<SurfacePoint> = found.iter().map(point).collect();
        write_ply::<Model>(&file, &points)?;
        tracing::info!("{} surface points: {}", points.len(), file.display());
    }
    Ok(())
}
