//! Choice of the search levels: coarse if that is decisive, otherwise finer.

use pb3dp_estimation_views::disparity_plane::{DisparityPlane, DisparityRange};
use pb3dp_estimation_views::region_pyramid::LevelPlane;

use super::ColdStart;

impl ColdStart {
    /// Searches from coarse to fine until a level is decisive, so that the cost of the finest level is spent only if needed.
    pub(super) fn search(
        &mut self,
        disparity_px: DisparityRange,
        allowed: &impl Fn(&DisparityPlane) -> bool,
        may_continue: &mut dyn FnMut() -> bool,
    ) {
        let full = self.pyramid.search_level();
        let levels = self.pyramid.levels();
        let first_below = |area_px: usize, otherwise: usize| {
            levels.iter().position(|level| level.area_px <= area_px).unwrap_or(otherwise).max(otherwise)
        };
        let quick = first_below(self.config.quick_area_px, full);
        let coarse = first_below((self.config.choice.coarse_area_px as usize).min(self.config.quick_area_px), quick);
        if coarse > quick && self.search_plain_level(coarse, disparity_px, allowed) {
            return;
        }
        if !self.surfaces.is_empty() && !may_continue() {
            return;
        }
        self.search_level(quick, disparity_px, allowed);
        if quick > full && !self.is_decided() && may_continue() {
            self.search_level(full, disparity_px, allowed);
        }
    }

    /// Finds and evaluates the candidates on one level, if one plane explains nearly all single-pixel disparities. Returns
    /// whether the patches confirm it.
    fn search_plain_level(
        &mut self,
        index: usize,
        disparity_px: DisparityRange,
        allowed: &impl Fn(&DisparityPlane) -> bool,
    ) -> bool {
        let (centre, level) = (self.pyramid.centroid_px(), &self.pyramid.levels()[index]);
        let is_allowed = |p: &LevelPlane| allowed(&level.full_plane(p, centre));
        let (search, config, choice, kernels) =
            (&mut self.search, &self.config.search, self.config.choice, self.kernels);
        let is_plain = |share: f64, valid_share: f64| {
            share >= choice.one_plane_share && share * valid_share >= choice.one_plane_clear
        };
        if !search.match_pixels(level, disparity_px, config, kernels)
            || !is_plain(1.0, search.valid_share)
            || !search.has_plane(level, config, choice.one_plane_share, is_allowed, kernels)
        {
            return false;
        }
        search.find_planes(level, config, is_allowed, kernels);
        self.searched = index;
        self.surfaces.clear();
        self.judge_candidates(index, centre);
        self.surfaces.first().is_some_and(|first| {
            is_plain(first.share, self.search.valid_share) && first.patches.support_share >= choice.one_plane_support
        })
    }

    /// Finds and evaluates the candidates on one level.
    fn search_level(&mut self, index: usize, disparity_px: DisparityRange, allowed: impl Fn(&DisparityPlane) -> bool) {
        self.searched = index;
        self.surfaces.clear();
        let (centre, level) = (self.pyramid.centroid_px(), &self.pyramid.levels()[index]);
        let is_allowed = |p: &LevelPlane| allowed(&level.full_plane(p, centre));
        self.search.run(level, disparity_px, &self.config.search, is_allowed, self.kernels);
        self.judge_candidates(index, centre);
    }

    /// Whether the best surface covers so much of the region that a finer search would find the same.
    fn is_decided(&self) -> bool {
        self.surfaces.first().is_some_and(|first| {
            let agreeing = first.patches.textured_share * first.patches.support_share;
            let clear = self.search.valid_share * first.share;
            agreeing.min(self.config.choice.decided_clear * clear) >= self.config.quick_share_min
        })
    }
}
