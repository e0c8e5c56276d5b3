//! Extension of a small region by surroundings in the same plane.
//!
//! A region of 30 pixels has a short lever for its tilt, and its surface often continues beyond the outline. The pixels around
//! it are therefore divided into tiles, and every tile measures its disparity offset from the plane of the region alone. A tile
//! is accepted if both images agree there, if its shift is no larger than the covariance of the region's plane and the tile's
//! own noise allow, and if it touches the region or another accepted tile. The plane is then refined on region and tiles
//! together. The result replaces the region's own plane if the two are consistent.
//!
//! A tile may belong to another object that lies in the same plane at this moment; for the plane of this pair it is valid. The
//! region, its support and a tracker's model of them remain unchanged.

use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;
use pb3dp_estimation_views::disparity_plane::RectifiedGeometry;
use pb3dp_estimation_views::reach::REACH_MAX_PX;
use pb3dp_estimation_views::region_pyramid::{LevelPlane, RegionLevel};

use super::final_plane::EQUAL_ERRORS;
use super::patches::USABLE;
use super::photometric::RefinedPlane;

/// A normal with a smaller standard deviation needs no surroundings, radians (1 degree). Chosen by hand, not varied: with
/// the rule as a whole, 116 of 128 and 124 of 160 real windows of 28 to 40 px pass, without it 113 and 122.
const NORMAL_SIGMA_RAD: f64 = 0.0175;
/// The same for a region that is not small, whose surroundings take longer (2 degrees). Chosen with figures: of 566 windows of 65 to 91 px in
/// real scenes 2 less pass than with 1.5 degrees, in two thirds of the time that surroundings add.
const LARGE_NORMAL_SIGMA_RAD: f64 = 0.0349;
/// Side of a tile, pixels. Chosen by hand, not varied: 3 x 3 tiles are fitted together; smaller ones are noisier, larger
/// ones cross more edges.
const TILE: usize = 4;
/// Smallest number of pixels for the fit of a tile. Chosen by hand, not varied: three of the nine tiles that are fitted
/// together.
const TILE_PX_MIN: f64 = 48.0;
/// Lowest correlation of an accepted tile. Chosen by hand, not varied: with less, other textures join; with more, noisy
/// images gain nothing.
const CORRELATION_MIN: f64 = 0.8;
/// Largest shift of a tile, in standard deviations of the expected shift. 95 % of normal errors.
const SIGMAS_MAX: f64 = 2.0;
/// Largest shift of a tile, pixels. Chosen by hand, not varied: with more, surfaces that bend away join the region.
const SHIFT_MAX_PX: f64 = 0.3;
/// Standard deviation of a tile's shift not due to pixel noise (interpolation, shading, relief), pixels. Chosen by hand,
/// not varied: with less, tiles of real surfaces are rejected where the plane is accurate.
const SYSTEMATIC_SIGMA_PX: f64 = 0.05;
/// Tiles with a larger standard deviation of the shift are ignored, pixels. Derived: a shift this uncertain cannot be
/// compared with its limit.
const TILE_SIGMA_MAX_PX: f64 = SHIFT_MAX_PX;
/// Lower bound of a tile's residual standard deviation, grey levels. Chosen by hand, not varied: with less, smooth tiles
/// count as more accurate than rounding allows (0.4 for two images).
const NOISE_MIN_GREY: f64 = 1.0;
/// Parameters of a tile's fit: shift, gain, offset.
const FITTED: f64 = 3.0;
/// Largest squared distance of the new plane from the region's own, in standard deviations of the latter: 95 % of chi-squared
/// of three.
const DISTANCE_MAX: f64 = 7.81;
/// Largest ratio of the slopes' variance with and without the surroundings. Chosen by hand, not varied: the standard
/// deviation must fall by 16 % (1 - sqrt(0.7)).
const SHRINKAGE_MAX: f64 = 0.7;

/// Finds the surroundings that continue a region; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Surroundings {
    reached: Vec<u8>,
    scratch: Vec<u8>,
    wanted: Vec<u8>,
    taps: Vec<[f32; 4]>,
    terms: Vec<[f32; TERMS]>,
    sums: Vec<TileFit>,
    tiles: Vec<Tile>,
}

