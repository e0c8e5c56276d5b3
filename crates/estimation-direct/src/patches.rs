//! Slanted patches: disparity correction of a plane at every pixel of the region.
//!
//! The right window is warped by the plane, so that corresponding pixels have the same coordinates. If the plane has a
//! disparity error of `e` pixels, the 15 x 15 neighbourhoods agree best after a shift by `-e / (1 - a)` columns (`a`: the
//! plane's slope along columns). The agreement is the zero-mean normalised cross-correlation for all whole shifts within a
//! reach, computed from running sums; a parabola gives the sub-pixel part.

mod closest;
mod fit;
mod kernels;
mod noise;

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::{LANES, sum_lanes, wide};
use pb3dp_estimation_views::colour_planes::ColourPlanes;
use pb3dp_estimation_views::region_pyramid::{LevelPlane, RegionLevel, is_visible};
use pb3dp_geometry::ranges;

use self::closest::Sampled;
use self::fit::{PatchVotes, fit_votes};
use self::kernels::{PeakLimits, Tally};
use self::noise::noise_grey;
use super::search::volume::LevelBox;
use crate::surface_choice::SurfaceChoice;

/// Half width of a patch: pixels from its centre to its side. Chosen: other sizes gave no improvement in the prototype of ADR 7
/// on 256 real regions.
pub const RADIUS: usize = 7;
/// Side of a patch.
pub(super) const SIDE: usize = 2 * RADIUS + 1;
/// Largest shift of a patch, columns. Chosen by hand, not varied: capacity for one more than the default of
/// [`PatchConfig::reach`].
pub const REACH_MAX: usize = 3;
/// Number of pixels of a patch.
pub(super) const PATCH_PX: f32 = (SIDE * SIDE) as f32;
/// In images with little noise texture begins at this many standard deviations of a pixel, and ... Chosen with the next one: of 1959 random
/// windows of 36 scenes 1302 have a right plane, 1254 with [`PatchConfig::texture_min`] alone, and 28 instead of 27 are wrong and `ok`.
const TEXTURE_PER_NOISE: f64 = 2.0;
/// ... not below this standard deviation of luminance: whole grey levels make 0.3 of it.
const TEXTURE_FLOOR: f64 = 0.6;
/// Patches are evaluated on every n-th row. Chosen for time: as many real cases pass as with every row.
const ROW_STEP: usize = 2;

/// Bit of [`RegionLevel::support`]: the pixel is usable, according to its patch.
pub const USABLE: u8 = 1;
/// Bit of [`RegionLevel::support`]: the pixel's patch has texture and agrees with the plane.
pub const SUPPORTS: u8 = 2;

/// Parameters of the patches.
///
/// The lowest correlation is that of the prototype of ADR 7, the support was chosen with figures (docs/benchmarks/left_out.md); the other
/// defaults are chosen by hand, not varied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchConfig {
    /// Shift of a patch to either side, columns, 1 to [`REACH_MAX`].
    pub reach: usize,
    /// Largest shift of a patch that supports the plane, pixels of the level.
    pub support_px: f64,
    /// Lowest correlation of a patch that supports the plane.
    pub correlation_min: f64,
    /// A patch with a smaller standard deviation of luminance says nothing and is ignored; in images with little noise that limit
    /// is twice the noise.
    pub texture_min: f64,
    /// Mean gradient along the row at which a patch has half the weight of a very sharp one (root mean square, luminance per
    /// pixel).
    pub gradient_half: f64,
}

impl Default for PatchConfig {
    fn default() -> Self {
        Self { reach: 2, support_px: 0.35, correlation_min: 0.5, texture_min: 2.0, gradient_half: 1.0 }
    }
}

impl PatchConfig {
    ranges! {
        pub fn validate "direct.patches.";
        reach, REACH: usize = 1..=REACH_MAX;
        support_px, SUPPORT_PX: f64 = 0.1..=2.0;
        correlation_min, CORRELATION_MIN: f64 = 0.0..=1.0;
        texture_min, TEXTURE_MIN: f64 = 0.0..=100.0;
        gradient_half, GRADIENT_HALF: f64 = 0.0..=100.0;
    }
}

