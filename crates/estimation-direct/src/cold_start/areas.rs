//! Areas of surfaces that share a region: the disparity of every pixel decides which one is the larger.
//!
//! Patches across a depth edge follow the side with more texture, mostly the nearer one, and so make it larger than it is.

use super::{ColdStart, Surface};
use crate::disparity_plane::DisparityRange;
use crate::shape::surface_search;

impl ColdStart {
    /// If other surfaces are no alias of the best one, measures their areas and moves the largest to the front.
    pub(super) fn prefer_larger(&mut self, disparity_px: DisparityRange) {
        let Some(first) = self.surfaces.first().copied() else { return };
        let is_other = |other: &Surface| {
            let rival = self.rival(&first, other);
            let share = rival.own_share.max(other.share * self.search.valid_share);
            self.differs(&first.plane, &other.plane)
                && rival.overlap <= self.config.choice.overlap_of_alias
                && share >= self.config.choice.own_share_min
        };
        let others = (1..self.surfaces.len()).filter(|&i| is_other(&self.surfaces[i])).collect::<Vec<_>>();
        if others.is_empty() {
            return;
        }
        let level = &self.pyramid.levels()[self.searched];
        if !self.dense.match_pixels(level, disparity_px, &surface_search(&self.config.search), self.kernels) {
            return;
        }
        for i in std::iter::once(0).chain(others) {
            let plane = level.level_plane(&self.surfaces[i].plane);
            let on_plane = self.dense.share_within(level, &plane, self.config.choice.area_px, self.kernels);
            self.surfaces[i].area_share = Some(on_plane * self.dense.valid_share);
        }
        let area = |i: &usize| self.surfaces[*i].area_share.unwrap_or(0.0);
        let largest = (0..self.surfaces.len()).rev().max_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(0);
        self.surfaces[..=largest].rotate_right(1);
    }
}
