//! Interface to the computer under test: files below a root folder, and trial operations.

use std::fs;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use pb3dp_hal_platform::realtime::{Realtime, enter};
use rustix::fs::{Access, access, statvfs};

/// Permissions and owner of a file, and whether it is a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Node {
    /// The nine lowest bits: rwx of owner, group, others.
    pub(super) mode: u32,
    pub(super) uid: u32,
    pub(super) gid: u32,
    pub(super) is_device: bool,
}

/// The computer. Paths are absolute on that computer.
pub(super) trait System {
    /// Trimmed text of a file; `None` if it is unreadable.
    fn text(&self, path: &str) -> Option<String>;
    /// Sorted names in a folder; empty if the folder does not exist.
    fn names(&self, folder: &str) -> Vec<String>;
    /// Target of a path after all links; `None` if nothing exists there.
    fn target(&self, path: &str) -> Option<String>;
    /// Metadata of a path, links followed.
    fn node(&self, path: &str) -> Option<Node>;
    /// Runs a thread with SCHED_FIFO for a moment; returns the error of the system and the remedy.
    fn try_fifo(&self, priority: u8) -> Result<(), String>;
    /// Locks the memory of this program for a moment.
    fn try_memory_lock(&self) -> Result<(), String>;
    /// Bytes that this user may still write below a path, or below its nearest existing folder.
    fn free_bytes(&self, path: &Path) -> Result<u64, String>;
}

/// Files below a root folder.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    root: PathBuf,
}

impl Tree {
    /// For a folder that represents `/`.
    pub(super) fn new(root: &Path) -> Self {
        Self { root: root.canonicalize().unwrap_or_else(|_| root.to_path_buf()) }
    }

    fn place(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    pub(super) fn text(&self, path: &str) -> Option<String> {
        fs::read_to_string(self.place(path)).ok().map(|text| text.trim().to_owned())
    }

    pub(super) fn names(&self, folder: &str) -> Vec<String> {
        let entries = fs::read_dir(self.place(folder)).into_iter().flatten().flatten();
        let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    pub(super) fn target(&self, path: &str) -> Option<String> {
        let target = self.place(path).canonicalize().ok()?;
        Some(format!("/{}", target.strip_prefix(&self.root).ok()?.display()))
    }

    fn node(&self, path: &str) -> Option<Node> {
        let data = fs::metadata(self.place(path)).ok()?;
        Some(Node {
            mode: data.mode() & 0o777,
            uid: data.uid(),
            gid: data.gid(),
            is_device: data.file_type().is_char_device(),
        })
    }
}

/// The computer that this program runs on.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    tree: Tree,
}

impl Machine {
    pub(super) fn new() -> Self {
        Self { tree: Tree::new(Path::new("/")) }
    }
}

impl System for Machine {
    fn text(&self, path: &str) -> Option<String> {
        self.tree.text(path)
    }

    fn names(&self, folder: &str) -> Vec<String> {
        self.tree.names(folder)
    }

    fn target(&self, path: &str) -> Option<String> {
        self.tree.target(path)
    }

    fn node(&self, path: &str) -> Option<Node> {
        self.tree.node(path)
    }

    fn try_fifo(&self, priority: u8) -> Result<(), String> {
        tried(Realtime { priority: Some(priority), locks_memory: false, cpu: None })
    }

    fn try_memory_lock(&self) -> Result<(), String> {
        tried(Realtime { priority: None, locks_memory: true, cpu: None })
    }

    fn free_bytes(&self, path: &Path) -> Result<u64, String> {
        may_write(path)?;
        free_bytes(path)
    }
}

/// The nearest existing folder of a path.
fn nearest(path: &Path) -> Result<PathBuf, String> {
    let whole = std::path::absolute(path).map_err(|error| error.to_string())?;
    Ok(whole.ancestors().find(|folder| folder.exists()).unwrap_or(Path::new("/")).to_path_buf())
}

/// Whether this user may create files and folders below a path, or below its nearest existing folder.
fn may_write(path: &Path) -> Result<(), String> {
    let there = nearest(path)?;
    access(&there, Access::WRITE_OK | Access::EXEC_OK)
        .map_err(|error| format!("{}: this user cannot write there: {error}", there.display()))
}

/// Bytes that this user may still write below a path, or below its nearest existing folder.
///
/// # Errors
/// The error of the system.
pub(in crate::commands) fn free_bytes(path: &Path) -> Result<u64, String> {
    let there = nearest(path)?;
    let found = statvfs(&there).map_err(|error| format!("{}: {error}", there.display()))?;
    Ok(found.f_bavail.saturating_mul(found.f_frsize))
}

/// Requests it as the threads of an arm do, in a thread that ends at once.
fn tried(wanted: Realtime) -> Result<(), String> {
    let thread = std::thread::Builder::new().name("doctor".to_owned()).spawn(move || enter(&wanted));
    let thread = thread.map_err(|error| error.to_string())?;
    let shortfalls = thread.join().map_err(|_| "the test thread panicked".to_owned())?;
    shortfalls.first().map_or(Ok(()), |shortfall| Err(shortfall.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_written_is_reported_before_it_exists() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(may_write(&folder.path().join("recordings/of today")), Ok(()));
        // A file is not a folder, for any user.
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let why = may_write(&file.join("recordings")).unwrap_err();
        assert!(why.starts_with(&format!("{}: this user cannot write there", file.display())), "{why}");
    }
}
