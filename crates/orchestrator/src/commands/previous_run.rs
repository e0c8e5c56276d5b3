//! Keeps the results of an earlier run.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// A file that every run writes.
const OF_A_RUN: &str = "summary.json";

/// Creates the folder of a run, if necessary.
///
/// # Errors
/// If it cannot be created.
pub fn make(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be created", folder.display()))
}

/// The folders of this path that do not exist, innermost first.
pub fn missing(folder: &Path) -> Vec<PathBuf> {
    let named = folder.ancestors().filter(|path| !path.as_os_str().is_empty());
    named.take_while(|path| !path.exists()).map(Path::to_owned).collect()
}

/// Removes what a refused run has created: empty folders.
pub fn remove_empty(created: &[PathBuf]) {
    for folder in created {
        // One with files stays.
        let _ = std::fs::remove_dir(folder);
    }
}

/// Moves the folder of an earlier run to the first free one of `DIR.1`, `DIR.2` and so on, logs that, and creates a new folder.
///
/// # Errors
/// If the folder cannot be moved or created.
pub fn keep(folder: &Path) -> Result<()> {
    if !folder.join(OF_A_RUN).is_file() {
        return Ok(());
    }
    let numbered = |number: u32| {
        let mut name = OsString::from(folder.components().as_path());
        name.push(format!(".{number}"));
        PathBuf::from(name)
    };
    let free = (1..).map(numbered).find(|path| !path.exists()).context("no name is free")?;
    std::fs::rename(folder, &free)
        .with_context(|| format!("{}: cannot be moved to {}", folder.display(), free.display()))?;
    tracing::info!("the earlier run in {} is kept in {}", folder.display(), free.display());
    make(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_run_leaves_no_empty_folder() {
        let place = tempfile::tempdir().unwrap();
        let (mine, out) = (place.path().join("mine"), place.path().join("mine/out/run"));
        make(&mine).unwrap();
        let created = missing(&out);
        assert_eq!(created, [out.clone(), mine.join("out")]);
        make(&out).unwrap();
        std::fs::write(out.join("flight.jsonl"), "").unwrap();
        remove_empty(&created);
        assert!(out.exists(), "a folder with files stays");
        std::fs::remove_file(out.join("flight.jsonl")).unwrap();
        remove_empty(&created);
        assert!(mine.exists() && !mine.join("out").exists());
    }

    #[test]
    fn an_earlier_run_gets_the_first_free_number_and_other_folders_stay() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("run");
        keep(&out).unwrap();
        for number in 1..=2 {
            make(&out).unwrap();
            std::fs::write(out.join("notes.txt"), "mine").unwrap();
            keep(&out).unwrap();
            assert!(out.exists(), "a folder without a run stays");
            std::fs::write(out.join(OF_A_RUN), format!("{number}")).unwrap();
            keep(&out.join("")).unwrap();
            assert!(out.read_dir().unwrap().next().is_none(), "a new folder");
            let kept = std::fs::read_to_string(place.path().join(format!("run.{number}")).join(OF_A_RUN)).unwrap();
            assert_eq!(kept, number.to_string());
        }
    }
}
