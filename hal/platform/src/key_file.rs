//! Files of secret keys: only their owner may read them, and nothing shows their contents.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Random bytes of a new key.
const NEW_KEY_BYTES: usize = 32;

/// Longest file that is read.
const FILE_BYTES_MAX: u64 = 4096;

/// Fewest distinct bytes of a key: zeros and repeated words are no keys.
const DISTINCT_MIN: usize = 8;

/// Permissions that a key file may have.
const MODES: [u32; 2] = [0o600, 0o400];

/// Why a key file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
    /// The file cannot be opened or read.
    #[error("key file {}: cannot be read", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// Others may read or change it.
    #[error("key file {}: its mode is {mode:04o}, allowed are 0600 and 0400: run `chmod 600 {}`", file.display(), file.display())]
    Mode {
        /// The file.
        file: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Another user owns it.
    #[error("key file {}: user {owner} owns it, this program runs as user {user}: run `chown {user} {}`", file.display(), file.display())]
    Owner {
        /// The file.
        file: PathBuf,
        /// Its owner.
        owner: u32,
        /// The user of this program.
        user: u32,
    },
    /// It is a folder, a pipe or a device.
    #[error("key file {}: it is not a regular file", file.display())]
    NotRegular {
        /// The file.
        file: PathBuf,
    },
    /// Its text is no key.
    #[error(
        "key file {}: it holds no key of at least {bytes_min} random bytes in hexadecimal digits: make one with `pb3dp gateway key FILE`, \
         and copy it unchanged",
        file.display()
    )]
    NoKey {
        /// The file.
        file: PathBuf,
        /// Fewest bytes of a key.
        bytes_min: usize,
    },
    /// A new key cannot be written.
    #[error("key file {}: cannot be written; an existing file is never overwritten", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The system has no random bytes.
    #[error("the operating system gives no random bytes")]
    Random(#[source] std::io::Error),
}

/// Random bytes of the operating system.
///
/// # Errors
/// If it gives none.
pub fn random_bytes<const N: usize>() -> Result<[u8; N], KeyFileError> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|error| KeyFileError::Random(std::io::Error::other(error)))?;
    Ok(bytes)
}

/// Reads the bytes of a key, in hexadecimal digits, from a file that only the user of this program may read (mode 0600 or 0400).
///
/// # Errors
/// If the file cannot be read, others can read it, or it holds no key of `bytes_min` bytes.
pub fn read_key(file: &Path, bytes_min: usize) -> Result<Vec<u8>, KeyFileError> {
    let text = read_secret(file)?;
    let key = decode(text.trim_ascii()).filter(|key| key.len() >= bytes_min && is_random(key));
    key.ok_or_else(|| KeyFileError::NoKey { file: file.to_owned(), bytes_min })
}

/// Opens a regular file for reading. A named pipe would block the program, and a device may never end.
///
/// # Errors
/// If the file cannot be opened; of the kind [`ErrorKind::InvalidInput`] if it is not a regular file.
fn open_regular(file: &Path) -> std::io::Result<File> {
    let opened = File::options().read(true).custom_flags(libc::O_NONBLOCK).open(file)?;
    // Of the open file: the name may lead elsewhere a moment later.
    match opened.metadata()?.is_file() {
        true => Ok(opened),
        false => {
            let text = "not a regular file; copy the content into a file, and name this file";
            Err(std::io::Error::new(ErrorKind::InvalidInput, text))
        }
    }
}

/// Reads the text of a secret, at most 4 KiB: the owner must be the user of this program, the mode 0600 or 0400.
///
/// # Errors
/// If the file cannot be read, or others can read it.
fn read_secret(file: &Path) -> Result<Vec<u8>, KeyFileError> {
    let read = |source: std::io::Error| match source.kind() {
        ErrorKind::InvalidInput => KeyFileError::NotRegular { file: file.to_owned() },
        _ => KeyFileError::Read { file: file.to_owned(), source },
    };
    let opened = open_regular(file).map_err(read)?;
    let found = opened.metadata().map_err(read)?;
    let (mode, owner, user) = (found.mode() & 0o7777, found.uid(), rustix::process::geteuid().as_raw());
    if owner != user {
        return Err(KeyFileError::Owner { file: file.to_owned(), owner, user });
    }
    if !MODES.contains(&mode) {
        return Err(KeyFileError::Mode { file: file.to_owned(), mode });
    }
    let mut text = Vec::new();
    opened.take(FILE_BYTES_MAX).read_to_end(&mut text).map_err(read)?;
    Ok(text)
}

