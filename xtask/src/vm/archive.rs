//! The kernel's initial file system: a cpio archive of the format `newc`, not compressed.
//!
//! The format: a header of 6 letters and 13 numbers of 8 hexadecimal digits, the path with a zero, the content, each padded to
//! whole words of 4 bytes (Linux, Documentation/driver-api/early-userspace/buffer-format.rst).

use std::path::Path;

use anyhow::Context;

/// Kinds of entries, with their permissions.
const FOLDER: u32 = 0o040_755;
const FILE: u32 = 0o100_644;
const PROGRAM: u32 = 0o100_755;
const CHARACTER_DEVICE: u32 = 0o020_600;

/// An archive in memory.
#[derive(Default)]
pub struct Archive {
    bytes: Vec<u8>,
    entries: u32,
}

impl Archive {
    pub fn folder(&mut self, path: &str) {
        self.entry(path, FOLDER, [0, 0], &[]);
    }

    pub fn file(&mut self, path: &str, content: &[u8], is_program: bool) {
        self.entry(path, if is_program { PROGRAM } else { FILE }, [0, 0], content);
    }

    /// `/dev/console`, which the kernel opens before its first program can create it.
    pub fn console(&mut self) {
        self.entry("dev/console", CHARACTER_DEVICE, [5, 1], &[]);
    }

    fn entry(&mut self, path: &str, mode: u32, device: [u32; 2], content: &[u8]) {
        self.entries += 1;
        let [major, minor] = device;
        let (size, name_size) = (content.len(), path.len() + 1);
        let (inode, owner, links, time, check) = (self.entries, 0, 1, 0, 0);
        let header = format!(
            "070701{inode:08x}{mode:08x}{owner:08x}{owner:08x}{links:08x}{time:08x}{size:08x}{:08x}{:08x}{major:08x}{minor:08x}\
             {name_size:08x}{check:08x}",
            0, 0
        );
        self.bytes.extend_from_slice(header.as_bytes());
        self.bytes.extend_from_slice(path.as_bytes());
        self.bytes.push(0);
        self.fill();
        self.bytes.extend_from_slice(content);
        self.fill();
    }

    fn fill(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    /// Completes the archive and writes it to a file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(mut self, path: &Path) -> anyhow::Result<()> {
        self.entry("TRAILER!!!", 0, [0, 0], &[]);
        std::fs::write(path, &self.bytes).with_context(|| format!("cannot write {}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_as_the_kernel_wants_them() {
        let mut archive = Archive::default();
        archive.file("init", b"abcde", true);
        let text = String::from_utf8(archive.bytes.clone()).unwrap();
        let header = "070701\
            00000001000081ED0000000000000000000000010000000000000005\
            000000000000000000000000000000000000000500000000"
            .to_lowercase();
        assert_eq!(text, format!("{header}init\0\0abcde\0\0\0"));
        assert_eq!(header.len(), 110);
        archive.console();
        assert_eq!(archive.bytes.len() % 4, 0);
        let device = String::from_utf8(archive.bytes).unwrap();
        assert!(device.contains("00002180") && device.contains("0000000500000001"), "{device}");
    }
}
