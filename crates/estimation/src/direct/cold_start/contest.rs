//! Other explanations of the best candidate's pixels that come near it on the level of the search are compared with it on the
//! finest one.
//!
//! Where pixels are joined, what only resembles the region may look as good as the region's own surface; finer pixels tell
//! more. What they say decides, and where the levels disagree, or finer pixels leave two of them nearly equal, the outcome
//! names the other one.

use super::{ColdStart, OVERLAP_OF_ALIAS, Rival, Surface, surface_score};

/// Candidates with this share of the best one's score are compared again.
const NEAR_SCORE: f64 = 0.6;

impl ColdStart {
    /// Puts the surface first that is best on the finest level, of those that are near the best one on the level of the
    /// search and explain mostly the same pixels. Returns the best of the others, with the larger of its score ratios on both levels if they
    /// disagree on which one is better, else with that on the finest; `None` if none is near.
    pub(super) fn contest(&mut self, may_continue: &mut dyn FnMut() -> bool) -> Option<Rival> {
        let first = *self.surfaces.first()?;
        let is_near = |other: &Surface| other.score >= NEAR_SCORE * first.score;
        let count = self.surfaces.iter().take_while(|other| is_near(other)).count();
        let is_other = |other: &Surface| {
            self.differs(&first.plane, &other.plane) && self.rival(&first, other).overlap > OVERLAP_OF_ALIAS
        };
        let others = (1..count).filter(|&i| is_other(&self.surfaces[i])).collect::<Vec<_>>();
        if others.is_empty() || !may_continue() {
            return None;
        }
        let own = self.finest_score(&first, may_continue);
        let mut best: Option<(usize, f64)> = None;
        for i in others {
            let score = self.finest_score(&self.surfaces[i].clone(), may_continue);
            if best.is_none_or(|(_, known)| score > known) {
                best = Some((i, score));
            }
        }
        let (at, score) = best?;
        let other = self.surfaces[at];
        if score <= own {
            return Some(Rival { score_ratio: score / own.max(1e-9), ..self.rival(&first, &other) });
        }
        self.surfaces[..=at].rotate_right(1);
        let rival = self.rival(&other, &first);
        Some(Rival { score_ratio: rival.score_ratio.max(own / score), ..rival })
    }

    fn finest_score(&mut self, surface: &Surface, may_continue: &mut dyn FnMut() -> bool) -> f64 {
        let (_, patches, _) = self.descend(surface.plane, may_continue);
        surface_score(&patches, self.search.valid_share * surface.share)
    }
}
