//! The recovered surfaces as PLY files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use pb3dp_estimation::estimator;
use pb3dp_geometry::frames::Model;
use pb3dp_record::point_cloud::{SurfacePoint, write_ply};

use super::walk::TrackedTarget;

/// Creates the folder of `file`, and checks before the work starts that the file can be written.
///
/// # Errors
/// If it cannot.
pub fn check_writable(file: &Path) -> Result<()> {
    let refused = || format!("--surface {}: cannot be written", file.display());
    if file.is_dir() {
        bail!("--surface {}: is a folder: give the name of a file", file.display());
    }
    std::fs::create_dir_all(file.parent().unwrap_or(Path::new(""))).with_context(refused)?;
    let existed = file.exists();
    std::fs::OpenOptions::new().append(true).create(true).open(file).with_context(refused)?;
    if !existed {
        std::fs::remove_file(file).with_context(refused)?;
    }
    Ok(())
}

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
            normal: point.normal_in_model,
            rgb: point.rgb,
        };
        let points: Vec<SurfacePoint> = found.iter().map(point).collect();
        write_ply::<Model>(&file, &points)?;
        tracing::info!("{} surface points: {}", points.len(), file.display());
    }
    Ok(())
}

/// `crab.ply` with a number: `crab-1.ply`.
fn numbered(file: &Path, index: usize) -> PathBuf {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let name = match file.extension() {
        Some(ending) => format!("{stem}-{index}.{}", ending.to_string_lossy()),
        None => format!("{stem}-{index}"),
    };
    file.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_several_targets_are_numbered() {
        assert_eq!(numbered(Path::new("a/crab.ply"), 1), Path::new("a/crab-1.ply"));
        assert_eq!(numbered(Path::new("crab"), 0), Path::new("crab-0"));
    }
}