/// Patch result for a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchOutcome {
    /// The plane, corrected by the supporting patches.
    pub plane: LevelPlane,
    /// Share of the region's pixels whose patch could be evaluated and has texture.
    pub textured_share: f64,
    /// Share of the textured patches that support the given plane.
    pub support_share: f64,
    /// Mean correlation of the supporting patches at the given plane; 0 if there are none.
    pub mean_correlation: f64,
}

/// Evaluates patches; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct SlantedPatches {
    left: Vec<f32>,
    gradient: Vec<f32>,
    warped: Vec<f32>,
    rows: kernels::Rows,
    votes: PatchVotes,
    sampled: Sampled,
    differences: Vec<f32>,
    /// The last evaluated plane.
    given: Option<LevelPlane>,
}

impl SlantedPatches {
    /// Evaluates all patches for `plane` and fits a better plane. Writes into `level.support` which pixels of the region agree
    /// with `plane` or cannot be evaluated.
    pub fn run(
        &mut self,
        level: &mut RegionLevel,
        plane: &LevelPlane,
        config: &PatchConfig,
        kernels: Kernels,
    ) -> PatchOutcome {
        let area = patch_box(level);
        let reach = config.reach.clamp(1, REACH_MAX);
        self.given = None;
        if area.width < SIDE || area.height < SIDE || level.right.window.width < 4 {
            level.reset_support();
            return Tally::default().outcome(level.area_px, *plane);
        }
        self.load(level, &area, plane, reach, kernels);
        let of_noise = noise_grey(level, &mut self.differences)
            .map_or(f64::INFINITY, |noise| TEXTURE_PER_NOISE * f64::from(noise));
        let config = &PatchConfig { texture_min: config.texture_min.min(of_noise.max(TEXTURE_FLOOR)), ..*config };
        self.votes.clear();
        self.sampled.start(level.area_px, ROW_STEP);
        self.given = Some(*plane);
        level.support.fill(0);
        let mut tally = Tally::default();
        self.rows.start(area.width, reach);
        for y in 0..area.height {
            self.rows.advance(y, area.width, &self.left, &self.gradient, &self.warped, kernels);
            if y + 1 >= SIDE && (y + 1 - SIDE).is_multiple_of(ROW_STEP) {
                self.rows.peaks(config, kernels);
                self.judge_rows(level, &area, area.y + y - RADIUS, config, &mut tally, kernels);
            }
        }
        keep_unseen_pixels(level, &area);
        let correction = fit_votes(&mut self.votes, config.support_px, kernels);
        tally.outcome(level.area_px, corrected(plane, correction))
    }

    /// A plane that clearly more patches of the last run fit closely than the plane given there; `None` if there is none.
    pub fn closest_plane(&mut self, choice: &SurfaceChoice, kernels: Kernels) -> Option<LevelPlane> {
        let given = self.given?;
        Some(corrected(&given, Some(self.sampled.closest(choice, kernels)?)))
    }

    /// Root mean square of the relief that the patches of the last run show, pixels of the level; 0 if they show none.
    pub fn relief_px(&mut self) -> f64 {
        self.sampled.relief_px()
    }

