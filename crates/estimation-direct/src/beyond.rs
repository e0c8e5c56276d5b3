//! Planes beyond the searched depth range.
//!
//! If the range misses the target, the search finds only something similar: the next period of a repetitive texture, or a
//! chance match. The range alone cannot reveal this, but the right image can if it shows the target. A doubtful estimate is
//! therefore compared with the best plane among all depths that the right image shows. Both are evaluated in the same way and
//! on the same level, which is coarser than that of the search.

use pb3dp_estimation_core::cpu::Kernels;

use super::disparity_plane::{DisparityPlane, DisparityRange};
use super::front_end::StereoFrontEnd;
use super::patches::{PatchConfig, SlantedPatches};
use super::region_pyramid::{PyramidSource, RegionPyramid};
use super::search::hypotheses::HypothesisRules;
use super::search::{PlaneSearch, PlaneSearchConfig};
use crate::outcome::{ColdStartOutcome, surface_score};
use crate::surface_choice::SurfaceChoice;

/// Largest number of three-point planes drawn: the plane sought covers most of the region. Chosen by hand, not varied: a
/// third of `direct.search.draws`; of planes with half of the points, 100 draws of three miss (7/8)^100, 2 in a million.
const DRAWS: usize = 100;

/// Searches beyond the depth range; keeps its buffers.
#[derive(Clone, Debug)]
pub(super) struct Beyond {
    pyramid: RegionPyramid,
    search: PlaneSearch,
    patches: SlantedPatches,
}

impl Default for Beyond {
    fn default() -> Self {
        Self::new(&SurfaceChoice::default())
    }
}

impl Beyond {
    /// Creates a search with empty buffers.
    pub fn new(choice: &SurfaceChoice) -> Self {
        Self {
            pyramid: RegionPyramid::up_to(choice.beyond_area_px as usize),
            search: PlaneSearch::default(),
            patches: SlantedPatches::default(),
        }
    }
}

/// A plane beyond the depth range, and its score relative to the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeyondRange {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Its score divided by the score of the estimate.
    pub score_ratio: f64,
}

impl Beyond {
    /// The best plane whose disparity at the region's centroid is not among those of `source`. Its score is relative to the
    /// best score of `answer` and of all planes within the range. `None` if there is no such plane.
    #[allow(clippy::too_many_arguments, reason = "two configurations, the pair, and what was found")]
    pub fn best(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        answer: &DisparityPlane,
        search: &PlaneSearchConfig,
        patches: &PatchConfig,
        choice: &SurfaceChoice,
        allowed: impl Fn(&DisparityPlane) -> bool,
        kernels: Kernels,
    ) -> Option<BeyondRange> {
        let searched_px = source.disparity_px;
        let region = source.region.bbox()?;
        // From infinity to the end of the right image.
        let lowest = -front_end.geometry().disparity_offset_px;
        let visible_px = DisparityRange { lowest, highest: f64::from(region.x + region.width) };
        let wide =
            PyramidSource { disparity_px: visible_px, search_area_px: choice.beyond_area_px as usize, ..*source };
        if visible_px.lowest >= visible_px.highest || !self.pyramid.update(front_end, &wide) {
            return None;
        }
        let (centre, level) = (self.pyramid.centroid_px(), &self.pyramid.levels()[0]);
        let hypotheses = HypothesisRules { draws: search.hypotheses.draws.min(DRAWS), ..search.hypotheses };
        let search = &PlaneSearchConfig { hypotheses, ..*search };
        self.search.run(level, visible_px, search, |plane| allowed(&level.full_plane(plane, centre)), kernels);
        let (mut within, mut beyond) = (0.0_f64, None::<(DisparityPlane, f64)>);
        let level = &mut self.pyramid.levels_mut()[0];
        let own = level.level_plane(answer);
        let own_share = self.search.share_within(level, &own, search.hypotheses.tolerance_px, kernels);
        let candidates = self.search.candidates.iter().map(|candidate| (candidate.plane, candidate.share));
        for (plane, share) in candidates.chain([(own, own_share)]) {
            let found = self.patches.run(level, &plane, patches, kernels);
            let score = surface_score(&found, self.search.valid_share * share);
            let full = level.full_plane(&found.plane, centre);
            let d0_px = full.d0_px;
            if d0_px < searched_px.lowest - choice.beyond_end_px || d0_px > searched_px.highest + choice.beyond_end_px {
                if beyond.is_none_or(|(_, best)| score > best) {
                    beyond = Some((full, score));
                }
            } else {
                within = within.max(score);
            }
        }
        beyond.map(|(plane, score)| BeyondRange { plane, score_ratio: score / within.max(1e-9) })
    }
}

/// Whether an estimate is doubtful. Something similar to the target may correlate well on the coarse level of the search, so
/// the finest level of the patches is checked as well.
pub(super) fn is_doubtful(outcome: &ColdStartOutcome, choice: &SurfaceChoice) -> bool {
    let correlation = outcome.first.patches.mean_correlation.min(outcome.finest.mean_correlation);
    outcome.first.score < choice.decisive_score || correlation < choice.decisive_correlation
}
