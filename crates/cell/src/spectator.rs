//! A spectator of a run: sees each control step and each estimate, and influences neither.

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
