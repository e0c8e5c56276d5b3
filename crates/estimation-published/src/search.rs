//! Search for the plane with the highest score.
//!
//! [`rmga`] is the paper's genetic algorithm. [`exhaustive`] evaluates every chromosome, which separates the error of a search
//! from the error of the score. Both work with any [`PlaneScore`].

pub mod chromosome;
pub mod exhaustive;
pub mod rmga;

use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;

/// Score of a hypothesis that cannot be scored, because a point is behind a camera or the tilt is out of range. Less than every
/// real score.
pub const REFUSED: i32 = i32::MIN;

/// A score that can be maximised over planes. Scores are integers, so that every machine ranks equally.
pub trait PlaneScore {
    /// Writes the score of each hypothesis; larger is better, and [`REFUSED`] marks those that cannot be scored.
    ///
    /// The result for a hypothesis depends on this hypothesis only, not on its position in the batch. Does not allocate. Both
    /// slices have the same length; elements beyond the shorter one are not changed.
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]);

    /// The highest possible score; the fitness is the score divided by it.
    fn score_max(&self) -> i32;
}

/// A hypothesis and its fitness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The hypothesis.
    pub psi: PlaneHypothesis,
    /// Its fitness.
    pub fitness: f64,
}
