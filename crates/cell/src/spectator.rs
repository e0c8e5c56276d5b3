//! Spectators of a run: they see each control step and each estimate, and influence neither.

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;

use crate::commands::CommandSummary;
use crate::journal::TruePoses;
use crate::moving::Moved;
use crate::noting::PairEstimate;

/// Receives what a run records. In real time the recording thread calls it, so no thread that moves an arm waits for a spectator; in
/// simulated time the loop calls it, so no method may take long.
pub trait Spectator: Send {
    /// Receives a finished control step.
    fn moved(&mut self, step: &Moved);

    /// Receives a pair with its estimate.
    fn seen(&mut self, seen: &PairEstimate);
}

/// Keeps what a run records, from the same thread as a spectator.
pub trait RunRecorder: Send {
    /// Receives the time of the first control step.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// Receives a finished control step, with the true poses if they are known.
    fn moved(&mut self, step: &Moved, poses: Option<TruePoses>);

    /// Receives a pair with its estimate.
    fn seen(&mut self, seen: &PairEstimate);

    /// A fault has latched the arms; faults count from 1. May be called again for the same fault.
    fn fault(&mut self, number: usize);

    /// Keeps everything; also called after a run that has failed.
    ///
    /// # Errors
    /// If not everything is kept.
    fn finish(self: Box<Self>, end: &RunEnd) -> Result<()>;
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
