//! Searches for the plane with the highest score.
//!
//! [`rmga`] is the paper's genetic algorithm, [`exhaustive`] visits every chromosome and so separates the error of a search
//! from the error of what it maximises. Both work on any [`PlaneScore`].

pub mod chromosome;
pub mod exhaustive;
pub mod rmga;

use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;

/// Score of a hypothesis that cannot be scored: a point behind a camera, a tilt out of range. Less than every real score.
pub const REFUSED: i32 = i32::MIN;

/// Something that can be maximised over planes. Integer scores, so that every machine ranks alike.
pub trait PlaneScore {
    /// Writes the score of each hypothesis, larger is better, [`REFUSED`] for those that cannot be scored.
    ///
    /// The result for a hypothesis depends on that hypothesis alone, not on its place in the batch. Does not allocate.
    /// Both slices have the same length; what exceeds the shorter one is left alone.
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]);
}
