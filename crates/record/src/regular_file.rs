//! Files that are read: regular files only, up to a size.

use std::fs::{File, FileType, Metadata};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

/// Why a path is not read although it exists.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RefusedFile {
    /// The path leads to something else than a regular file.
    #[error("it is {what}, not a regular file; copy the content into a file, and name this file")]
    NotRegular {
        /// `a named pipe (FIFO)`, for example.
        what: &'static str,
    },
    /// The file is larger than any file of its kind.
    #[error("it has {bytes} bytes, at most {max_bytes} are read; check that it is the right file")]
    TooLarge {
        /// Size of the file, or of its part that was read.
        bytes: u64,
        /// Largest size that is read.
        max_bytes: u64,
    },
}

impl RefusedFile {
    /// The refusal in an error of [`open_regular`] or [`read_regular`]; `None` if the error comes from the system.
    pub fn of(error: &Error) -> Option<&Self> {
        error.get_ref()?.downcast_ref()
    }

    fn not_regular(kind: FileType) -> Error {
        let (error, what) = match kind {
            kind if kind.is_dir() => (ErrorKind::IsADirectory, "a folder"),
            kind if kind.is_fifo() => (ErrorKind::InvalidInput, "a named pipe (FIFO)"),
            kind if kind.is_socket() => (ErrorKind::InvalidInput, "a socket"),
            _ => (ErrorKind::InvalidInput, "a device"),
        };
        Error::new(error, Self::NotRegular { what })
    }
}

/// Opens a regular file for reading; links are followed. A named pipe would block the program, and a device may never end.
///
/// # Errors
/// Those of the system, and [`RefusedFile::NotRegular`].
pub fn open_regular(file: &Path) -> Result<File> {
    Ok(open(file)?.0)
}

/// Reads a regular file of at most `max_bytes` bytes.
///
/// # Errors
/// Those of the system, and [`RefusedFile`].
pub fn read_regular(file: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let (opened, found) = open(file)?;
    let too_large = |bytes| Error::new(ErrorKind::FileTooLarge, RefusedFile::TooLarge { bytes, max_bytes });
    if found.len() > max_bytes {
        return Err(too_large(found.len()));
    }
    let mut content = Vec::with_capacity(usize::try_from(found.len()).unwrap_or(0));
    // The file may grow meanwhile, and files of /proc state no size.
    opened.take(max_bytes.saturating_add(1)).read_to_end(&mut content)?;
    if content.len() as u64 > max_bytes {
        return Err(too_large(content.len() as u64));
    }
    Ok(content)
}

/// The open file is examined: the path may lead elsewhere a moment later.
fn open(file: &Path) -> Result<(File, Metadata)> {
    // Without NONBLOCK, opening a pipe waits for its writer. A terminal must not become that of the program.
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits().cast_signed();
    let opened = File::options().read(true).custom_flags(flags).open(file);
    let opened = opened.map_err(|error| match std::fs::metadata(file) {
        // A socket cannot be opened.
        Ok(found) if !found.is_file() => RefusedFile::not_regular(found.file_type()),
        _ => error,
    })?;
    let found = opened.metadata()?;
    match found.is_file() {
        true => Ok((opened, found)),
        false => Err(RefusedFile::not_regular(found.file_type())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, Mode, mkfifoat};

    #[test]
    fn only_regular_files_are_opened_and_nothing_blocks() {
        let folder = tempfile::tempdir().unwrap();
        let [pipe, socket, device, link, text] =
            ["pipe", "socket", "device", "link", "text"].map(|name| folder.path().join(name));
        mkfifoat(CWD, &pipe, Mode::RUSR).unwrap();
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &device).unwrap();
        std::fs::write(&text, "text").unwrap();
        std::os::unix::fs::symlink(&text, &link).unwrap();
        let refused = |file: &Path| RefusedFile::of(&open_regular(file).unwrap_err()).unwrap().to_string();
        for (file, what) in [
            (&pipe, "it is a named pipe (FIFO), not a regular file; copy"),
            (&socket, "it is a socket, not a regular file"),
            (&device, "it is a device, not a regular file"),
            (&folder.path().to_path_buf(), "it is a folder, not a regular file"),
        ] {
            assert!(refused(file).contains(what), "{}", refused(file));
        }
        assert_eq!(read_regular(&link, 4).unwrap(), b"text");
        let missing = open_regular(&folder.path().join("none")).unwrap_err();
        assert_eq!((missing.kind(), RefusedFile::of(&missing)), (ErrorKind::NotFound, None));
    }

    #[test]
    fn a_file_that_is_too_large_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("sparse");
        File::create(&file).unwrap().set_len(1 << 40).unwrap();
        let error = read_regular(&file, 1 << 20).unwrap_err();
        assert_eq!(
            error.to_string(),
            "it has 1099511627776 bytes, at most 1048576 are read; check that it is the right file"
        );
    }
}
