//! The folder of `--overlay`.

use std::path::Path;

use anyhow::{Context, Result, bail};

/// Creates the folder of `--overlay`. Images that are there already are kept, and a warning tells of them.
///
/// # Errors
/// If it cannot be created.
pub fn make_overlay_folder(folder: &Path) -> Result<()> {
    if folder.exists() && !folder.is_dir() {
        bail!("--overlay {}: is not a folder; name one, it is created if necessary", folder.display());
    }
    std::fs::create_dir_all(folder).with_context(|| format!("--overlay {}: cannot be created", folder.display()))?;
    let is_image = |name: &std::ffi::OsString| name.to_string_lossy().ends_with(".png");
    let there = std::fs::read_dir(folder).into_iter().flatten().flatten().filter(|entry| is_image(&entry.file_name()));
    let count = there.count();
    if count > 0 {
        tracing::warn!(
            "--overlay {}: images of earlier calls are there ({count}); those with the names of new ones are replaced, the others stay",
            folder.display()
        );
    }
    Ok(())
}

/// Logs where the images are.
pub fn report_overlay_folder(folder: &Path, images: usize) {
    tracing::info!("{images} overlay images: {}", folder.display());
}
