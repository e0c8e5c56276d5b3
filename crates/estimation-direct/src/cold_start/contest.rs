//! Other explanations of the best candidate's pixels that come near it on the level of the search are compared with it on the
//! finest one.
//!
//! Where pixels are joined, what only resembles the region may look as good as the region's own surface; finer pixels tell
//! more. What they say decides, and where the levels disagree, or finer pixels leave two of them nearly equal, the outcome
//! names the other one.

use super::{ColdStart, Descent, OVERLAP_OF_ALIAS, Surface};
use crate::outcome::{Rival, surface_score};

/// Candidates with this share of the best one's score, on the level where that is lower, are compared again. Chosen; no sweep is on record.
const NEAR_SCORE: f64 = 0.6;

impl ColdStart {
    /// Puts the surface first that is best on the finest level, of those that are near the best one of the level of the search
    /// and explain mostly the same pixels, and says how it looks there. Where there are others, also returns the best of them,
    /// with the larger of its score ratios on both levels if they disagree on which one is better, else with that on the
    /// finest. `None` without surfaces.
    pub(super) fn contest(&mut self, may_continue: &mut dyn FnMut() -> bool) -> Option<(Descent, Option<Rival>)> {
        let first = *self.surfaces.first()?;
        let descent = self.descend(first.plane, may_continue);
        let own = self.finest_score(&first, &descent);
        let least = NEAR_SCORE * first.score.min(own);
        let is_other = |other: &Surface| {
            other.score >= least
                && self.differs(&first.plane, &other.plane)
                && self.rival(&first, other).overlap > OVERLAP_OF_ALIAS
        };
        let others = (1..self.surfaces.len()).filter(|&i| is_other(&self.surfaces[i])).collect::<Vec<_>>();
        let mut best: Option<(usize, f64)> = None;
        for i in others {
            if !may_continue() {
                break;
            }
            let other = self.surfaces[i];
            let descent = self.descend(other.plane, may_continue);
            let score = self.finest_score(&other, &descent);
            if best.is_none_or(|(_, known)| score > known) {
                best = Some((i, score));
            }
        }
        let Some((at, score)) = best else { return Some((descent, None)) };
        let other = self.surfaces[at];
        let rival = if score <= own {
            Rival { score_ratio: score / own.max(1e-9), ..self.rival(&first, &other) }
        } else {
            self.surfaces[..=at].rotate_right(1);
            let rival = self.rival(&other, &first);
            Rival { score_ratio: rival.score_ratio.max(own / score), ..rival }
        };
        // The levels are left as the best one marks them.
        let plane = self.surfaces[0].plane;
        Some((self.descend(plane, may_continue), Some(rival)))
    }

    fn finest_score(&self, surface: &Surface, descent: &Descent) -> f64 {
        surface_score(&descent.patches, self.search.valid_share * surface.share)
    }
}