/// Writes a new random key to a file that must not exist, with mode 0600.
///
/// # Errors
/// If the file exists or cannot be written.
pub fn write_new_key(file: &Path) -> Result<(), KeyFileError> {
    let key = random_bytes::<NEW_KEY_BYTES>()?;
    let text: String = key.iter().map(|byte| format!("{byte:02x}")).chain(["\n".to_owned()]).collect();
    let write = |source| KeyFileError::Write { file: file.to_owned(), source };
    let mut opened = File::options().write(true).create_new(true).mode(0o600).open(file).map_err(write)?;
    opened.write_all(text.as_bytes()).map_err(write)?;
    opened.sync_all().map_err(write)
}

/// Whether a key can be random: of 32 random bytes, fewer than [`DISTINCT_MIN`] are distinct once in 10^36 keys: C(256, 7) (7 / 256)^32.
fn is_random(key: &[u8]) -> bool {
    key.iter().collect::<BTreeSet<_>>().len() >= DISTINCT_MIN
}

fn decode(digits: &[u8]) -> Option<Vec<u8>> {
    let (pairs, rest) = digits.as_chunks::<2>();
    let digit = |byte: u8| char::from(byte).to_digit(16);
    let byte = |pair: &[u8; 2]| Some(digit(pair[0])? << 4 | digit(pair[1])?).and_then(|byte| u8::try_from(byte).ok());
    if rest.is_empty() { pairs.iter().map(byte).collect() } else { None }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "helpers of tests")]

    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_new_key_is_read_by_its_owner_alone() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("arm1.key");
        write_new_key(&file).unwrap();
        let key = read_key(&file, 32).unwrap();
        assert_eq!(key.len(), 32);
        let other = folder.path().join("arm2.key");
        write_new_key(&other).unwrap();
        assert_ne!(key, read_key(&other, 32).unwrap());
        assert!(matches!(write_new_key(&file), Err(KeyFileError::Write { .. })), "never overwritten");
        for mode in [0o644, 0o640, 0o604, 0o700, 0o4600] {
            std::fs::set_permissions(&file, Permissions::from_mode(mode)).unwrap();
            let error = read_key(&file, 32).unwrap_err().to_string();
            let path = file.display().to_string();
            for part in [path.as_str(), &format!("mode is {mode:04o}"), "allowed are 0600 and 0400", "chmod 600"] {
                assert!(error.contains(part), "{error}");
            }
        }
        std::fs::set_permissions(&file, Permissions::from_mode(0o400)).unwrap();
        assert_eq!(read_key(&file, 32).unwrap(), key);
    }

    #[test]
    fn what_is_no_key_is_refused_without_its_text() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("key");
        for text in [
            "",
            "secret",
            &"5e".repeat(31),
            &"5g".repeat(32),
            &"5e".repeat(32)[1..],
            &"00".repeat(32),
            &"5e5f".repeat(16),
        ] {
            std::fs::write(&file, text).unwrap();
            std::fs::set_permissions(&file, Permissions::from_mode(0o600)).unwrap();
            let error = read_key(&file, 32).unwrap_err().to_string();
            assert!(
                error.contains("no key of at least 32 random bytes") && error.contains("pb3dp gateway key"),
                "{error}"
            );
            assert!(!error.contains("secret") && !error.contains("5e5e"), "{error}");
        }
        assert!(matches!(
            read_key(folder.path(), 32),
            Err(KeyFileError::NotRegular { .. } | KeyFileError::Read { .. })
        ));
        let missing = read_key(&folder.path().join("none"), 32).unwrap_err();
        assert!(matches!(missing, KeyFileError::Read { .. }), "{missing}");
    }
}
