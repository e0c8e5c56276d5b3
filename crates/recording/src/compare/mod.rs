//! What differs between two recorded runs: settings, versions or methods that differ, and their effect.
//!
//! Times count from the begin of each run. Images are not read. Equal means: all estimates, filtered poses, commands and decisions are
//! equal to the bit. Settings, versions and times of the computation do not count: two versions that behave alike are equal.

mod control;
mod estimates;
mod matching;
mod page;
mod recorded;
mod table;
#[cfg(test)]
mod tests;
mod text;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use pb3dp_setup::recorded_settings::{DifferentSetting, differing};

use self::control::{CommandComparison, DecisionComparison, compare_commands, compare_decisions};
use self::estimates::{EstimateComparison, FilterComparison, compare_estimates, compare_filters};
use self::matching::Matching;
use self::recorded::Recorded;

/// Names of the files of [`Comparison::write`].
const PAGE: &str = "compare.html";
const TABLE: &str = "compare.csv";

/// Two recorded runs, A and B, and their differences.
pub struct Comparison {
    runs: [Recorded; 2],
    settings: Vec<DifferentSetting>,
    estimates: EstimateComparison,
    filter: FilterComparison,
    commands: CommandComparison,
    decisions: DecisionComparison,
}

impl Comparison {
    /// Reads two recordings and compares them.
    ///
    /// # Errors
    /// Names the file that is no recording of a run, is damaged, or has no control step.
    pub fn of_files(a: &Path, b: &Path) -> Result<Self> {
        Ok(Self::new([Recorded::read(a)?, Recorded::read(b)?]))
    }

    fn new(runs: [Recorded; 2]) -> Self {
        let both = runs.each_ref();
        let [stamps_a, stamps_b] = both.map(Recorded::step_stamps);
        let steps = Matching::new([&stamps_a, &stamps_b]);
        Self {
            settings: differing(both.map(|run| &run.settings)),
            estimates: compare_estimates(both),
            filter: compare_filters(both, &steps),
            commands: compare_commands(both, &steps),
            decisions: compare_decisions(both, &steps),
            runs,
        }
    }

    /// Whether both runs have the same pairs and control steps, with results that are equal to the bit.
    pub fn is_equal(&self) -> bool {
        let Self { estimates, filter, commands, decisions, .. } = self;
        [&estimates.matched, &filter.matched, &commands.matched, &decisions.matched].into_iter().all(|m| m.is_equal())
    }

    /// All differences as text with several lines.
    pub fn text(&self) -> String {
        text::text(self)
    }

    /// Writes `compare.html`, a page with plots over time, and `compare.csv`, a line for each two estimates that belong together, into a
    /// folder, which is created. Returns both files.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<[PathBuf; 2]> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot be created; name another folder", folder.display()))?;
        let files = [folder.join(PAGE), folder.join(TABLE)];
        page::page(self).write(&files[0])?;
        pb3dp_record::text_file::write_text(&files[1], &table::csv(self))
            .with_context(|| format!("{}: cannot be written; check the free space", files[1].display()))?;
        Ok(files)
    }
}
