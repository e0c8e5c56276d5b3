//! The folder of a run's results; those of an earlier run are kept.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use pb3dp_record::text_file::read_text;

/// A file that every run writes, and two of its keys.
const OF_A_RUN: &str = "summary.json";
const ITS_KEYS: [&str; 2] = ["provenance", "summary"];

/// The folder of the results. When it is dropped without a result in it, everything is as before.
#[derive(Debug)]
pub struct ResultFolder {
    folder: PathBuf,
    /// Folders that did not exist before, innermost first.
    created: Vec<PathBuf>,
    /// Where an earlier run is kept.
    earlier: Option<PathBuf>,
}

impl ResultFolder {
    /// Creates the folder. If it contains an earlier run, that one becomes the first free one of `DIR.1`, `DIR.2` and so on.
    ///
    /// # Errors
    /// If the folder is the root, has a file of this name that no run wrote, or cannot be moved or created.
    pub fn take(folder: &Path) -> Result<Self> {
        if folder.canonicalize().is_ok_and(|whole| whole.parent().is_none()) {
            bail!(
                "--out {}: this is the root of all files; name a folder of its own, such as out/run",
                folder.display()
            );
        }
        let named = folder.ancestors().filter(|path| !path.as_os_str().is_empty());
        let created = named.take_while(|path| !path.exists()).map(Path::to_owned).collect();
        let mut taken = Self { folder: folder.to_owned(), created, earlier: None };
        if holds_run(folder)? {
            let numbered = |number: u32| {
                let mut name = OsString::from(folder.components().as_path());
                name.push(format!(".{number}"));
                PathBuf::from(name)
            };
            let free = (1..).map(numbered).find(|path| !path.exists()).context("no name is free")?;
            fs::rename(folder, &free)
                .with_context(|| format!("{}: cannot be moved to {}", folder.display(), free.display()))?;
            taken.earlier = Some(free);
        }
        fs::create_dir_all(folder).with_context(|| format!("{}: cannot be created", folder.display()))?;
        Ok(taken)
    }

    /// Moves the earlier run back.
    fn put_back(&self, earlier: &Path) {
        // A folder with files stays.
        if fs::remove_dir(&self.folder).is_ok()
            && let Err(error) = fs::rename(earlier, &self.folder)
        {
            tracing::warn!("{}: cannot be moved back to {}: {error}", earlier.display(), self.folder.display());
        }
    }
}

impl Drop for ResultFolder {
    fn drop(&mut self) {
        match &self.earlier {
            Some(earlier) => {
                self.put_back(earlier);
                if earlier.exists() {
                    tracing::info!("the earlier run in {} is kept in {}", self.folder.display(), earlier.display());
                }
            }
            None => self.created.iter().for_each(|folder| drop(fs::remove_dir(folder))),
        }
    }
}

/// Whether the folder has the results of a run, and not files of somebody else that a run would replace.
fn holds_run(folder: &Path) -> Result<bool> {
    let file = folder.join(OF_A_RUN);
    if !file.exists() {
        return Ok(false);
    }
    let text = read_text(&file).unwrap_or_default();
    let keys = serde_json::from_str::<serde_json::Value>(&text).unwrap_or_default();
    if !ITS_KEYS.iter().all(|key| keys.get(key).is_some()) {
        bail!(
            "{}: this file is of no run of pb3dp, and the results would replace it; name another folder (--out)",
            file.display()
        );
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_run(number: u32) -> String {
        format!(r#"{{"provenance": {{}}, "summary": {number}}}"#)
    }

    #[test]
    fn files_of_somebody_else_are_not_moved_or_replaced() {
        let place = tempfile::tempdir().unwrap();
        for text in ["{\"summary\": \"mine\"}", "not JSON", ""] {
            fs::write(place.path().join(OF_A_RUN), text).unwrap();
            let refused = ResultFolder::take(place.path()).unwrap_err().to_string();
            assert!(refused.contains("summary.json: this file is of no run of pb3dp"), "{refused}");
            assert_eq!(fs::read_to_string(place.path().join(OF_A_RUN)).unwrap(), text);
        }
        for root in ["/", "/.."] {
            let refused = ResultFolder::take(Path::new(root)).unwrap_err().to_string();
            assert!(refused.contains("name a folder of its own"), "{refused}");
        }
    }

    #[test]
    fn a_refused_run_leaves_no_empty_folder() {
        let place = tempfile::tempdir().unwrap();
        let (mine, out) = (place.path().join("mine"), place.path().join("mine/out/run"));
        fs::create_dir(&mine).unwrap();
        let taken = ResultFolder::take(&out).unwrap();
        fs::write(out.join("flight.jsonl"), "").unwrap();
        drop(taken);
        assert!(out.exists(), "a folder with files stays");
        fs::remove_dir_all(mine.join("out")).unwrap();
        drop(ResultFolder::take(&out).unwrap());
        assert!(mine.exists() && !mine.join("out").exists());
    }

    #[test]
    fn a_refused_run_leaves_the_earlier_one_in_its_place() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("run");
        fs::create_dir(&out).unwrap();
        fs::write(out.join(OF_A_RUN), of_run(1)).unwrap();
        drop(ResultFolder::take(&out).unwrap());
        assert_eq!(fs::read_to_string(out.join(OF_A_RUN)).unwrap(), of_run(1));
        assert!(!place.path().join("run.1").exists());
    }

    #[test]
    fn an_earlier_run_gets_the_first_free_number_and_other_folders_stay() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("run");
        for number in 0..=2 {
            let taken = ResultFolder::take(&out.join("")).unwrap();
            assert!(out.read_dir().unwrap().next().is_none(), "a new folder");
            fs::write(out.join(OF_A_RUN), of_run(number)).unwrap();
            drop(taken);
            if let Some(earlier) = u32::checked_sub(number, 1) {
                let kept = fs::read_to_string(place.path().join(format!("run.{number}")).join(OF_A_RUN)).unwrap();
                assert_eq!(kept, of_run(earlier));
            }
        }
        fs::remove_file(out.join(OF_A_RUN)).unwrap();
        fs::write(out.join("notes.txt"), "mine").unwrap();
        drop(ResultFolder::take(&out).unwrap());
        assert!(out.join("notes.txt").exists(), "a folder without a run stays");
        assert!(!place.path().join("run.3").exists());
    }
}
