//! Spectators of a run, such as the panel and the recording: they see each control step and each estimate, and influence neither.

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;

use crate::commands::CommandSummary;
use crate::estimate_log::PairEstimate;
use crate::journal::TruePoses;
use crate::moving::StepRecord;

/// Receives the messages of a run. In real time the recording thread calls it, so no thread that moves an arm waits for a spectator; in
/// simulated time the loop calls it, so no method may take long.
pub trait Spectator: Send {
    /// Receives the time of the first control step.
    fn begin_at(&mut self, _begin: MonotonicTime) {}

    /// Receives a finished control step, with the true poses if they are known.
    fn moved(&mut self, step: &StepRecord, poses: Option<TruePoses>);

    /// Receives a pair with its estimate.
    fn estimated(&mut self, pair_estimate: &PairEstimate);

    /// A fault has latched the arms; faults count from 1. May be called again for the same fault.
    fn fault(&mut self, _number: usize) {}

    /// Keeps everything; also called after a run that has failed.
    ///
    /// # Errors
    /// If not everything is kept.
    fn finish(self: Box<Self>, _end: &RunEnd) -> Result<()> {
        Ok(())
    }
}

/// What is known only at the end of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunEnd {
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// Velocity command counts of both arms.
    pub commands: Vec<CommandSummary>,
    /// The failure that ended the run early.
    pub failure: Option<String>,
}