/// State of a tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Tile {
    /// Outside the windows, or without information.
    #[default]
    Silent,
    /// Agrees with the plane, but is not connected yet.
    Agrees,
    /// Part of the region, or connected to it.
    Serves,
}

impl Surroundings {
    /// Adds to the region and support of a full-size level the pixels up to `reach` around it that agree with `refined`.
    /// Returns the number of pixels added.
    pub fn extend(&mut self, level: &mut RegionLevel, refined: &RefinedPlane, reach: usize, kernels: Kernels) -> usize {
        let (width, height) = (level.left.window.width, level.left.window.height);
        self.reached.clone_from(&level.region);
        dilate(&mut self.reached, &mut self.scratch, width, reach.min(REACH_MAX_PX) as u8);
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let plane = level.level_plane(&refined.plane);
        self.sums.clear();
        self.sums.resize(columns * rows, TileFit::default());
        let middle = middle_of(level);
        for y in 0..height {
            self.add_row(level, &plane, y, middle, kernels);
        }
        self.tiles.clear();
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let tile = self.ask(level, refined, column, row, columns);
            self.tiles.push(tile);
        }
        self.connect(columns, rows);
        let mut added = 0;
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let serves = self.tiles[(y / TILE) * columns + x / TILE] == Tile::Serves;
                if serves && self.reached[i] != 0 && level.region[i] == 0 && level.left.flags[i] == 0 {
                    (level.region[i], level.support[i]) = (1, USABLE);
                    added += 1;
                }
            }
        }
        level.area_px += added;
        added
    }

    /// Adds the terms of a row's pixels to their tiles.
    fn add_row(&mut self, level: &RegionLevel, plane: &LevelPlane, y: usize, middle: f32, kernels: Kernels) {
        let width = level.left.window.width;
        let (region, reached) = (&level.region[y * width..][..width], &self.reached[y * width..][..width]);
        let tiles = &mut self.sums[(y / TILE) * width.div_ceil(TILE)..][..width.div_ceil(TILE)];
        for ((tile, region), reached) in tiles.iter_mut().zip(region.chunks(TILE)).zip(reached.chunks(TILE)) {
            for (region, reached) in region.iter().zip(reached) {
                tile.pixels += usize::from(*reached);
                tile.own += usize::from(*reached & *region);
            }
        }
        let row = y as i64 + i64::from(plane.row);
        if row < 0 || row >= level.right.window.height as i64 || width < 3 {
            return;
        }
        let (left, right) = (level.left.luminance().row(y), level.right.luminance().row(row as usize));
        self.wanted.clear();
        let flags = &level.left.flags[y * width..][..width];
        self.wanted.extend(reached.iter().zip(flags).map(|(reached, flag)| u8::from(*reached != 0 && *flag == 0)));
        (self.wanted[0], self.wanted[width - 1]) = (0, 0);
        self.taps.resize(width, [0.0; 4]);
        self.terms.resize(width, [0.0; TERMS]);
        let line = RowLine { start: -(plane.c + plane.b * y as f64) as f32, step: (1.0 - plane.a) as f32, middle };
        row_terms(kernels, left, right, &self.wanted, line, &mut self.taps, &mut self.terms);
        for (i, (tile, terms)) in tiles.iter_mut().zip(self.terms.chunks(TILE)).enumerate() {
            tile.add(terms, i * TILE, y);
        }
    }

    /// Classifies a tile by its own pixels and those of the adjacent tiles.
    fn ask(&self, level: &RegionLevel, refined: &RefinedPlane, column: usize, row: usize, columns: usize) -> Tile {
        let own = &self.sums[row * columns + column];
        if own.own > own.pixels / 2 {
            return Tile::Serves;
        }
        if own.pixels == 0 {
            return Tile::Silent;
        }
        let mut fit = TileFit::default();
        let last_row = (self.sums.len() / columns - 1).min(row + 1);
        for y in row.saturating_sub(1)..=last_row {
            for x in column.saturating_sub(1)..=(column + 1).min(columns - 1) {
                fit.join(&self.sums[y * columns + x]);
            }
        }
        let enough = fit.count >= TILE_PX_MIN;
        let Some(found) = fit.solve().filter(|_| enough) else { return Tile::Silent };
        let away = level.full_from_level(&(fit.middle / fit.count)) - refined.plane.centre_px;
        let lever = Vector3::new(1.0, away.x, away.y);
        let variance =
            lever.dot(&(refined.covariance * lever)) + found.sigma_px * found.sigma_px + SYSTEMATIC_SIGMA_PX.powi(2);
        let expected = found.shift_px.abs() <= (SIGMAS_MAX * variance.sqrt()).min(SHIFT_MAX_PX);
        let is_clear = found.correlation >= CORRELATION_MIN && found.sigma_px <= TILE_SIGMA_MAX_PX;
        if expected && is_clear { Tile::Agrees } else { Tile::Silent }
    }

    /// Accepts agreeing tiles that touch an accepted tile.
    fn connect(&mut self, columns: usize, rows: usize) {
        loop {
            let mut changed = false;
            for row in 0..rows {
                for column in 0..columns {
                    let i = row * columns + column;
                    if self.tiles[i] != Tile::Agrees {
                        continue;
                    }
                    let serves = |at: usize| self.tiles[at] == Tile::Serves;
                    let touches = (column > 0 && serves(i - 1))
                        || (column + 1 < columns && serves(i + 1))
                        || (row > 0 && serves(i - columns))
                        || (row + 1 < rows && serves(i + columns));
                    if touches {
                        self.tiles[i] = Tile::Serves;
                        changed = true;
                    }
                }
            }
            if !changed {
                return;
            }
        }
    }
}

