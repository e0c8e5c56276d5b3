//! Areas of surfaces that share a region: the disparity of every pixel decides which surface is meant.
//!
//! Patches across a depth edge follow the side with more texture, mostly the nearer one, and so make it larger than it is. Pixels in
//! the middle count more: a rectangle around a target has it there, and the background at the border.

use pb3dp_estimation_views::disparity_plane::DisparityRange;
use pb3dp_estimation_views::region_pyramid::{LevelPlane, RegionLevel};

use super::{ColdStart, Surface};
use crate::search::Disparities;
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
        let mut others = (1..self.surfaces.len()).filter(|&i| is_other(&self.surfaces[i])).collect::<Vec<_>>();
        if others.is_empty() {
            return;
        }
        let level = &self.pyramid.levels()[self.searched];
        if !self.dense.match_pixels(level, disparity_px, &surface_search(&self.config.search), self.kernels) {
            return;
        }
        // Planes that touch one curved surface at several places are no surfaces of their own.
        let (choice, own) = (self.config.choice, level.level_plane(&first.plane));
        others.retain(|&i| {
            let other = level.level_plane(&self.surfaces[i].plane);
            !self.dense.reaches(level, &own, &other, choice.on_plane_px, &choice)
        });
        if others.is_empty() {
            return;
        }
        for i in std::iter::once(0).chain(others) {
            let plane = level.level_plane(&self.surfaces[i].plane);
            self.surfaces[i].area_share =
                Some(area_share(level, self.dense.disparities(), &plane, self.config.choice.on_plane_px));
        }
        let area = |i: &usize| self.surfaces[*i].area_share.unwrap_or(0.0);
        let largest = (0..self.surfaces.len()).rev().max_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(0);
        self.surfaces[..=largest].rotate_right(1);
    }
}

/// Share of the region's pixels that have a disparity on the plane, weighted by [`central`].
fn area_share(level: &RegionLevel, found: Disparities<'_>, plane: &LevelPlane, near_px: f64) -> f64 {
    let (area, stride) = (found.area, level.left.window.width);
    let to_shift = f64::from(found.first) - f64::from(level.column_shift());
    let (mut on_plane, mut all) = (0.0, 0.0);
    for y in 0..area.height {
        let inside = &level.region[(area.y + y) * stride + area.x..][..area.width];
        let values = &found.values[y * area.width..][..area.width];
        let by_row = central(y, area.height);
        let at_start = plane.c + plane.a * area.x as f64 + plane.b * (area.y + y) as f64;
        for (x, value) in values.iter().enumerate().filter(|(x, _)| inside[*x] != 0) {
            let weight = by_row * central(x, area.width);
            let off_px = f64::from(*value) + to_shift - (at_start + plane.a * x as f64);
            all += weight;
            // False without a clear disparity.
            on_plane += if off_px.abs() < near_px { weight } else { 0.0 };
        }
    }
    if all > 0.0 { on_plane / all } else { 0.0 }
}

/// Weight of a place among `count`: 1 in the middle, 0 at both ends (Epanechnikov's kernel, as in Comaniciu 2003).
fn central(at: usize, count: usize) -> f64 {
    let from_middle = (2 * at + 1) as f64 / count as f64 - 1.0;
    1.0 - from_middle * from_middle
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::search::volume::LevelBox;

    #[test]
    fn an_area_counts_its_pixels_by_their_place() {
        let mut level = RegionLevel { scale: 1, ..RegionLevel::default() };
        level.left.window.width = 8;
        // Left window at 10, right one at 4: a disparity of 9 is a shift of 3.
        (level.left.window.x, level.right.window.x) = (10, 4);
        level.region = vec![1; 8 * 7];
        let area = LevelBox { x: 2, y: 1, width: 4, height: 5 };
        let plane = LevelPlane { a: 0.25, b: -0.5, c: 3.5, row: 0 };
        let shift = |x: usize, y: usize| 3.5 + 0.25 * (x + 2) as f32 - 0.5 * (y + 1) as f32;
        // The plane in the left two columns, 2 px beside it in the third, nothing in the last.
        let value = |x: usize, y: usize| match x {
            0 | 1 => shift(x, y) + 6.0 - 5.0,
            2 => shift(x, y) + 8.0 - 5.0,
            _ => f32::NAN,
        };
        let values = (0..20).map(|i| value(i % 4, i / 4)).collect::<Vec<_>>();
        let found = Disparities { area, first: 5, values: &values };
        assert!((area_share(&level, found, &plane, 1.0) - 0.5).abs() < 1e-12);
        // Weights of the columns: 7/16, 15/16, 15/16, 7/16.
        assert!((area_share(&level, found, &plane, 2.5) - 37.0 / 44.0).abs() < 1e-12);
        level.region.fill(0);
        assert_eq!(area_share(&level, found, &plane, 1.0), 0.0);
    }
}