    /// Writes the result of one row of patches for that row and the next.
    fn judge_rows(
        &mut self,
        level: &mut RegionLevel,
        area: &LevelBox,
        row: usize,
        config: &PatchConfig,
        tally: &mut Tally<f64>,
        kernels: Kernels,
    ) {
        let (stride, first) = (level.left.window.width, area.x + RADIUS);
        let (count, end) = (area.width - 2 * RADIUS, area.y + area.height - RADIUS);
        let limits = PeakLimits { shift_px: config.support_px as f32, correlation: config.correlation_min as f32 };
        self.rows.judge(limits, kernels);
        for row_here in row..(row + ROW_STEP).min(end) {
            let range = row_here * stride + first..row_here * stride + first + count;
            let (inside, support) = (&level.region[range.clone()], &mut level.support[range]);
            *tally += self.rows.spread_row(inside, support, kernels);
        }
        let inside = &level.region[row * stride + first..][..count];
        let peaks = self.rows.peaks_found();
        self.votes.extend_row(first, row, inside, peaks.offset, peaks.weight);
        if self.sampled.takes_row(row - area.y - RADIUS) {
            let limits = PeakLimits { shift_px: config.reach.clamp(1, REACH_MAX) as f32, ..limits };
            self.sampled.take_row(first, row, inside, peaks, limits);
        }
    }

    /// Copies the left window's part and warps the right window onto it, `reach` columns wider on both sides.
    fn load(&mut self, level: &RegionLevel, area: &LevelBox, plane: &LevelPlane, reach: usize, kernels: Kernels) {
        let (width, wide) = (area.width, area.width + 2 * reach);
        self.left.resize(width * area.height, 0.0);
        self.gradient.resize(width * area.height, 0.0);
        self.warped.resize(wide * area.height, 0.0);
        let source = level.left.luminance();
        let mean = mean_of(&level.left, area);
        for y in 0..area.height {
            let row = &source.row(area.y + y)[area.x..area.x + width];
            let here = y * width..(y + 1) * width;
            centre_row(kernels, row, mean, &mut self.left[here.clone()], &mut self.gradient[here]);
            let out = &mut self.warped[y * wide..(y + 1) * wide];
            warp_row(&level.right, area, y, plane, reach, mean, kernels, out);
        }
    }
}

wide! {
    fn centre_row(row: &[f32], mean: f32, left: &mut [f32], gradient: &mut [f32]) = centre_row_kernel;
}

/// Values minus the mean, and gradients along the row (0 at its ends).
#[inline(always)]
fn centre_row_kernel(row: &[f32], mean: f32, left: &mut [f32], gradient: &mut [f32]) {
    let width = row.len();
    for (out, value) in left.iter_mut().zip(row) {
        *out = value - mean;
    }
    gradient[0] = 0.0;
    gradient[width - 1] = 0.0;
    for ((out, before), after) in gradient[1..width - 1].iter_mut().zip(row).zip(&row[2..]) {
        *out = 0.5 * (after - before);
    }
}

/// The plane with its disparity increased by `correction.0 + correction.1 x + correction.2 y` columns of shift.
fn corrected(plane: &LevelPlane, correction: Option<[f64; 3]>) -> LevelPlane {
    let Some(shift) = correction else { return *plane };
    // A shift by k columns of the warped image is a change of disparity by -k (1 - a).
    let factor = -(1.0 - plane.a);
    LevelPlane {
        a: plane.a + factor * shift[1],
        b: plane.b + factor * shift[2],
        c: plane.c + factor * shift[0],
        row: plane.row,
    }
}

/// Columns of the right image at the positions of one row, cubic; the border is replicated.
#[allow(clippy::too_many_arguments, reason = "a kernel takes its buffers and settings one by one")]
fn warp_row(
    right: &ColourPlanes,
    area: &LevelBox,
    y: usize,
    plane: &LevelPlane,
    reach: usize,
    mean: f32,
    kernels: Kernels,
    out: &mut [f32],
) {
    let y_left = (area.y + y) as f64;
    let row = (y_left as i64 + i64::from(plane.row)).clamp(0, right.window.height as i64 - 1) as usize;
    let source = right.luminance().row(row);
    let first_x = area.x as f64 - reach as f64;
    let start = (first_x - (plane.c + plane.a * first_x + plane.b * y_left)) as f32;
    let step = (1.0 - plane.a) as f32;
    warp_places(kernels, source, start, step, mean, out);
}