/// Terms of a pixel.
const TERMS: usize = 10;

/// Mapping of a left row to the right image: column `start + step x`.
#[derive(Clone, Copy, Debug)]
struct RowLine {
    start: f32,
    step: f32,
    /// Subtracted from both images; it changes only the offset between them and keeps sums small.
    middle: f32,
}

wide! {
    /// Products of gradient, left value, 1 and right value for every pixel of a row; zero for pixels not `wanted`.
    fn row_terms(left: &[f32], right: &[f32], wanted: &[u8], line: RowLine, taps: &mut [[f32; 4]],
        terms: &mut [[f32; TERMS]]) = row_terms_kernel;
}

#[inline(always)]
fn row_terms_kernel(
    left: &[f32],
    right: &[f32],
    wanted: &[u8],
    line: RowLine,
    taps: &mut [[f32; 4]],
    terms: &mut [[f32; TERMS]],
) {
    let last = right.len() as f32 - 2.0;
    for (x, taps) in taps.iter_mut().enumerate() {
        let at = line.start + line.step * x as f32;
        // Nothing beyond the ends is used.
        let first = if at >= 1.0 && at < last { at as usize - 1 } else { usize::MAX };
        match right.get(first..first.saturating_add(4)) {
            Some(four) => taps.copy_from_slice(four),
            None => *taps = [f32::NAN; 4],
        }
    }
    terms[0] = [0.0; TERMS];
    terms[left.len() - 1] = [0.0; TERMS];
    for x in 1..left.len() - 1 {
        let at = line.start + line.step * x as f32;
        let t = at - at.floor();
        let [before, here, next, after] = taps[x];
        let is_wanted = wanted[x] != 0 && !here.is_nan();
        let r = here + t * (next - here) - line.middle;
        // The change due to a shift of the right image by one column.
        let (own, other) =
            (0.5 * (left[x + 1] - left[x - 1]), 0.5 * ((next - before) * (1.0 - t) + (after - here) * t));
        let (d, l) = (0.5 * (own + other), left[x] - line.middle);
        let all = [d * d, d * l, d, l * l, l, 1.0, d * r, l * r, r, r * r];
        for k in 0..TERMS {
            terms[x][k] = if is_wanted { all[k] } else { 0.0 };
        }
    }
}

/// A typical value of the left image.
fn middle_of(level: &RegionLevel) -> f32 {
    let values = level.left.luminance().values();
    let (sum, count) = values.iter().step_by(37).fold((0.0, 0.0_f32), |(sum, count), value| (sum + value, count + 1.0));
    sum / count.max(1.0)
}

/// Sums of a tile's equations `shift * gradient + gain * left + offset = right`.
#[derive(Clone, Copy, Debug, Default)]
struct TileFit {
    matrix: Matrix3<f64>,
    slope: Vector3<f64>,
    squares: f64,
    sum: f64,
    count: f64,
    /// Sum of the positions.
    middle: Vector2<f64>,
    /// Number of pixels within reach, and number of those that belong to the region.
    pixels: usize,
    own: usize,
}

