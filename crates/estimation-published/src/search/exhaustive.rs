//! Exhaustive search: scores all 2^24 chromosomes and finds the best.
//!
//! For offline use: it evaluates the score itself, without any error of a search.

use std::ops::Range;

use super::chromosome::{Chromosome, Codec, Codes, TILT_CODES, Z_CODES};
use super::{PlaneScore, REFUSED};

/// The highest score and its chromosome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Optimum {
    /// The score; [`REFUSED`] if no hypothesis could be scored.
    pub score: i32,
    /// The lowest chromosome with this score.
    pub chromosome: Chromosome,
    /// Number of chromosomes with this score: the maximum of a vote count is flat.
    pub ties: u64,
}

impl Optimum {
    /// Optimum of no hypotheses: the neutral element of [`Optimum::merge`].
    pub const NONE: Self = Self { score: REFUSED, chromosome: Chromosome::LAST, ties: 0 };

    /// The optimum of two disjoint sets of hypotheses.
    #[must_use]
    pub fn merge(self, other: Self) -> Self {
        if self.score != other.score {
            return if self.score > other.score { self } else { other };
        }
        Self { score: self.score, chromosome: self.chromosome.min(other.chromosome), ties: self.ties + other.ties }
    }
}

/// The optimum over the depth codes in `z_codes` (`0..1024` for all) and all tilts. Does not allocate.
pub fn optimum_in(score: &impl PlaneScore, codec: &Codec, z_codes: Range<u32>) -> Optimum {
    let mut hypotheses = [codec.range().centre(); TILT_CODES as usize];
    let mut scores = [REFUSED; TILT_CODES as usize];
    let mut best = Optimum::NONE;
    for z in z_codes.start..z_codes.end.min(Z_CODES) {
        for theta_x in 0..TILT_CODES {
            let codes = |theta_y| Codes { z, theta_x, theta_y };
            for (slot, theta_y) in hypotheses.iter_mut().zip(0..) {
                *slot = codec.hypothesis(codes(theta_y));
            }
            score.score(&hypotheses, &mut scores);
            for (theta_y, score) in (0..).zip(scores).filter(|(_, score)| *score != REFUSED) {
                if score >= best.score {
                    best = best.merge(Optimum { score, chromosome: codec.chromosome(codes(theta_y)), ties: 1 });
                }
            }
        }
    }
    best
}

/// The optimum over all 2^24 chromosomes, in this thread.
pub fn optimum(score: &impl PlaneScore, codec: &Codec) -> Optimum {
    optimum_in(score, codec, 0..Z_CODES)
}

#[cfg(test)]
#[path = "exhaustive_tests.rs"]
mod tests;