wide! {
    fn warp_places(source: &[f32], start: f32, step: f32, mean: f32, out: &mut [f32]) = warp_places_kernel;
}

/// Values at the positions `start`, `start + step`, ... minus the mean.
#[inline(always)]
fn warp_places_kernel(source: &[f32], start: f32, step: f32, mean: f32, out: &mut [f32]) {
    // Within a group, positions deviate by less than a pixel from one column per column.
    match (step - 1.0).abs() {
        drift if drift < 1.0 / 16.0 => warp_groups::<16>(source, start, step, mean, out),
        drift if drift < 1.0 / 8.0 => warp_groups::<8>(source, start, step, mean, out),
        drift if drift < 1.0 / 4.0 => warp_groups::<4>(source, start, step, mean, out),
        _ => warp_groups::<1>(source, start, step, mean, out),
    }
}

/// In groups of `G` positions: the four neighbours of each begin at one of two columns.
#[inline(always)]
fn warp_groups<const G: usize>(source: &[f32], start: f32, step: f32, mean: f32, out: &mut [f32]) {
    let (drift, last) = (step - 1.0, source.len() as f32 - 1.0);
    let mut first = 0;
    while first < out.len() {
        // The last group may overlap the previous one.
        let k = first.min(out.len().saturating_sub(G));
        let from = start + step * k as f32;
        let low = from.min(from + drift * (G - 1) as f32).floor();
        if G > out.len() || !(low >= 1.0 && low + G as f32 + 2.0 <= last) {
            out[first] = value_at(source, start + step * first as f32) - mean;
            first += 1;
            continue;
        }
        let base = low as usize - 1;
        let near: [&[f32; G]; 5] = std::array::from_fn(|j| source[base + j..].first_chunk().unwrap_or(&[0.0; G]));
        let out: &mut [f32] = &mut out[k..k + G];
        let t = from - low;
        for i in 0..G {
            let place = t + drift * i as f32;
            let is_next = place >= 1.0;
            let values = near.map(|near| near[i]);
            let four: [f32; 4] = std::array::from_fn(|j| if is_next { values[j + 1] } else { values[j] });
            out[i] = cubic(four, if is_next { place - 1.0 } else { place }) - mean;
        }
        first = k + G;
    }
}

/// Cubic interpolation at `t` after the second of four neighbours (Keys 1981, a = -1/2).
#[inline(always)]
fn cubic([a, b, c, d]: [f32; 4], t: f32) -> f32 {
    let (p, q) = (c - a, 2.0 * a - 5.0 * b + 4.0 * c - d);
    b + 0.5 * t * (p + t * (q + t * (3.0 * (b - c) + d - a)))
}

/// The interpolated value at any position of a row.
#[inline(always)]
fn value_at(source: &[f32], at: f32) -> f32 {
    let floor = at.floor();
    match source.get((floor as usize).wrapping_sub(1)..).and_then(|rest| rest.first_chunk()) {
        Some(four) if floor >= 1.0 => cubic(*four, at - floor),
        _ => border_value(source, at),
    }
}

/// Linear interpolation near the ends of a row; the last values are replicated.
fn border_value(source: &[f32], at: f32) -> f32 {
    let last = source.len() - 1;
    let at = at.clamp(0.0, last as f32);
    let floor = (at as usize).min(last.saturating_sub(1));
    let next = source[(floor + 1).min(last)];
    source[floor] + (at - floor as f32) * (next - source[floor])
}

/// The region's box, enlarged by a patch's radius where the window allows it.
fn patch_box(level: &RegionLevel) -> LevelBox {
    super::search::region_box(level, RADIUS)
}

fn mean_of(side: &ColourPlanes, area: &LevelBox) -> f32 {
    let rows = (area.y..area.y + area.height).step_by(4);
    let (mut sums, mut count) = ([0.0_f32; LANES], 0);
    for y in rows {
        let (groups, rest) = side.luminance().row(y)[area.x..area.x + area.width].as_chunks::<LANES>();
        for group in groups {
            for i in 0..LANES {
                sums[i] += group[i];
            }
        }
        sums[0] += rest.iter().sum::<f32>();
        count += area.width;
    }
    sum_lanes(&sums) / count.max(1) as f32
}

