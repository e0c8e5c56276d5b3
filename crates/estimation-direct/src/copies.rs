//! Copies of a region at other depths: identical parts side by side, fences, patterns with a period.
//!
//! A region may match several places of the right image equally well, and the search may see only one of them: the disparities of
//! all pixels agree on the same place, or the others are outside the depth range. The region is therefore compared with the right
//! image at every depth, and the peaks are candidates for another explanation, which the patches then examine.
//!
//! A copy is the same surface displaced along the baseline, so its disparity (plus the offset to infinity) is that of the answer
//! times a factor.

use pb3dp_estimation_views::disparity_plane::DisparityPlane;
use pb3dp_estimation_views::region_pyramid::{RegionLevel, is_visible};

use super::repetition::{Neighbourhood, neighbourhood, rows_around};

/// Largest number of points compared. Chosen by hand, not varied: as in [`super::repetition`].
const POINTS_MAX: usize = 400;
/// Candidates that are examined: each costs an evaluation of patches. Chosen by hand, not varied: the best is nearly always among them.
const CANDIDATES_MAX: usize = 4;
/// A copy resembles the region at least by this share of what the answer does. Chosen by hand, not varied: with more, copies with another
/// slope are missed; with less, more chance matches are examined.
const RESEMBLES_MIN: f64 = 0.5;
/// Distance of a copy from the answer, and of copies from each other, pixels of the level. Chosen by hand, not varied: wider than a peak.
const APART_PX: i32 = 3;

/// Finds copies; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Copies {
    /// Per point: column and row in the left window, its neighbourhood, and its disparity relative to infinity in pixels of the level.
    points: Vec<(usize, usize, Neighbourhood, f64)>,
    /// Neighbourhoods of the rows of the right window; rows without points are empty.
    rows: Vec<Vec<Neighbourhood>>,
    /// Added to disparities of the level so that they are zero at infinity.
    infinity_px: f64,
}

impl Copies {
    /// Planes at other depths at which the region resembles the right image, the best first. The right window of `level` covers all depths
    /// that are sought; `infinity_px` is added to disparities so that they are zero at infinity.
    pub fn find(&mut self, level: &RegionLevel, answer: &DisparityPlane, infinity_px: f64) -> Vec<DisparityPlane> {
        let scale = level.scale as f64;
        let middle = answer.d0_px + infinity_px;
        self.infinity_px = infinity_px / scale;
        self.take(level, answer);
        let (left, right) = (level.left.window, level.right.window);
        // Until the last column of the region leaves the right window.
        let steps = left.x + left.width as i32 - right.x + self.infinity_px as i32;
        let profile: Vec<f64> =
            (0..steps).map(|step| self.resemblance(level, f64::from(step) * scale / middle)).collect();
        let own = (middle / scale).round() as i32;
        let at = |step: i32| usize::try_from(step).ok().and_then(|step| profile.get(step)).copied().unwrap_or(0.0);
        let of_answer = (own - 1..=own + 1).map(at).fold(0.0, f64::max);
        let is_peak = |step: &i32| {
            let near = (step - 1..=step + 1).map(at).fold(0.0, f64::max);
            (step - own).abs() >= APART_PX
                && at(*step) >= near
                && at(*step) >= RESEMBLES_MIN * of_answer
                && at(*step) > 0.0
        };
        let mut peaks: Vec<i32> = (1..steps).filter(is_peak).collect();
        peaks.sort_by(|a, b| at(*b).total_cmp(&at(*a)));
        let mut found: Vec<i32> = Vec::new();
        for peak in peaks {
            if found.len() < CANDIDATES_MAX && found.iter().all(|known| (known - peak).abs() >= APART_PX) {
                found.push(peak);
            }
        }
        found.into_iter().map(|step| scaled(answer, f64::from(step) * scale / middle, infinity_px)).collect()
    }

    fn take(&mut self, level: &RegionLevel, answer: &DisparityPlane) {
        let (width, height) = (level.left.window.width, level.left.window.height);
        let plane = level.level_plane(answer);
        let at_origin = plane.c + f64::from(level.column_shift()) + self.infinity_px;
        let step = level.area_px.div_ceil(POINTS_MAX).max(1);
        let pixels = (1..height.saturating_sub(1)).flat_map(|y| (1..width.saturating_sub(1)).map(move |x| (x, y)));
        let inside = pixels.filter(|(x, y)| {
            let i = y * width + x;
            level.region[i] != 0 && is_visible(level.left.flags[i])
        });
        self.points.clear();
        self.points.extend(inside.step_by(step).map(|(x, y)| {
            let own = neighbourhood(&rows_around(&level.left, y), x);
            (x, y, own, at_origin + plane.a * x as f64 + plane.b * y as f64)
        }));
        let right = level.right.window;
        self.rows.iter_mut().for_each(Vec::clear);
        self.rows.resize_with(self.rows.len().max(right.height), Vec::new);
        for &(_, y, _, _) in &self.points {
            let Some(row) = usize::try_from(y as i32 + plane.row)
                .ok()
                .filter(|row| (1..right.height.saturating_sub(1)).contains(row))
            else {
                continue;
            };
            if self.rows[row].is_empty() && right.width > 2 {
                let rows = rows_around(&level.right, row);
                let flags = &level.right.flags[row * right.width..][..right.width];
                self.rows[row].extend((0..right.width).map(|x| {
                    match x > 0 && x + 1 < right.width && is_visible(flags[x]) {
                        true => neighbourhood(&rows, x),
                        false => Neighbourhood::default(),
                    }
                }));
            }
        }
    }

    /// Mean correlation of the points with the right image if their disparities relative to infinity are multiplied by a factor; points
    /// outside of the image agree with nothing.
    fn resemblance(&self, level: &RegionLevel, factor: f64) -> f64 {
        let (left, right) = (level.left.window, level.right.window);
        let (mut sum, mut own) = (0.0, 0.0);
        for (x, y, here, relative) in &self.points {
            own += f64::from(here.agreement(here));
            let at = *x as f64 + f64::from(left.x - right.x) - (factor * relative - self.infinity_px);
            let row = *y as i32 + left.y - right.y;
            let column = (at + 0.5).floor();
            let place = usize::try_from(row).ok().and_then(|row| self.rows.get(row));
            if let Some(there) = place.filter(|_| column >= 0.0).and_then(|row| row.get(column as usize)) {
                sum += f64::from(here.agreement(there));
            }
        }
        if own > 0.0 { sum / own } else { 0.0 }
    }
}

/// A plane whose disparity relative to infinity is multiplied by a factor.
pub(super) fn scaled(plane: &DisparityPlane, factor: f64, infinity_px: f64) -> DisparityPlane {
    DisparityPlane { d0_px: factor * (plane.d0_px + infinity_px) - infinity_px, slope: plane.slope * factor, ..*plane }
}
