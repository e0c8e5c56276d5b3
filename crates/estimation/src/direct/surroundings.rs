//! What lies around a small region, where it goes on in the region's plane.
//!
//! A region of 30 pixels has a short lever for its tilt, and often its surface goes on beyond the outline. So the pixels
//! around it are cut into tiles, and every tile is asked how far the right eye is off the plane that the region alone has
//! given. A tile serves if both eyes agree there, if its shift is no larger than the covariance of the region's plane and the
//! tile's own noise allow, and if it touches the region or another tile that serves. The plane is then refined on both
//! together, and replaces the region's own where the two are consistent.
//!
//! A tile may belong to another object that lies in the same plane at this moment; for the plane of this pair that is right.
//! The region, its support and what a tracker makes of them stay as they were.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::disparity_plane::RectifiedGeometry;
use super::patches::USABLE;
use super::photometric::RefinedPlane;
use super::region_pyramid::{LevelPlane, RegionLevel};

/// Regions with more pixels have lever enough.
pub(super) const AREA_MAX_PX: usize = 2500;
/// Farthest that the surroundings reach, pixels.
pub(super) const REACH_MAX_PX: usize = 16;
/// So much farther must the windows reach, for filters and gradients.
pub(super) const MARGIN_PX: usize = 8;
/// A normal with a smaller standard deviation needs no help, radians (1 degree).
const NORMAL_SIGMA_RAD: f64 = 0.0175;
/// Side of a tile, pixels.
const TILE: usize = 4;
/// Fewest pixels of a tile that are asked.
const TILE_PX_MIN: f64 = 48.0;
/// Lowest correlation of a tile that serves.
const CORRELATION_MIN: f64 = 0.8;
/// A tile's shift is no larger than so many standard deviations of what is expected, and than this, pixels.
const SIGMAS_MAX: f64 = 2.0;
const SHIFT_MAX_PX: f64 = 0.3;
/// Standard deviation of a tile's shift that is no noise of pixels (interpolation, shading, relief), pixels.
const SYSTEMATIC_SIGMA_PX: f64 = 0.05;
/// A tile whose shift is known no better than this says nothing, pixels.
const TILE_SIGMA_MAX_PX: f64 = 0.3;
/// Residuals of a tile are not taken to be better than this, grey levels.
const NOISE_MIN_GREY: f64 = 1.0;
/// Parameters of a tile's fit: shift, gain, offset.
const FITTED: f64 = 3.0;
/// Largest squared distance of the new plane from the region's own, in standard deviations of the latter: 95 % of the
/// chi-squared distribution of three degrees of freedom.
const DISTANCE_MAX: f64 = 7.81;
/// The slopes' variance must shrink to this.
const SHRINKAGE_MAX: f64 = 0.7;

/// Finds what goes on around a region; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Surroundings {
    region: Vec<u8>,
    support: Vec<u8>,
    area_px: usize,
    reached: Vec<u8>,
    scratch: Vec<u8>,
    sums: Vec<TileFit>,
    tiles: Vec<Tile>,
}

/// How a tile stands to the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Tile {
    /// Outside, or nothing to say.
    #[default]
    Silent,
    /// Agrees, but is not connected yet.
    Agrees,
    /// Part of the region, or connected with it.
    Serves,
}

impl Surroundings {
    /// Adds to the region and support of a level of full size what agrees with `refined` up to `reach` pixels around it.
    /// Returns the number of pixels added; [`Self::restore`] takes them away again.
    pub fn extend(&mut self, level: &mut RegionLevel, refined: &RefinedPlane, reach: usize) -> usize {
        self.region.clone_from(&level.region);
        self.support.clone_from(&level.support);
        self.area_px = level.area_px;
        let (width, height) = (level.left.window.width, level.left.window.height);
        self.reached.clone_from(&level.region);
        for _ in 0..reach {
            dilate(&mut self.reached, &mut self.scratch, width, height);
        }
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let plane = level.level_plane(&refined.plane);
        self.sums.clear();
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let sum = self.sum(level, &plane, (column * TILE, row * TILE));
            self.sums.push(sum);
        }
        self.tiles.clear();
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let tile = self.ask(level, refined, (column, row), columns);
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

