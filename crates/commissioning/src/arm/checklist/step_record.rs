//! The commissioning record of an arm under test. It is on the disk before a step begins and after it has passed, so that nothing
//! that interrupts a step leaves its earlier pass.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::steps::Step;
use crate::commissioned::CommissioningRecord;

/// The record and its file.
#[derive(Debug)]
pub struct StepRecord {
    path: PathBuf,
    record: CommissioningRecord,
}

impl StepRecord {
    /// Reads the record in a file; `new` is an empty record of the connected arm. Writes nothing.
    ///
    /// # Errors
    /// A file that is no record.
    pub fn open(path: &Path, new: CommissioningRecord) -> Result<Self> {
        Ok(Self { path: path.to_path_buf(), record: new.continued(path)? })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the earlier pass of a step; it may begin only afterwards.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn begin(&mut self, step: Step) -> Result<()> {
        self.record.remove(step.name());
        self.save()
    }

    /// Notes that a step has passed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn pass(&mut self, step: Step, date: String) -> Result<()> {
        self.record.add(step.name(), date);
        self.save()
    }

    fn save(&self) -> Result<()> {
        self.record.save(&self.path).context("the commissioning record")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commissioned::tests::empty;

    #[test]
    fn a_step_that_has_begun_has_no_earlier_pass_on_the_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vs.json");
        let on_disk = || std::fs::read_to_string(&path).unwrap();
        let passed = |step: Step| on_disk().contains(&format!("\"{}\": \"2026", step.name()));
        let mut record = StepRecord::open(&path, empty()).unwrap();
        assert!(!path.exists(), "nothing has begun");
        for step in [Step::Comms, Step::EStop] {
            record.begin(step).unwrap();
            record.pass(step, "2026-03-01T12:00:00Z".to_owned()).unwrap();
        }
        assert!(passed(Step::Comms) && passed(Step::EStop));
        // Whatever ends this program now: no later call is needed.
        let mut again = StepRecord::open(&path, empty()).unwrap();
        assert!(passed(Step::EStop), "it has not begun yet");
        again.begin(Step::EStop).unwrap();
        assert!(passed(Step::Comms) && !passed(Step::EStop), "{}", on_disk());
        std::fs::remove_dir_all(folder.path()).unwrap();
        assert!(again.begin(Step::Comms).is_err(), "a step whose pass cannot be removed does not begin");
    }
}
