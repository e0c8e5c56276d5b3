//! Copying, writing and removing files, with errors that name them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

/// Creates a folder, and those above it.
///
/// # Errors
/// If it cannot be created.
pub fn create_folder(folder: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))
}

/// Removes a folder with its content, if it exists.
///
/// # Errors
/// If it cannot be removed.
pub fn remove_folder(folder: &Path) -> anyhow::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", folder.display()))
        }
        _ => Ok(()),
    }
}

/// Copies a file with its permissions, and creates its folder.
///
/// # Errors
/// If it cannot be read or written.
pub fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    to.parent().map_or(Ok(()), create_folder)?;
    fs::copy(from, to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}

/// Copies a folder with its content.
///
/// # Errors
/// If a file cannot be read or written.
pub fn copy_folder(from: &Path, to: &Path) -> anyhow::Result<()> {
    for entry in fs::read_dir(from).with_context(|| format!("cannot list {}", from.display()))? {
        let path = entry?.path();
        let Some(name) = path.file_name() else { bail!("{} has no name", path.display()) };
        if path.is_dir() { copy_folder(&path, &to.join(name))? } else { copy(&path, &to.join(name))? }
    }
    Ok(())
}

/// Writes a file, and creates its folder.
///
/// # Errors
/// If it cannot be written.
pub fn write(file: &Path, text: &str) -> anyhow::Result<()> {
    file.parent().map_or(Ok(()), create_folder)?;
    fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))
}

/// Reads a file as text.
///
/// # Errors
/// If it cannot be read.
pub fn read(file: &Path) -> anyhow::Result<String> {
    fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))
}

/// All files below a folder, sorted.
///
/// # Errors
/// If a folder cannot be listed.
pub fn all(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() { files.extend(all(&path)?) } else { files.push(path) }
    }
    files.sort();
    Ok(files)
}
