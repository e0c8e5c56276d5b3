//! A copy of the work tree that tests may break.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::workspace::Workspace;

/// A copy of the tracked files, with a separate target folder.
pub struct Scratch {
    /// The copy.
    pub tree: PathBuf,
    /// Its target folder.
    pub target: PathBuf,
}

impl Scratch {
    /// The copy of this name, updated to the work tree. Only differing files are written, because cargo rebuilds whatever depends on them.
    ///
    /// # Errors
    /// If a file cannot be read, written or removed.
    pub fn new(workspace: &Workspace, name: &str) -> anyhow::Result<Self> {
        let folder = workspace.target_folder()?.join("xtask").join(name);
        let scratch = Self { tree: folder.join("tree"), target: folder.join("target") };
        let names = workspace.files()?.into_iter().chain(workspace.folder_links());
        let files: BTreeSet<PathBuf> = names.map(PathBuf::from).collect();
        for file in &files {
            let (from, to) = (workspace.root().join(file), scratch.tree.join(file));
            if let Ok(target) = fs::read_link(&from) {
                copy_link(&target, &to)?;
                continue;
            }
            let wanted = fs::read(&from).with_context(|| format!("cannot read {}", from.display()))?;
            if fs::read(&to).is_ok_and(|there| there == wanted) {
                continue;
            }
            fs::create_dir_all(to.parent().context("a file lies in a folder")?)?;
            fs::copy(&from, &to).with_context(|| format!("cannot write {}", to.display()))?;
            // A copy may keep the modification time of its original, and cargo would not rebuild it.
            fs::File::options().write(true).open(&to)?.set_modified(std::time::SystemTime::now())?;
        }
        remove_others(&scratch.tree, Path::new(""), &files)?;
        Ok(scratch)
    }
}

/// Creates a symbolic link to this target, unless it is there.
fn copy_link(target: &Path, to: &Path) -> anyhow::Result<()> {
    if fs::read_link(to).is_ok_and(|there| there == target) {
        return Ok(());
    }
    fs::create_dir_all(to.parent().context("a link lies in a folder")?)?;
    fs::remove_file(to).ok();
    std::os::unix::fs::symlink(target, to).with_context(|| format!("cannot link {}", to.display()))
}

/// Removes all files in the folder that are not among these files.
fn remove_others(tree: &Path, folder: &Path, files: &BTreeSet<PathBuf>) -> anyhow::Result<()> {
    for entry in fs::read_dir(tree.join(folder))? {
        let entry = entry?;
        let inner = folder.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            remove_others(tree, &inner, files)?;
        } else if !files.contains(&inner) {
            fs::remove_file(entry.path()).with_context(|| format!("cannot remove {}", entry.path().display()))?;
        }
    }
    Ok(())
}
