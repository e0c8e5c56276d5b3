//! What is shared by all cases of a rig or scene.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::Result;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation::rig_watch::RigWatch;

use pb3dp_hal_platform::cpu_time::timed;

use super::job::Job;

/// What the pairs of each rig have shown of it, by the calibration files.
#[derive(Default)]
pub struct Rigs {
    watches: HashMap<Vec<PathBuf>, RigWatch>,
    /// A finished estimator of the same method, whose memory is used again.
    idle: Option<Estimator>,
}

impl Rigs {
    /// An estimator for a job. All jobs of a call have the same parameters.
    ///
    /// # Errors
    /// A parameter out of range.
    pub fn estimator(&mut self, job: &Job, (method, config): (Method, &EstimatorConfig)) -> Result<Estimator> {
        let mut estimator = match self.idle.take().filter(|idle| idle.method() == method) {
            Some(mut idle) => {
                idle.set_rig(&job.rig)?;
                idle
            }
            None => Estimator::new(method, &job.rig, config)?,
        };
        if let Some(watch) = self.watches.remove(&files(job)) {
            estimator.use_watch(watch);
        }
        let (measured, millis) = timed(|| estimator.look(&job.left, &job.right));
        tracing::debug!("{}: rows: {:?} ({millis:.1} ms)", job.name, measured?);
        Ok(estimator)
    }

    /// Takes back the estimator of a finished job.
    pub fn give_back(&mut self, job: &Job, estimator: Estimator) {
        self.watches.insert(files(job), estimator.watch().clone());
        self.idle = Some(estimator);
    }
}

fn files(job: &Job) -> Vec<PathBuf> {
    job.calibration_files.iter().map(canonical).collect()
}

/// Canonical path of a file.
fn canonical(file: impl AsRef<Path>) -> PathBuf {
    let file = file.as_ref();
    file.canonicalize().unwrap_or_else(|_| file.to_path_buf())
}