/// Pixels too close to the window's border for a patch stay usable.
fn keep_unseen_pixels(level: &mut RegionLevel, area: &LevelBox) {
    let width = level.left.window.width;
    let columns = area.x + RADIUS..area.x + area.width - RADIUS.min(area.width);
    let rows = area.y + RADIUS..area.y + area.height - RADIUS.min(area.height);
    let pixels = level.support.chunks_exact_mut(width).zip(level.region.chunks_exact(width));
    for (y, ((support, region), flags)) in pixels.zip(level.left.flags.chunks_exact(width)).enumerate() {
        let judged = if rows.contains(&y) { columns.clone() } else { 0..0 };
        for part in [0..judged.start, judged.end..width] {
            for (support, region) in support[part.clone()].iter_mut().zip(&region[part]) {
                *support = region * USABLE;
            }
        }
        for (support, flags) in support.iter_mut().zip(flags) {
            *support = if is_visible(*flags) { *support } else { 0 };
        }
    }
}

impl Tally<f64> {
    fn outcome(&self, area_px: usize, plane: LevelPlane) -> PatchOutcome {
        PatchOutcome {
            plane,
            textured_share: self.textured / area_px.max(1) as f64,
            support_share: self.supporting / self.textured.max(1.0),
            mean_correlation: self.correlation / self.supporting.max(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_estimation_views::colour_planes::Wanted;
    use pb3dp_estimation_views::image_plane::PixelWindow;

    const TRUTH: LevelPlane = LevelPlane { a: 0.06, b: -0.03, c: 9.3, row: 0 };

    /// A smooth texture without symmetry.
    fn texture(x: f64, y: f64) -> f64 {
        let waves = [(0.9, 0.4, 0.3), (0.35, -0.7, 1.1), (-0.6, 0.25, 2.0), (0.15, 0.9, 0.7), (1.3, 0.8, 0.2)];
        100.0 + waves.iter().map(|(u, v, phase)| 20.0 * (u * x + v * y + phase).sin()).sum::<f64>()
    }

    /// A level of 70 x 50 pixels whose right image shows the texture through `TRUTH`, except for columns from `edge` on, which
    /// are 4 pixels nearer.
    fn level(edge: f64) -> RegionLevel {
        let mut level = RegionLevel { scale: 1, ..RegionLevel::default() };
        let window = PixelWindow { x: 0, y: 0, width: 70, height: 50 };
        level.left.resize(window, Wanted::Luminance);
        level.right.resize(window, Wanted::Luminance);
        for y in 0..50 {
            for x in 0..70 {
                level.left.planes[0].row_mut(y)[x] = texture(x as f64, y as f64) as f32;
                // The left column that corresponds to this right column: x_left - (c + a x_left + b y) = x.
                let from = |nearer: f64| (x as f64 + TRUTH.c + nearer + TRUTH.b * y as f64) / (1.0 - TRUTH.a);
                let source = if from(4.0) >= edge { from(4.0) } else { from(0.0) };
                level.right.planes[0].row_mut(y)[x] = (1.2 * texture(source, y as f64) - 15.0) as f32;
            }
        }
        level.left.flags.fill(0);
        level.region = (0..70 * 50).map(|i| u8::from(i % 70 >= 22 && (8..42).contains(&(i / 70)))).collect();
        level.area_px = level.region.iter().map(|&inside| usize::from(inside)).sum();
        level.reset_support();
        level
    }

    #[test]
    fn a_plane_that_is_a_little_off_is_put_right_with_every_kernel() {
        let start = LevelPlane { a: 0.05, b: -0.025, c: 9.6, row: 0 };
        let mut bits = Vec::new();
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let (mut level, mut patches) = (level(f64::MAX), SlantedPatches::default());
            let config = PatchConfig { support_px: 1.5, ..PatchConfig::default() };
            let first = patches.run(&mut level, &start, &config, kernels);
            let second = patches.run(&mut level, &first.plane, &config, kernels);
            let found = second.plane;
            for (x, y) in [(25.0, 10.0), (65.0, 10.0), (25.0, 40.0), (65.0, 40.0)] {
                let gap = (found.c - TRUTH.c) + (found.a - TRUTH.a) * x + (found.b - TRUTH.b) * y;
                assert!(gap.abs() < 0.03, "{gap} at {x} {y}: {found:?}");
            }
            assert!(second.support_share > 0.98 && second.mean_correlation > 0.98, "{second:?}");
            bits.push([found.a.to_bits(), found.b.to_bits(), found.c.to_bits()]);
        }
        assert!(bits.windows(2).all(|pair| pair[0] == pair[1]), "kernels differ: {bits:?}");
    }

    #[test]
    fn pixels_of_another_surface_do_not_support_the_plane() {
        let (mut level, mut patches) = (level(48.0), SlantedPatches::default());
        let outcome = patches.run(&mut level, &TRUTH, &PatchConfig::default(), Kernels::best());
        let at = |x: usize, y: usize| level.support[y * 70 + x];
        assert_eq!(at(32, 25), USABLE | SUPPORTS);
        assert_eq!(at(58, 25), 0);
        assert!((0.3..0.7).contains(&outcome.support_share), "{outcome:?}");
        let gap = outcome.plane.c - TRUTH.c + (outcome.plane.a - TRUTH.a) * 35.0 + (outcome.plane.b - TRUTH.b) * 25.0;
        assert!(gap.abs() < 0.1, "{gap}");
    }

    #[test]
    fn without_texture_nothing_supports_and_everything_is_usable() {
        let (mut level, mut patches) = (level(f64::MAX), SlantedPatches::default());
        level.left.planes[0].values_mut().fill(77.0);
        let outcome = patches.run(&mut level, &TRUTH, &PatchConfig::default(), Kernels::best());
        assert_eq!((outcome.textured_share, outcome.support_share, outcome.plane), (0.0, 0.0, TRUTH));
        assert!(level.support.iter().zip(&level.region).all(|(support, region)| *support == region * USABLE));
    }

    /// Texture that is fainter than the limit is seen where there is little noise, and noise alone is no texture.
    #[test]
    fn faint_texture_supports_where_noise_does_not() {
        let found = |texture: f32, noise: f64| {
            let (mut level, mut random) = (level(f64::MAX), pb3dp_estimation_core::rng::SplitMix64::new(5));
            for side in [&mut level.left, &mut level.right] {
                for value in side.planes[0].values_mut() {
                    *value = 100.0 + texture * (*value - 100.0) + (noise * random.normal()) as f32;
                }
            }
            SlantedPatches::default().run(&mut level, &TRUTH, &PatchConfig::default(), Kernels::best())
        };
        let faint = found(0.03, 0.05);
        assert!(faint.textured_share > 0.8 && faint.support_share > 0.9, "{faint:?}");
        assert!(found(0.03, 0.9).textured_share < 0.1);
        assert!(found(0.0, 0.9).textured_share < 0.1);
    }

    #[test]
    fn regions_smaller_than_a_patch_say_nothing() {
        let mut level = level(f64::MAX);
        level.left.resize(PixelWindow { x: 0, y: 0, width: 12, height: 9 }, Wanted::Luminance);
        level.region = vec![1; 12 * 9];
        level.area_px = 12 * 9;
        level.reset_support();
        let outcome = SlantedPatches::default().run(&mut level, &TRUTH, &PatchConfig::default(), Kernels::best());
        assert_eq!((outcome.textured_share, outcome.plane), (0.0, TRUTH));
    }
}
