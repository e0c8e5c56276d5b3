//! Measurements that are shared by all cases of a rig or scene.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::Result;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method, RowMeasurement};
use pb3dp_hal_platform::cpu_time::timed;
use pb3dp_record::plain_zero::plain_zero;

use super::job::Job;

/// Measured rigs, by their calibration files.
#[derive(Default)]
pub struct Rigs {
    rows: HashMap<Vec<PathBuf>, RowMeasurement>,
    /// A finished estimator of the same method, whose memory is used again.
    idle: Option<Estimator>,
}

impl Rigs {
    /// An estimator for a job; the first job of a calibration measures the rig. All jobs of a call have the same parameters.
    ///
    /// # Errors
    /// A parameter out of range, or images that do not match the calibration.
    pub fn estimator(&mut self, job: &Job, (method, config): (Method, &EstimatorConfig)) -> Result<Estimator> {
        let mut estimator = match self.idle.take().filter(|idle| idle.method() == method) {
            Some(mut idle) => {
                idle.set_rig(&job.rig)?;
                idle
            }
            None => Estimator::new(method, &job.rig, config)?,
        };
        let files: Vec<PathBuf> = job.calibration_files.iter().map(canonical).collect();
        if let Some(known) = self.rows.get(&files) {
            estimator.use_rows(known);
            return Ok(estimator);
        }
        let (measured, millis) = timed(|| estimator.prepare(&job.left, &job.right));
        let Some(measured) = measured? else { return Ok(estimator) };
        if measured.rows.is_zero() {
            // Another pair of this rig may show more.
            tracing::info!(
                "{}: row offset not measured: only {} points are found in both images ({millis:.1} ms)",
                job.name,
                measured.matches
            );
            return Ok(estimator);
        }
        let size = job.rig.right().size();
        let told = format!(
            "{}: vertical misalignment {:.2} px at the image centre (positive: the right image is lower), at most {:.2} px anywhere; \
             compensated (rectified images, {} points, {millis:.1} ms, once per calibration)",
            job.name,
            measured.rows.offset_px,
            measured.rows.magnitude_max_px(size.width, size.height),
            measured.matches
        );
        tracing::info!("{}", plain_zero(&told));
        self.rows.insert(files, measured);
        Ok(estimator)
    }

    /// Returns a finished estimator.
    pub fn give_back(&mut self, estimator: Estimator) {
        self.idle = Some(estimator);
    }
}

/// Canonical path of a file.
fn canonical(file: impl AsRef<Path>) -> PathBuf {
    let file = file.as_ref();
    file.canonicalize().unwrap_or_else(|_| file.to_path_buf())
}
