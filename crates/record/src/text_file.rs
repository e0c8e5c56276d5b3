//! Text files of people and programs: settings, records, descriptions.

use std::fs;
use std::io::{Error, ErrorKind, Result};
use std::path::Path;

use crate::regular_file::read_regular;

/// Largest file that is read as a whole, bytes.
pub const TEXT_MAX_BYTES: u64 = 64 << 20;

/// Reads a regular file as text.
///
/// # Errors
/// A file that is not regular, is larger than [`TEXT_MAX_BYTES`], cannot be read, or is not UTF-8.
pub fn read_text(file: &Path) -> Result<String> {
    let text = String::from_utf8(read_regular(file, TEXT_MAX_BYTES)?);
    text.map_err(|_| Error::new(ErrorKind::InvalidData, "it is not text in UTF-8"))
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
    fn a_text_is_read_up_to_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let message_of = |file: &Path| read_text(file).unwrap_err().to_string();
        let large = folder.path().join("large");
        fs::File::create(&large).unwrap().set_len(TEXT_MAX_BYTES + 1).unwrap();
        assert!(message_of(&large).contains("it has 67108865 bytes, at most 67108864"), "{}", message_of(&large));
        fs::write(&large, [0xFF]).unwrap();
        assert!(message_of(&large).contains("not text"), "{}", message_of(&large));
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
