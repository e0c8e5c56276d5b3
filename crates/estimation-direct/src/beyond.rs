//! Planes beyond the searched depth range.
//!
//! If the range misses the target, the search finds only something similar: the next period of a repetitive texture, or a
//! chance match. The range alone cannot reveal this, but the right image can if it shows the target. A doubtful estimate is
//! therefore compared with the best plane among all depths that the right image shows. Both are evaluated in the same way and
//! on the same level, which is coarser than that of the search.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, DisparityRange};
use pb3dp_estimation_views::front_end::StereoFrontEnd;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionPyramid};

use super::copies::{Copies, scaled};
use super::patches::{PatchConfig, SlantedPatches};
use super::search::hypotheses::HypothesisRules;
use super::search::{PlaneSearch, PlaneSearchConfig};
use crate::outcome::{ColdStartOutcome, support_of, surface_score};
use crate::surface_choice::SurfaceChoice;

/// Largest number of three-point planes drawn: the plane sought covers most of the region. Chosen by hand, not varied: a
/// third of `direct.search.draws`; of planes with half of the points, 100 draws of three miss (7/8)^100, 2 in a million.
const DRAWS: usize = 100;
/// Disparities that are loaded around a plane at another depth, pixels. Chosen by hand, not varied: the patches reach two pixels of a coarse
/// level.
const EXAMINED_PX: f64 = 24.0;

/// Searches beyond the depth range; keeps its buffers.
#[derive(Clone, Debug)]
pub(super) struct Beyond {
    pyramid: RegionPyramid,
    search: PlaneSearch,
    patches: SlantedPatches,
    copies: Copies,
    /// The region at another depth.
    elsewhere: RegionPyramid,
}

impl Default for Beyond {
    fn default() -> Self {
        Self::new(&SurfaceChoice::default(), usize::MAX)
    }
}

impl Beyond {
    /// Creates a search with empty buffers. `patch_area_px`: as in [`Examined`].
    pub fn new(choice: &SurfaceChoice, patch_area_px: usize) -> Self {
        Self {
            pyramid: RegionPyramid::up_to(choice.beyond_area_px as usize),
            search: PlaneSearch::default(),
            patches: SlantedPatches::default(),
            copies: Copies::default(),
            elsewhere: RegionPyramid::up_to(patch_area_px),
        }
    }
}

/// How planes at other depths are examined.
#[derive(Clone, Copy, Debug)]
pub(super) struct Examined<'a> {
    /// Parameters of the patches.
    pub patches: &'a PatchConfig,
    /// Constants of the choice.
    pub choice: &'a SurfaceChoice,
    /// The finest level is the first on which the region has at most this many pixels.
    pub patch_area_px: usize,
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
    /// Loads the region with all disparities that the right image shows, on a coarse level. `None` if it shows none.
    fn load(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        choice: &SurfaceChoice,
    ) -> Option<DisparityRange> {
        let region = source.region.bbox()?;
        // From infinity to the end of the right image.
        let lowest = -front_end.geometry().disparity_offset_px;
        let disparity_px = DisparityRange { lowest, highest: f64::from(region.x + region.width) };
        let wide = PyramidSource { disparity_px, search_area_px: choice.beyond_area_px as usize, ..*source };
        let is_loaded = disparity_px.lowest < disparity_px.highest && self.pyramid.update(front_end, &wide);
        is_loaded.then_some(disparity_px)
    }

    /// Planes at other depths, inside or outside the searched range, that may explain the region, see [`Copies`], each with its support times
    /// its correlation on the level of `answer`. `period_px`: that of the region's texture along the rows, if it repeats.
    pub fn copies(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        (answer, period_px): (&DisparityPlane, Option<f64>),
        limits: &Examined<'_>,
        kernels: Kernels,
    ) -> Vec<(DisparityPlane, f64)> {
        if self.load(front_end, source, limits.choice).is_none() {
            return Vec::new();
        }
        let centre = self.pyramid.centroid_px();
        let answer = answer.centred_at(centre);
        let infinity_px = front_end.geometry().disparity_offset_px;
        let relative_px = answer.d0_px + infinity_px;
        if relative_px <= 0.0 {
            return Vec::new();
        }
        let mut candidates = self.copies.find(&self.pyramid.levels()[0], &answer, infinity_px);
        for plane in &mut candidates {
            // On the coarse level the reach of the patches covers an error of the slope.
            for _ in 0..2 {
                let level = &mut self.pyramid.levels_mut()[0];
                let found = self.patches.run(level, &level.level_plane(plane), limits.patches, kernels);
                *plane = level.full_plane(&found.plane, centre);
            }
        }
        let by_period = period_px.into_iter().flat_map(|period_px| [period_px, -period_px]);
        let by_period = by_period.map(|by_px| scaled(&answer, 1.0 + by_px / relative_px, infinity_px));
        // A coarse level may not show a short period.
        let levels = candidates.into_iter().map(|plane| (plane, usize::MAX)).chain(by_period.map(|plane| (plane, 1)));
        levels.filter_map(|start| self.examine(front_end, source, start, limits, kernels)).collect()
    }

    /// Refines a plane at another depth down to the level on which answers are judged, through so many levels at most.
    fn examine(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        (mut plane, levels_max): (DisparityPlane, usize),
        limits: &Examined<'_>,
        kernels: Kernels,
    ) -> Option<(DisparityPlane, f64)> {
        let bounds = source.region.bbox()?;
        let corner = |x: u32, y: u32| plane.at(&Vector2::new(f64::from(bounds.x + x), f64::from(bounds.y + y)));
        let (w, h) = (bounds.width, bounds.height);
        let at = [corner(0, 0), corner(w, 0), corner(0, h), corner(w, h)];
        let disparity_px = DisparityRange {
            lowest: at.into_iter().fold(f64::MAX, f64::min) - EXAMINED_PX,
            highest: at.into_iter().fold(f64::MIN, f64::max) + EXAMINED_PX,
        };
        let around = PyramidSource { disparity_px, search_area_px: limits.choice.beyond_area_px as usize, ..*source };
        if !self.elsewhere.update(front_end, &around) {
            return None;
        }
        let centre = self.elsewhere.centroid_px();
        let levels = self.elsewhere.levels_mut();
        let coarsest = levels.len().checked_sub(1)?;
        let finest = levels.iter().position(|level| level.area_px <= limits.patch_area_px).unwrap_or(coarsest);
        let mut score = 0.0;
        for level in levels[finest..=coarsest].iter_mut().take(levels_max).rev() {
            for _ in 0..2 {
                let found = self.patches.run(level, &level.level_plane(&plane), limits.patches, kernels);
                plane = level.full_plane(&found.plane, centre);
                score = support_of(&found) * found.mean_correlation;
            }
        }
        Some((plane, score))
    }

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
        let visible_px = self.load(front_end, source, choice)?;
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