    /// Gives `level` its own region and support back.
    pub fn restore(&self, level: &mut RegionLevel) {
        level.region.clone_from(&self.region);
        level.support.clone_from(&self.support);
        level.area_px = self.area_px;
    }

    /// What the pixels of a tile have to say.
    fn sum(&self, level: &RegionLevel, plane: &LevelPlane, (x0, y0): (usize, usize)) -> TileFit {
        let (width, height) = (level.left.window.width, level.left.window.height);
        let mut fit = TileFit::default();
        for y in y0..(y0 + TILE).min(height) {
            for x in x0..(x0 + TILE).min(width) {
                let i = y * width + x;
                if self.reached[i] != 0 {
                    fit.own += usize::from(level.region[i]);
                    fit.pixels += 1;
                    if x > 0 && x + 1 < width {
                        fit.add(level, plane, x, y);
                    }
                }
            }
        }
        fit
    }

    /// Judges a tile by its own pixels and those of the tiles around it.
    fn ask(&self, level: &RegionLevel, refined: &RefinedPlane, (column, row): (usize, usize), columns: usize) -> Tile {
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

    /// Lets tiles serve that agree and touch one that serves.
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

/// Sums of a tile's equations `shift * gradient + gain * left + offset = right`.
#[derive(Clone, Copy, Debug, Default)]
struct TileFit {
    matrix: Matrix3<f64>,
    slope: Vector3<f64>,
    squares: f64,
    sum: f64,
    count: f64,
    /// Sum of the places.
    middle: Vector2<f64>,
    /// Pixels within reach, and those of them that belong to the region.
    pixels: usize,
    own: usize,
}

impl TileFit {
    fn add(&mut self, level: &RegionLevel, plane: &LevelPlane, x: usize, y: usize) {
        let row = y as i64 + i64::from(plane.row);
        if row < 0 || row >= level.right.window.height as i64 || level.left.flags[y * level.left.window.width + x] != 0
        {
            return;
        }
        let at = x as f64 - (plane.c + plane.a * x as f64 + plane.b * y as f64);
        let source = level.right.luminance().row(row as usize);
        if !(at >= 1.0 && at < source.len() as f64 - 2.0) {
            return;
        }
        let left = level.left.luminance().row(y);
        let floor = at as usize;
        let (t, b) = ((at - floor as f64) as f32, source[floor]);
        let right = f64::from(b + t * (source[floor + 1] - b));
        // What a shift of the right eye by one column adds.
        let own = f64::from(left[x + 1] - left[x - 1]) * 0.5;
        let other = f64::from((source[floor + 1] - source[floor - 1]) * (1.0 - t) + (source[floor + 2] - b) * t) * 0.5;
        let terms = Vector3::new(0.5 * (own + other), f64::from(left[x]), 1.0);
        self.matrix += terms * terms.transpose();
        self.slope += terms * right;
        self.squares += right * right;
        self.sum += right;
        self.count += 1.0;
        self.middle += Vector2::new(x as f64, y as f64);
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

/// What a tile says.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TileShift {
    /// Columns that the right eye is off the plane.
    shift_px: f64,
    /// Its standard deviation.
    sigma_px: f64,
    /// Correlation between the eyes after the shift.
    correlation: f64,
}

/// Whether a refined plane is so uncertain in its tilt that surroundings are worth while: the normal's standard deviation, as
/// if the plane faced the camera.
pub(super) fn are_wanted(refined: &RefinedPlane, geometry: &RectifiedGeometry) -> bool {
    let full = refined.plane.d0_px + geometry.disparity_offset_px;
    let variance = |k: usize, focal_px: f64| refined.covariance[(k, k)] * (focal_px / full).powi(2);
    let sigma_rad = (variance(1, geometry.focal_px.x) + variance(2, geometry.focal_px.y)).sqrt();
    refined.converged && full > 0.0 && sigma_rad > NORMAL_SIGMA_RAD
}

/// Whether a plane that was refined with the surroundings is to replace the region's own: it is better known, and where the
/// region's own covariance allows it to be.
pub(super) fn replaces(wide: &RefinedPlane, own: &RefinedPlane) -> bool {
    let gap = wide.plane.centred_at(own.plane.centre_px).parameters() - own.plane.parameters();
    let distance = own.covariance.try_inverse().map_or(f64::MAX, |inverse| gap.dot(&(inverse * gap)));
    let slopes = |refined: &RefinedPlane| refined.covariance[(1, 1)] + refined.covariance[(2, 2)];
    wide.converged && distance <= DISTANCE_MAX && slopes(wide) < SHRINKAGE_MAX * slopes(own)
}

/// Adds the pixels around a mask.
fn dilate(mask: &mut [u8], scratch: &mut Vec<u8>, width: usize, height: usize) {
    scratch.clear();
    scratch.extend_from_slice(mask);
    for y in 0..height {
        let row = &mut scratch[y * width..(y + 1) * width];
        let old = &mask[y * width..(y + 1) * width];
        for x in 0..width {
            row[x] = old[x] | old[x.saturating_sub(1)] | old[(x + 1).min(width - 1)];
        }
    }
    for y in 0..height {
        for x in 0..width {
            let at = |y: usize| scratch[y * width + x];
            mask[y * width + x] = at(y) | at(y.saturating_sub(1)) | at((y + 1).min(height - 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::colour_planes::Wanted;
    use crate::direct::disparity_plane::DisparityPlane;
    use crate::direct::image_plane::PixelWindow;

    const TRUTH: LevelPlane = LevelPlane { a: 0.05, b: -0.03, c: 8.3, row: 0 };
    const SIZE: usize = 80;

    /// A smooth texture without symmetry.
    fn texture(x: f64, y: f64) -> f64 {
        let waves = [(0.9, 0.4, 0.3), (0.35, -0.7, 1.1), (-0.6, 0.25, 2.0), (0.15, 0.9, 0.7), (1.3, 0.8, 0.2)];
        100.0 + waves.iter().map(|(u, v, phase)| 20.0 * (u * x + v * y + phase).sin()).sum::<f64>()
    }

    /// A level with a region of 30 x 30 pixels in its middle on `TRUTH`; columns from `edge` on are `nearer` pixels nearer.
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
            seen_share: 1.0,
            residual_sigma: 1.0,
            gain: 1.2,
            blur_px2: 0.0,
            points: 900,
            iterations: 4,
            converged: true,
        }
    }

    /// Pixels added left and right of the region.
    fn added(level: &mut RegionLevel, refined: &RefinedPlane) -> (usize, usize) {
        let own = level.clone();
        let mut surroundings = Surroundings::default();
        let count = surroundings.extend(level, refined, 12);
        let new = |x: usize| (0..SIZE).filter(|y| level.region[y * SIZE + x] > own.region[y * SIZE + x]).count();
        let sides = ((0..25).map(new).sum::<usize>(), (55..SIZE).map(new).sum::<usize>());
        assert_eq!(level.area_px, own.area_px + count);
        assert!(level.region.iter().zip(&level.support).all(|(region, support)| region == support));
        surroundings.restore(level);
        assert!(level.region == own.region && level.support == own.support && level.area_px == own.area_px);
        sides
    }

    #[test]
    fn a_surface_that_goes_on_is_used_and_given_back() {
        let mut level = level(f64::MAX, 0.0);
        let refined = refined(&level, 0.003);
        // Twelve columns of 54 pixels on each side; the right window ends a little earlier.
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
    fn a_small_step_is_seen_as_far_as_the_plane_is_known() {
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
        assert!(replaces(&moved(0.004, 0.001), &own));
        assert!(!replaces(&moved(0.012, 0.001), &own), "too far from the region's own");
        assert!(!replaces(&moved(0.001, 0.0029), &own), "no better known");
        assert!(!replaces(&RefinedPlane { converged: false, ..moved(0.0, 0.001) }, &own));
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
        assert!(!are_wanted(&with(0.0012), &geometry) && are_wanted(&with(0.0013), &geometry));
    }
}
