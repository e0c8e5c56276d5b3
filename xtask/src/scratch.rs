//! A copy of the work tree that may be broken.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::workspace::Workspace;

/// A copy of the files that git knows, with a target folder of its own.
pub struct Scratch {
    /// The copy.
    pub tree: PathBuf,
    /// What is built from it.
    pub target: PathBuf,
}

impl Scratch {
    /// The copy of this name, as the work tree is now. Only files that differ are written: cargo builds again what was built from them.
    ///
    /// # Errors
    /// If a file cannot be read, written or removed.
    pub fn new(workspace: &Workspace, name: &str) -> anyhow::Result<Self> {
        let folder = workspace.target_folder()?.join("xtask").join(name);
        let scratch = Self { tree: folder.join("tree"), target: folder.join("target") };
        let files: BTreeSet<PathBuf> = workspace.files()?.into_iter().map(PathBuf::from).collect();
        for file in &files {
            let (from, to) = (workspace.root().join(file), scratch.tree.join(file));
            let wanted = fs::read(&from).with_context(|| format!("cannot read {}", from.display()))?;
            if fs::read(&to).is_ok_and(|there| there == wanted) {
                continue;
            }
            fs::create_dir_all(to.parent().context("a file lies in a folder")?)?;
            fs::copy(&from, &to).with_context(|| format!("cannot write {}", to.display()))?;
            // A copy may keep the time of its original, which cargo takes for a file that has not changed.
            fs::File::options().write(true).open(&to)?.set_modified(std::time::SystemTime::now())?;
        }
        remove_others(&scratch.tree, Path::new(""), &files)?;
        Ok(scratch)
    }
}

/// Removes what is in the folder, and is not one of the files.
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
