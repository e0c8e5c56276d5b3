//! Files that a command writes.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

/// Creates the folder of the file of an option, and checks before the work starts that the file can be written.
///
/// # Errors
/// If it cannot.
pub fn check_writable(option: &str, file: &Path) -> Result<()> {
    let refused = || format!("{option} {}: cannot be written", file.display());
    if is_folder(file) {
        bail!("{option} {}: is a folder: give the name of a file", file.display());
    }
    std::fs::create_dir_all(file.parent().unwrap_or(Path::new(""))).with_context(refused)?;
    let existed = file.exists();
    std::fs::OpenOptions::new().append(true).create(true).open(file).with_context(refused)?;
    if !existed {
        std::fs::remove_file(file).with_context(refused)?;
    }
    Ok(())
}

/// As [`check_writable`], for a cloud of points.
///
/// # Errors
/// Also if the name does not end with `.ply`.
pub fn check_cloud(option: &str, file: &Path) -> Result<()> {
    let is_cloud = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ply"));
    if !is_cloud && !is_folder(file) {
        bail!("{option} {}: clouds are written as PLY: let the name end with .ply", file.display());
    }
    check_writable(option, file)
}

/// Endings of files that nobody gives to a folder: slips of `mcap`, and other formats.
const NO_FOLDERS: [&str; 16] = [
    "mcp", "cap", "map", "mca", "macp", "mcpa", "mcapp", "mmcap", "bag", "db3", "zip", "tar", "json", "csv", "avi",
    "mp4",
];

/// Refuses the name of a recording that would be a folder, but looks like a file.
///
/// # Errors
/// As said.
pub fn check_recording_name(option: &str, path: &Path) -> Result<()> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if NO_FOLDERS.contains(&ending.as_str()) && !is_folder(path) {
        bail!(
            "{option} {}: a recording is one file with the ending .mcap, or a folder; use {}, or a name without .{ending}",
            path.display(),
            path.with_extension("mcap").display()
        );
    }
    Ok(())
}

/// Whether it is a folder, or looks like one.
fn is_folder(file: &Path) -> bool {
    file.is_dir() || file.as_os_str().as_encoded_bytes().ends_with(b"/")
}

/// Whether both paths are one file that exists.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// `crab.ply` with a number: `crab-1.ply`.
pub fn numbered(file: &Path, index: usize) -> PathBuf {
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
