//! Choice of the search levels: coarse if that is decisive, otherwise finer.

use super::super::disparity_plane::{DisparityPlane, DisparityRange};
use super::super::region_pyramid::LevelPlane;
use super::ColdStart;

/// Factor by which patches support a plane more than single clear disparities do. Chosen by hand, not varied: with more,
/// the first search is final for more regions with few clear disparities.
const DECIDED_CLEAR: f64 = 1.5;
/// The search begins on the first level on which the region has at most this many pixels: an eighth of the work of the next (a
/// quarter of the pixels and half of the disparities of `direct.search.quick_area_max_px`).
const COARSE_AREA_PX: usize = 1500;
/// The search ends there if one plane explains this share of the clear disparities; the share is soft, because noise takes a
/// tenth or two. A second surface would take more. Chosen with the next two: of 613 real windows and 109 cases none changes its
/// pass or status by ending there.
const ONE_PLANE_SHARE: f64 = 0.75;
/// Smallest share of the region that these disparities must have. Chosen, see [`ONE_PLANE_SHARE`].
const ONE_PLANE_CLEAR: f64 = 0.5;
/// Smallest share of the textured patches that must support the plane. Chosen, see [`ONE_PLANE_SHARE`].
const ONE_PLANE_SUPPORT: f64 = 0.8;

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
        let coarse = first_below(COARSE_AREA_PX.min(self.config.quick_area_px), quick);
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
        let (search, config, kernels) = (&mut self.search, &self.config.search, self.kernels);
        let is_plain =
            |share: f64, valid_share: f64| share >= ONE_PLANE_SHARE && share * valid_share >= ONE_PLANE_CLEAR;
        if !search.match_pixels(level, disparity_px, config, kernels)
            || !is_plain(1.0, search.valid_share)
            || !search.has_plane(level, config, ONE_PLANE_SHARE, is_allowed, kernels)
        {
            return false;
        }
        search.find_planes(level, config, is_allowed, kernels);
        self.searched = index;
        self.surfaces.clear();
        self.judge_candidates(index, centre);
        self.surfaces.first().is_some_and(|first| {
            is_plain(first.share, self.search.valid_share) && first.patches.support_share >= ONE_PLANE_SUPPORT
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
            agreeing.min(DECIDED_CLEAR * clear) >= self.config.quick_share_min
        })
    }
}
