//! The estimates of each target as CSV files, with the columns of `estimates.csv` of a run.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use pb3dp_record::estimates_csv::{EstimateRow, heading};

use super::walk::{Outcome, TargetResult};
use crate::commands::output_file::{check_writable, numbered};

/// Open CSV files, one for each target; none without `--csv`.
pub struct EstimateFiles {
    files: Vec<(String, BufWriter<File>)>,
}

impl EstimateFiles {
    /// Begins a file for each target; the files of several targets are numbered.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn open(file: Option<&Path>, targets: usize) -> Result<Self> {
        let Some(file) = file else { return Ok(Self { files: Vec::new() }) };
        let open = |index: usize| {
            let file = if targets > 1 { numbered(file, index) } else { file.to_path_buf() };
            check_writable("--csv", &file)?;
            let name = format!("--csv {}: cannot be written", file.display());
            let opened = File::create(&file).with_context(|| name.clone())?;
            let mut opened = (name, BufWriter::new(opened));
            add(&mut opened, &heading())?;
            Ok(opened)
        };
        Ok(Self { files: (0..targets).map(open).collect::<Result<_>>()? })
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn add(&mut self, t_s: f64, found: &[TargetResult]) -> Result<()> {
        for (file, found) in self.files.iter_mut().zip(found) {
            let unknown = without_estimate(t_s);
            let row = match &found.outcome {
                Outcome::Estimate { estimate, millis } => EstimateRow {
                    status: estimate.status.as_str(),
                    latency_millis: Some(*millis),
                    fitness: estimate.fitness,
                    cam_left_from_model: estimate.cam_left_from_model.as_ref(),
                    covariance: estimate.covariance.as_ref(),
                    pose_covariance: estimate.pose_covariance.as_ref(),
                    ..unknown
                },
                Outcome::Refused { .. } => unknown,
            };
            add(file, &row.line())?;
        }
        Ok(())
    }

    /// Adds a frame that could not be read.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn add_unread(&mut self, t_s: f64) -> Result<()> {
        self.files.iter_mut().try_for_each(|file| add(file, &without_estimate(t_s).line()))
    }

    /// Ends the files.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn close(mut self) -> Result<()> {
        self.files.iter_mut().try_for_each(|(name, file)| file.flush().with_context(|| name.clone()))
    }
}

fn add((name, file): &mut (String, BufWriter<File>), line: &str) -> Result<()> {
    writeln!(file, "{line}").with_context(|| name.clone())
}

/// The row of a frame without an estimate. A replay has no controller, so no estimate has an age.
fn without_estimate(t_s: f64) -> EstimateRow<'static> {
    EstimateRow {
        t_s,
        status: "error",
        age_millis: None,
        latency_millis: None,
        fitness: None,
        cam_left_from_model: None,
        covariance: None,
        pose_covariance: None,
    }
}