impl TileFit {
    /// Adds the terms of adjacent pixels from `x` on.
    fn add(&mut self, pixels: &[[f32; TERMS]], x: usize, y: usize) {
        let mut sum = [0.0_f32; TERMS];
        let mut columns = 0.0;
        for (i, terms) in pixels.iter().enumerate() {
            for (sum, term) in sum.iter_mut().zip(terms) {
                *sum += term;
            }
            columns += f64::from(terms[5]) * (x + i) as f64;
        }
        let [dd, dl, d, ll, l, one, dr, lr, r, rr] = sum.map(f64::from);
        self.matrix += Matrix3::new(dd, dl, d, dl, ll, l, d, l, one);
        self.slope += Vector3::new(dr, lr, r);
        self.squares += rr;
        self.sum += r;
        self.count += one;
        self.middle += Vector2::new(columns, one * y as f64);
    }

    fn join(&mut self, other: &Self) {
        self.matrix += other.matrix;
        self.slope += other.slope;
        self.squares += other.squares;
        self.sum += other.sum;
        self.count += other.count;
        self.middle += other.middle;
    }

    fn solve(&self) -> Option<TileShift> {
        let inverse = self.matrix.try_inverse()?;
        let fitted = inverse * self.slope;
        let rest = (self.squares - fitted.dot(&self.slope)).max(0.0);
        let total = self.squares - self.sum * self.sum / self.count;
        let variance = (rest / (self.count - FITTED)).max(NOISE_MIN_GREY.powi(2));
        let sigma_px = (variance * inverse[(0, 0)]).sqrt();
        let correlation = (1.0 - rest / total.max(1e-9)).max(0.0).sqrt();
        let is_sound = fitted.iter().all(|value| value.is_finite()) && sigma_px.is_finite() && fitted.y > 0.0;
        is_sound.then_some(TileShift { shift_px: fitted.x, sigma_px, correlation })
    }
}

/// Result of a tile's fit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TileShift {
    /// Shift of the right image relative to the plane, columns.
    shift_px: f64,
    /// Its standard deviation.
    sigma_px: f64,
    /// Correlation between the images after the shift.
    correlation: f64,
}

/// Whether the tilt of a refined plane is so uncertain that surroundings are worthwhile: the normal's standard deviation, as if
/// the plane faced the camera.
pub(super) fn are_wanted(refined: &RefinedPlane, geometry: &RectifiedGeometry, is_small: bool) -> bool {
    let limit_rad = if is_small { NORMAL_SIGMA_RAD } else { LARGE_NORMAL_SIGMA_RAD };
    let full = refined.plane.d0_px + geometry.disparity_offset_px;
    let variance = |k: usize, focal_px: f64| refined.covariance[(k, k)] * (focal_px / full).powi(2);
    let sigma_rad = (variance(1, geometry.focal_px.x) + variance(2, geometry.focal_px.y)).sqrt();
    refined.converged && full > 0.0 && sigma_rad > limit_rad
}

/// The plane refined with the surroundings, if it replaces the region's own: it is more accurate and consistent with the region's
/// covariance. A surface that bends away unnoticed moves it within that, so half of the squared difference of the two counts as variance.
pub(super) fn replacement(wide: RefinedPlane, own: &RefinedPlane) -> Option<RefinedPlane> {
    let gap = wide.plane.centred_at(own.plane.centre_px).parameters() - own.plane.parameters();
    let distance = own.covariance.try_inverse().map_or(f64::MAX, |inverse| gap.dot(&(inverse * gap)));
    let slopes = |refined: &RefinedPlane| refined.covariance[(1, 1)] + refined.covariance[(2, 2)];
    let replaces = wide.converged && distance <= DISTANCE_MAX && slopes(&wide) < SHRINKAGE_MAX * slopes(own);
    replaces.then(|| RefinedPlane { covariance: wide.covariance + gap * gap.transpose() * EQUAL_ERRORS, ..wide })
}

