//! The folder of `--overlay`.

use std::path::Path;

use anyhow::{Context, Result, bail};

/// Creates the folder of `--overlay`.
///
/// # Errors
/// If it cannot be created.
pub fn make_overlay_folder(folder: &Path) -> Result<()> {
    if folder.exists() && !folder.is_dir() {
        bail!("--overlay {}: is not a folder; name one, it is created if necessary", folder.display());
    }
    std::fs::create_dir_all(folder).with_context(|| format!("--overlay {}: cannot be created", folder.display()))
}

/// Logs where the images are.
pub fn report_overlay_folder(folder: &Path, images: usize) {
    tracing::info!("{images} overlay images: {}", folder.display());
}
