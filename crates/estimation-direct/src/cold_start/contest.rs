//! Comparison of the best candidate with alternative explanations of the same pixels: alternatives close to it on the search
//! level are compared with it on the finest level.
//!
//! After downsampling, something similar to the region may score as high as the region's own surface; finer pixels discriminate
//! better and therefore decide. If the levels disagree, or if two candidates are nearly equal on the finest level, the outcome
//! reports the other candidate.

use super::{ColdStart, Descent, Surface};
use crate::outcome::{Rival, surface_score};

impl ColdStart {
    /// Moves the surface to the front that is best on the finest level, among those close to the best one of the search level
    /// that explain mostly the same pixels, and returns its evaluation there. If there are others, also returns the best of
    /// them. Its score ratio is that of the finest level or, if the levels disagree on the better surface, the larger of both.
    /// `None` without surfaces.
    pub(super) fn contest(&mut self, may_continue: &mut dyn FnMut() -> bool) -> Option<(Descent, Option<Rival>)> {
        let first = *self.surfaces.first()?;
        let descent = self.descend(first.plane, may_continue);
        let own = self.finest_score(&first, &descent);
        let least = self.config.choice.near_score * first.score.min(own);
        let is_other = |other: &Surface| {
            other.score >= least
                && self.differs(&first.plane, &other.plane)
                && self.rival(&first, other).overlap > self.config.choice.overlap_of_alias
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
        // Afterwards the levels hold the marks of the best surface.
        let plane = self.surfaces[0].plane;
        Some((self.descend(plane, may_continue), Some(rival)))
    }

    fn finest_score(&self, surface: &Surface, descent: &Descent) -> f64 {
        surface_score(&descent.patches, self.search.valid_share * surface.share)
    }
}