/// Adds the pixels up to `reach` columns and rows around a binary mask.
fn dilate(mask: &mut [u8], distance: &mut Vec<u8>, width: usize, reach: u8) {
    for row in mask.chunks_exact_mut(width.max(1)) {
        let (mut before, mut after) = (u8::MAX, u8::MAX);
        for pixel in row.iter_mut() {
            before = if *pixel != 0 { 0 } else { before.saturating_add(1) };
            *pixel |= u8::from(before <= reach) << 1;
        }
        for pixel in row.iter_mut().rev() {
            after = if *pixel & 1 != 0 { 0 } else { after.saturating_add(1) };
            *pixel = u8::from(after <= reach) | (*pixel >> 1);
        }
    }
    for is_upward in [false, true] {
        distance.clear();
        distance.resize(width, u8::MAX);
        let rows = mask.len() / width.max(1);
        for y in (0..rows).map(|y| if is_upward { rows - 1 - y } else { y }) {
            // Bit 0 is the mask, bit 1 the added pixels.
            for (pixel, distance) in mask[y * width..(y + 1) * width].iter_mut().zip(distance.iter_mut()) {
                *distance = if *pixel & 1 != 0 { 0 } else { distance.saturating_add(1) };
                *pixel |= u8::from(*distance <= reach) << 1;
            }
        }
    }
    for pixel in mask {
        *pixel >>= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_estimation_views::colour_planes::Wanted;
    use pb3dp_estimation_views::disparity_plane::DisparityPlane;
    use pb3dp_estimation_views::image_plane::PixelWindow;

    const TRUTH: LevelPlane = LevelPlane { a: 0.05, b: -0.03, c: 8.3, row: 0 };
    const SIZE: usize = 80;

    /// A smooth texture without symmetry.
    fn texture(x: f64, y: f64) -> f64 {
        let waves = [(0.9, 0.4, 0.3), (0.35, -0.7, 1.1), (-0.6, 0.25, 2.0), (0.15, 0.9, 0.7), (1.3, 0.8, 0.2)];
        100.0 + waves.iter().map(|(u, v, phase)| 20.0 * (u * x + v * y + phase).sin()).sum::<f64>()
    }

    /// A level with a region of 30 x 30 pixels in its centre on `TRUTH`; columns from `edge` on are `nearer` pixels nearer.
    fn level(edge: f64, nearer: f64) -> RegionLevel {
        let mut level = RegionLevel { scale: 1, ..RegionLevel::default() };
        let window = PixelWindow { x: 0, y: 0, width: SIZE, height: SIZE };
        level.left.resize(window, Wanted::Luminance);
        level.right.resize(window, Wanted::Luminance);
        for y in 0..SIZE {
            for x in 0..SIZE {
                level.left.planes[0].row_mut(y)[x] = texture(x as f64, y as f64) as f32;
                let from = |nearer: f64| (x as f64 + TRUTH.c + nearer + TRUTH.b * y as f64) / (1.0 - TRUTH.a);
                let source = if from(nearer) >= edge { from(nearer) } else { from(0.0) };
                level.right.planes[0].row_mut(y)[x] = (1.2 * texture(source, y as f64) - 15.0) as f32;
            }
        }
        level.left.flags.fill(0);
        let inside = |at: usize| (25..55).contains(&at);
        level.region = (0..SIZE * SIZE).map(|i| u8::from(inside(i % SIZE) && inside(i / SIZE))).collect();
        level.area_px = 900;
        level.reset_support();
        level
    }

    fn refined(level: &RegionLevel, slope_sigma: f64) -> RefinedPlane {
        let plane = level.full_plane(&TRUTH, Vector2::new(39.5, 39.5));
        RefinedPlane {
            plane,
            covariance: Matrix3::from_diagonal(
                &Vector3::new(0.02, slope_sigma, slope_sigma).map(|sigma| sigma * sigma),
            ),
            row_offset_px: 0.0,
            inlier_share: 1.0,
            visible_share: 1.0,
            residual_sigma: 1.0,
            gain: 1.2,
            blur_px2: 0.0,
            points: 900,
            iterations: 4,
            converged: true,
        }
    }

    /// Number of pixels added left and right of the region.
    fn added(level: &mut RegionLevel, refined: &RefinedPlane) -> (usize, usize) {
        let own = level.clone();
        let mut surroundings = Surroundings::default();
        let count = surroundings.extend(level, refined, 12, Kernels::best());
        let new = |x: usize| (0..SIZE).filter(|y| level.region[y * SIZE + x] > own.region[y * SIZE + x]).count();
        let sides = ((0..25).map(new).sum::<usize>(), (55..SIZE).map(new).sum::<usize>());
        assert_eq!(level.area_px, own.area_px + count);
        assert!(level.region.iter().zip(&level.support).all(|(region, support)| region == support));
        sides
    }

    #[test]
    fn masks_grow_by_their_reach_to_all_sides() {
        let (width, height) = (23, 17);
        let seeds = [(0, 3), (5, 9), (11, 2), (22, 16)];
        for reach in [0, 1, 4] {
            let mut mask = vec![0; width * height];
            for (x, y) in seeds {
                mask[y * width + x] = 1;
            }
            dilate(&mut mask, &mut Vec::new(), width, reach);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let near = |(u, v): &(usize, usize)| u.abs_diff(x).max(v.abs_diff(y)) <= usize::from(reach);
                assert_eq!(mask[y * width + x], u8::from(seeds.iter().any(near)), "{x} {y} by {reach}");
            }
        }
    }

    #[test]
    fn a_surface_that_goes_on_is_used_and_given_back() {
        let mut level = level(f64::MAX, 0.0);
        let refined = refined(&level, 0.003);
        // Twelve columns of 54 pixels on each side; the right window ends slightly earlier.
        let (left, right) = added(&mut level, &refined);
        assert!(left > 500 && right > 500, "{left} {right}");
    }

    #[test]
    fn another_surface_is_left_alone() {
        for nearer in [-3.0, -0.7, 0.7, 3.0] {
            let mut level = level(55.0, nearer);
            let refined = refined(&level, 0.003);
            let (left, right) = added(&mut level, &refined);
            assert!(left > 500 && right < 100, "{nearer}: {left} {right}");
        }
    }

    #[test]
    fn a_small_step_is_detected_within_the_accuracy_of_the_plane() {
        let count = |slope_sigma: f64| {
            let mut level = level(55.0, 0.25);
            let refined = refined(&level, slope_sigma);
            added(&mut level, &refined).1
        };
        assert!(count(0.0005) < 100 && count(0.01) > 200, "{} {}", count(0.0005), count(0.01));
    }

    #[test]
    fn only_what_is_consistent_and_better_known_replaces() {
        let level = level(f64::MAX, 0.0);
        let own = refined(&level, 0.003);
        let moved = |slope: f64, sigma: f64| {
            let mut wide = refined(&level, sigma);
            wide.plane.slope.x += slope;
            wide
        };
        assert!(replacement(moved(0.004, 0.001), &own).is_some());
        assert!(replacement(moved(0.012, 0.001), &own).is_none(), "too far from the region's own");
        assert!(replacement(moved(0.001, 0.0029), &own).is_none(), "no better known");
        assert!(replacement(RefinedPlane { converged: false, ..moved(0.0, 0.001) }, &own).is_none());
        // Half of the squared difference in the slope is added to the variance.
        let slope = replacement(moved(0.004, 0.001), &own).unwrap().covariance[(1, 1)];
        assert!((slope - (0.001_f64.powi(2) + 0.5 * 0.004_f64.powi(2))).abs() < 1e-12, "{slope}");
    }

    #[test]
    fn a_normal_that_is_known_needs_no_surroundings() {
        let geometry = RectifiedGeometry {
            focal_px: Vector2::new(800.0, 800.0),
            left_principal_px: Vector2::new(40.0, 40.0),
            disparity_offset_px: 30.0,
            baseline_m: 0.1,
        };
        let plane = DisparityPlane { centre_px: Vector2::zeros(), d0_px: 50.0, slope: Vector2::zeros() };
        let with = |sigma: f64| RefinedPlane { plane, ..refined(&level(f64::MAX, 0.0), sigma) };
        // 800 / (50 + 30) * sqrt(2) * sigma: 1 degree at 0.00123.
        let wanted = |slope_sigma, is_small| are_wanted(&with(slope_sigma), &geometry, is_small);
        assert!(!wanted(0.0012, true) && wanted(0.0013, true));
        assert!(!wanted(0.0024, false) && wanted(0.0026, false));
    }
}
