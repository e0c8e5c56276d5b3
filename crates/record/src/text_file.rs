//! Text files of people and programs: settings, records, descriptions.

use std::fs;
use std::io::{Error, ErrorKind, Result};
use std::path::Path;

/// Largest file that is read as a whole, bytes.
pub const TEXT_MAX_BYTES: u64 = 64 << 20;

/// Reads a regular file. A pipe or a device would block the program or never end.
///
/// # Errors
/// A file that is not regular, is larger than [`TEXT_MAX_BYTES`], cannot be read, or is not UTF-8.
pub fn read_text(file: &Path) -> Result<String> {
    check_regular(file, TEXT_MAX_BYTES)?;
    fs::read_to_string(file)
}

/// Refuses what is no regular file, or larger than this, before it is opened.
///
/// # Errors
/// The reason, or that the file cannot be found.
pub fn check_regular(file: &Path, max_bytes: u64) -> Result<()> {
    let found = fs::metadata(file)?;
    if found.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    if !found.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "it is no regular file, but a pipe, a socket or a device"));
    }
    if found.len() > max_bytes {
        let message = format!("it has {} bytes, allowed are {max_bytes}", found.len());
        return Err(Error::new(ErrorKind::FileTooLarge, message));
    }
    Ok(())
}

/// Writes a file in one piece: an interrupted write leaves the old one, and a symbolic link of this name is replaced, so that
/// nothing outside the folder changes.
///
/// # Errors
/// If the file cannot be written.
pub fn write_text(file: &Path, text: &str) -> Result<()> {
    write_whole(file, text.as_bytes())
}

/// Writes a file of any kind as [`write_text`] writes a text.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_whole(file: &Path, bytes: &[u8]) -> Result<()> {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".new");
    let new = file.with_file_name(name);
    // An interrupted write, or a link of somebody else.
    match fs::remove_file(&new) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    fs::write(&new, bytes)?;
    fs::rename(&new, file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_regular_file_is_refused_and_does_not_block() {
        let folder = tempfile::tempdir().unwrap();
        let told = |file: &Path| read_text(file).unwrap_err().to_string();
        let pipe = folder.path().join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
        assert!(told(&pipe).contains("no regular file"), "{}", told(&pipe));
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert!(told(&link).contains("no regular file"), "{}", told(&link));
        assert!(told(folder.path()).contains("directory"));
        let large = folder.path().join("large");
        fs::File::create(&large).unwrap().set_len(TEXT_MAX_BYTES + 1).unwrap();
        assert!(told(&large).contains("allowed are"), "{}", told(&large));
        write_text(&large, "text").unwrap();
        assert_eq!(read_text(&large).unwrap(), "text");
    }
    #[test]
    fn a_link_is_replaced_and_what_it_points_to_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (link, other) = (folder.path().join("report.html"), folder.path().join("other"));
        fs::write(&other, "mine").unwrap();
        std::os::unix::fs::symlink(&other, &link).unwrap();
        write_text(&link, "report").unwrap();
        assert_eq!(
            (fs::read_to_string(&other).unwrap(), fs::read_to_string(&link).unwrap()),
            ("mine".into(), "report".into())
        );
        assert!(!link.is_symlink());
    }
}
