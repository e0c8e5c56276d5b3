//! Plane search: from the whole depth range to a few candidate planes, on one level of the pyramid.

pub mod aggregate;
pub mod continued;
pub mod hypotheses;
pub mod volume;

use std::ops::RangeInclusive;

use nalgebra::{Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;
use pb3dp_estimation_views::disparity_plane::DisparityRange;
use pb3dp_estimation_views::region_pyramid::{LevelPlane, RegionLevel};
use pb3dp_geometry::ranges;

use self::aggregate::{Aggregation, Penalties, WinnerRules};
use self::continued::{Continuation, ContinuedSurface};
use self::hypotheses::{
    Candidate, DisparityPoints, HypothesisRules, HypothesisSearch, PlaneCoefficients, inlier_share,
};
use self::volume::{COST_NEUTRAL, CostVolume, LevelBox};
use crate::surface_choice::SurfaceChoice;

/// Noise of a pixel in the normalisation of neighbourhoods, luminance: default of `direct.search.noise_grey`. Chosen by hand, not
/// varied: with less, blank neighbourhoods agree by chance; with more, faint texture agrees with nothing.
pub(super) const NOISE_GREY: f32 = 2.0;
/// Margin around the region's box that takes part in the aggregation, pixels. Chosen by hand, not varied: paths begin
/// outside the region; time grows with it.
const MARGIN: usize = 2;
/// A pixel is on a plane within this disparity, pixels of the level.
const ON_PLANE_PX: f32 = 1.0;
/// It says so if it matches worse at this distance from the plane, pixels of the level, ...
const APART_PX: f32 = 2.0;
/// ... by this part of [`COST_NEUTRAL`]. Chosen with `agreement_min`; with 8 and 16 the same choice answers fewer.
const CLEARLY: u8 = 4;

/// What single pixels say of a plane, as shares of the region's pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelShares {
    /// Pixels that match on the plane, and worse beside it.
    pub on_plane: f64,
    /// Pixels that match elsewhere, and worse on the plane.
    pub elsewhere: f64,
}

/// Parameters of the search.
///
/// Penalties, tolerance, number kept and steps are those of the prototype of ADR 7, in which other penalties and more draws gave
/// no improvement on 256 real regions. The other defaults are chosen by hand, not varied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneSearchConfig {
    /// Noise term of a pixel in the normalisation of neighbourhoods, luminance.
    pub noise: f64,
    /// Costs of changes of disparity; a pixel without agreement costs 63.
    pub penalties: Penalties,
    /// Acceptance rules for a disparity.
    pub winner: WinnerRules,
    /// Rules for drawing planes.
    pub hypotheses: HypothesisRules,
    /// A plane moved along the rows becomes a seed if the region agrees with it by this share of the best. With more, aliases
    /// are missed; with less, more seeds take time.
    pub alias_share: f64,
}

impl Default for PlaneSearchConfig {
    fn default() -> Self {
        Self {
            noise: f64::from(NOISE_GREY),
            penalties: Penalties { small: 8, large: 40 },
            winner: WinnerRules { uniqueness: 0.05, left_right_max: 1 },
            hypotheses: HypothesisRules { draws: 300, tolerance_px: 0.5, distinct_px: 1.0, kept: 6, steps: 3 },
            alias_share: 0.5,
        }
    }
}

impl PlaneSearchConfig {
    ranges! {
        fn check_ranges "direct.search.";
        noise, NOISE: f64 = 0.1..=50.0;
    }

    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), ranges::OutOfRange> {
        let Penalties { small, large } = self.penalties;
        self.check_ranges()?;
        ranges::check_range("direct.search.penalty_large", large, 1..=120)?;
        ranges::check_range("direct.search.penalty_small", small, 0..=large)?;
        self.hypotheses.validate()
    }
}

impl HypothesisRules {
    ranges! {
        fn validate "direct.search.";
        draws, DRAWS: usize = 1..=100_000;
        tolerance_px, TOLERANCE_PX: f64 = 0.1..=5.0;
    }
}

/// A candidate plane in pixels of the searched level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneCandidate {
    /// The plane.
    pub plane: LevelPlane,
    /// Soft share of the region's clear disparities on the plane.
    pub share: f64,
}

/// Searches planes; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct PlaneSearch {
    volume: CostVolume,
    aggregation: Aggregation,
    points: DisparityPoints,
    hypotheses: HypothesisSearch,
    continuation: Continuation,
    seeds: Vec<PlaneCoefficients>,
    histogram: Vec<u32>,
    column: Vec<u32>,
    row_sums: Vec<u16>,
    /// The candidates, best first.
    pub candidates: Vec<PlaneCandidate>,
    /// Share of the region's pixels that have a clear disparity.
    pub valid_share: f64,
}

/// The disparities of all pixels of a box around the region.
#[derive(Clone, Copy, Debug)]
pub struct Disparities<'a> {
    /// The box, pixels of the left window.
    pub area: LevelBox,
    /// Added to a disparity it gives that of the level.
    pub first: i32,
    /// Row by row, pixels of the level; NaN where there is no clear one.
    pub values: &'a [f32],
}

impl PlaneSearch {
    /// The disparities of the last search.
    pub fn disparities(&self) -> Disparities<'_> {
        Disparities { area: self.volume.area, first: self.volume.first, values: &self.aggregation.disparity }
    }

    /// Searches the disparities `range_px` (full size) on `level`. `allowed` checks a plane's tilt against the range.
    pub fn run(
        &mut self,
        level: &RegionLevel,
        range_px: DisparityRange,
        config: &PlaneSearchConfig,
        allowed: impl Fn(&LevelPlane) -> bool,
        kernels: Kernels,
    ) {
        if self.match_pixels(level, range_px, config, kernels) {
            self.find_planes(level, config, allowed, kernels);
        }
    }

    /// First half of [`Self::run`]: finds the clear disparities; `false` if the right window shows none of the range.
    pub fn match_pixels(
        &mut self,
        level: &RegionLevel,
        range_px: DisparityRange,
        config: &PlaneSearchConfig,
        kernels: Kernels,
    ) -> bool {
        let area = region_box(level, MARGIN);
        let scale = level.scale as f64;
        self.candidates.clear();
        self.valid_share = 0.0;
        let range = (range_px.lowest / scale).floor() as i32..=(range_px.highest / scale).ceil() as i32;
        let Some(range) = visible(level, &range) else { return false };
        self.volume.compute(level, area, range, config.noise as f32, kernels);
        self.aggregation.run(&self.volume, config.penalties, config.winner, kernels);
        self.collect(level, area);
        true
    }

    /// Whether at least `share` of the clear disparities lie on one plane. If they do, the probability of a negative answer is
    /// less than one in a million.
    pub fn has_plane(
        &mut self,
        level: &RegionLevel,
        config: &PlaneSearchConfig,
        share: f64,
        allowed: impl Fn(&LevelPlane) -> bool,
        kernels: Kernels,
    ) -> bool {
        let size = Vector2::new(self.volume.area.width as f64, self.volume.area.height as f64);
        // Probability that all of three points lie on it.
        let misses = 1e-6_f64.ln() / (1.0 - share.powi(3)).max(1e-9).ln();
        let rules =
            HypothesisRules { draws: (misses.ceil() as usize).min(config.hypotheses.draws), ..config.hypotheses };
        let allowed = |p: &PlaneCoefficients| allowed(&level_plane(&self.volume, level, p));
        self.hypotheses.best_share(&self.points, size, &rules, allowed, kernels) >= share
    }

    /// Second half of [`Self::run`]: finds the planes through the clear disparities.
    pub fn find_planes(
        &mut self,
        level: &RegionLevel,
        config: &PlaneSearchConfig,
        allowed: impl Fn(&LevelPlane) -> bool,
        kernels: Kernels,
    ) {
        let area = self.volume.area;
        self.make_seeds(level, area, kernels);
        let size = Vector2::new(area.width as f64, area.height as f64);
        self.hypotheses.run(
            &self.points,
            &self.seeds,
            size,
            &config.hypotheses,
            |p| allowed(&level_plane(&self.volume, level, p)),
            kernels,
        );
        let kept = self.hypotheses.kept.iter();
        self.candidates.extend(kept.map(|&Candidate { plane, share }| PlaneCandidate {
            plane: level_plane(&self.volume, level, &plane),
            share,
        }));
        if let Some(best) = self.hypotheses.kept.first().map(|best| best.plane) {
            self.sweep(level, area, &best, config.alias_share, kernels);
            let aliases = self.seeds.iter().map(|shift| level_plane(&self.volume, level, &(best + shift)));
            let aliases = aliases.map(|plane| PlaneCandidate { plane, share: 0.0 });
            self.candidates.extend(aliases.filter(|alias| allowed(&alias.plane)));
        }
    }

    /// The plane with the most clear disparities of the last search, counted with `tolerance_px` (pixels of the level); `seeds`
    /// are counted whether they are allowed or not.
    pub fn widest(
        &mut self,
        level: &RegionLevel,
        seeds: impl Iterator<Item = LevelPlane>,
        config: &PlaneSearchConfig,
        tolerance_px: f64,
        allowed: impl Fn(&LevelPlane) -> bool,
        kernels: Kernels,
    ) -> Option<PlaneCandidate> {
        self.seeds.clear();
        self.seeds.extend(seeds.map(|plane| coefficients(&self.volume, level, &plane)));
        let size = Vector2::new(self.volume.area.width as f64, self.volume.area.height as f64);
        let rules = HypothesisRules { tolerance_px, ..config.hypotheses };
        let allowed = |p: &PlaneCoefficients| allowed(&level_plane(&self.volume, level, p));
        self.hypotheses.run_once(&self.points, &self.seeds, size, &rules, &allowed, kernels);
        let best = self.hypotheses.kept.first()?;
        Some(PlaneCandidate { plane: level_plane(&self.volume, level, &best.plane), share: best.share })
    }

    /// The plane of least squares through the clear disparities of the last search within a distance (pixels of the level) of a
    /// plane; `None` if they determine none.
    pub fn nearby(&self, level: &RegionLevel, plane: &LevelPlane, distance_px: f64) -> Option<LevelPlane> {
        let found = self.points.nearby(&coefficients(&self.volume, level, plane), distance_px)?;
        Some(level_plane(&self.volume, level, &found))
    }

    /// The surface of the last search that continues a plane, with its plane of least squares; `None` if the plane explains all of it.
    pub fn continued(
        &mut self,
        level: &RegionLevel,
        plane: &LevelPlane,
        choice: &SurfaceChoice,
    ) -> Option<(ContinuedSurface, LevelPlane)> {
        let start = coefficients(&self.volume, level, plane);
        let clear = clear_of(&self.volume, &self.aggregation, level);
        let found = self.continuation.of(clear, self.volume.area.width, &start, choice)?;
        Some((found, level_plane(&self.volume, level, &found.plane)))
    }

    /// Whether the surface of the last search that continues a plane contains most of the pixels within a distance (pixels of the level) of
    /// another plane.
    pub fn reaches(
        &mut self,
        level: &RegionLevel,
        from: &LevelPlane,
        to: &LevelPlane,
        near_px: f64,
        choice: &SurfaceChoice,
    ) -> bool {
        let [from, to] = [from, to].map(|plane| coefficients(&self.volume, level, plane));
        let clear = clear_of(&self.volume, &self.aggregation, level);
        self.continuation.reaches(clear, self.volume.area.width, [&from, &to], near_px as f32, choice)
    }

    /// Soft share of the clear disparities of the last search on a plane, with a tolerance in pixels of the level.
    pub fn share_within(&self, level: &RegionLevel, plane: &LevelPlane, tolerance_px: f64, kernels: Kernels) -> f64 {
        inlier_share(&self.points, &coefficients(&self.volume, level, plane), tolerance_px, kernels)
    }

    /// What single pixels say of a plane: of those with a clear disparity, the ones whose own neighbourhood matches better there than
    /// elsewhere. Clear disparities bridge pixels that say nothing.
    pub fn pixels_for(&self, level: &RegionLevel, plane: &LevelPlane) -> PixelShares {
        let (volume, stride) = (&self.volume, level.left.window.width);
        let (area, at_corner) = (volume.area, coefficients(volume, level, plane));
        let (mut on_plane, mut elsewhere) = (0_usize, 0_usize);
        for y in 0..area.height {
            let inside = &level.region[(area.y + y) * stride + area.x..][..area.width];
            let disparities = &self.aggregation.disparity[y * area.width..][..area.width];
            for (x, (_, disparity)) in
                inside.iter().zip(disparities).enumerate().filter(|(_, (inside, d))| **inside != 0 && d.is_finite())
            {
                let costs = &volume.costs[(y * area.width + x) * volume.stride..][..volume.count];
                let on = at_corner.dot(&Vector3::new(1.0, x as f64, y as f64)) as f32;
                let own = lowest_cost(costs, on);
                if (disparity - on).abs() <= ON_PLANE_PX {
                    let beside = [-APART_PX, APART_PX].map(|by| lowest_cost(costs, on + by));
                    on_plane += usize::from(beside.iter().all(|cost| *cost >= own + CLEARLY));
                } else {
                    elsewhere += usize::from(own >= lowest_cost(costs, *disparity) + CLEARLY);
                }
            }
        }
        let share = |count: usize| count as f64 / level.area_px.max(1) as f64;
        PixelShares { on_plane: share(on_plane), elsewhere: share(elsewhere) }
    }

    /// Moves the best plane through all disparities. Other shifts at which the region as a whole agrees well become seeds. A
    /// repetitive texture has such shifts.
    fn sweep(
        &mut self,
        level: &RegionLevel,
        area: LevelBox,
        plane: &PlaneCoefficients,
        alias_share: f64,
        kernels: Kernels,
    ) {
        let count = self.volume.count;
        self.column.clear();
        self.column.resize(2 * count + 1, 0);
        let (p, stride) = (plane.map(|p| p as f32), self.volume.stride);
        for y in 0..area.height {
            let inside = &level.region[(area.y + y) * level.left.window.width + area.x..][..area.width];
            let costs = &self.volume.costs[y * area.width * stride..][..area.width * stride];
            let line = DisparityLine { start: p.x + p.z * y as f32, step: p.y };
            add_swept(kernels, costs, inside, stride, count, line, &mut self.row_sums, &mut self.column);
        }
        let own = (count - 1..=count + 1).map(|i| self.column[i]).max().unwrap_or(0);
        for sum in &mut self.column[count - 1..=count + 1] {
            *sum = 0;
        }
        self.seeds.clear();
        push_peaks(&self.column, 2, &mut self.seeds);
        let column = &self.column;
        self.seeds.retain(|peak| f64::from(column[peak.x as usize]) > alias_share * f64::from(own));
        for peak in &mut self.seeds {
            peak.x -= count as f64;
        }
    }

    /// Collects the clear disparities of the region, in pixels of the box and steps of the volume.
    fn collect(&mut self, level: &RegionLevel, area: LevelBox) {
        self.points.clear();
        let stride = level.left.window.width;
        for y in 0..area.height {
            let inside = &level.region[(area.y + y) * stride + area.x..][..area.width];
            let values = &self.aggregation.disparity[y * area.width..][..area.width];
            for (x, (&inside, &d)) in inside.iter().zip(values).enumerate() {
                if inside != 0 && d.is_finite() {
                    self.points.push(x as f32, y as f32, d);
                }
            }
        }
        self.points.finish();
        self.valid_share = self.points.len() as f64 / level.area_px.max(1) as f64;
    }

    /// Seeds fronto-parallel planes: where most pixels have their disparity, and where the region as a whole agrees best.
    fn make_seeds(&mut self, level: &RegionLevel, area: LevelBox, kernels: Kernels) {
        self.seeds.clear();
        self.histogram.clear();
        self.histogram.resize(self.volume.count, 0);
        for d in self.points.disparities() {
            self.histogram[(d + 0.5) as usize] += 1;
        }
        push_peaks(&self.histogram, 4, &mut self.seeds);
        self.column.clear();
        self.column.resize(self.volume.count, 0);
        let stride = self.volume.stride;
        for y in 0..area.height {
            let inside = &level.region[(area.y + y) * level.left.window.width + area.x..][..area.width];
            let costs = &self.volume.costs[y * area.width * stride..][..area.width * stride];
            add_agreement(kernels, costs, inside, stride, &mut self.row_sums, &mut self.column);
        }
        push_peaks(&self.column, 4, &mut self.seeds);
    }
}

/// The lower cost of the two whole disparities around one; no agreement outside the searched ones.
fn lowest_cost(costs: &[u8], disparity: f32) -> u8 {
    let at = |index: f32| {
        let known = if index >= 0.0 { costs.get(index as usize) } else { None };
        known.copied().unwrap_or(COST_NEUTRAL)
    };
    at(disparity.floor()).min(at(disparity.ceil()))
}

/// The clear disparities of the region, row by row; NaN where there is none.
fn clear_of<'a>(
    volume: &CostVolume,
    aggregation: &'a Aggregation,
    level: &'a RegionLevel,
) -> impl Iterator<Item = f32> + use<'a> {
    let (area, stride) = (volume.area, level.left.window.width);
    (0..area.height).flat_map(move |y| {
        let inside = &level.region[(area.y + y) * stride + area.x..][..area.width];
        let values = &aggregation.disparity[y * area.width..][..area.width];
        inside.iter().zip(values).map(|(&inside, &d)| if inside != 0 { d } else { f32::NAN })
    })
}

/// Converts from pixels of the box and steps of the volume to a plane of the level.
fn level_plane(volume: &CostVolume, level: &RegionLevel, p: &PlaneCoefficients) -> LevelPlane {
    let at_origin = p.x - p.y * volume.area.x as f64 - p.z * volume.area.y as f64;
    let c = at_origin + f64::from(volume.first) - f64::from(level.column_shift());
    LevelPlane { a: p.y, b: p.z, c, row: level.left.window.y - level.right.window.y }
}

/// The inverse conversion.
fn coefficients(volume: &CostVolume, level: &RegionLevel, plane: &LevelPlane) -> PlaneCoefficients {
    let at_corner = plane.c + plane.a * volume.area.x as f64 + plane.b * volume.area.y as f64;
    Vector3::new(at_corner - f64::from(volume.first) + f64::from(level.column_shift()), plane.a, plane.b)
}

/// Number of pixels whose agreement is summed in 16 bits: 512 times 126, twice [`COST_NEUTRAL`], is below 65536.
const SUMMED_PX: usize = 512;

wide! {
    fn add_agreement(costs: &[u8], inside: &[u8], stride: usize, sums: &mut Vec<u16>, column: &mut [u32]) = add_agreement_kernel;
}

/// Adds, per disparity, the agreement of the inside pixels of a row relative to no agreement, plus [`COST_NEUTRAL`].
#[inline(always)]
fn add_agreement_kernel(costs: &[u8], inside: &[u8], stride: usize, sums: &mut Vec<u16>, column: &mut [u32]) {
    for (costs, inside) in costs.chunks(SUMMED_PX * stride).zip(inside.chunks(SUMMED_PX)) {
        sums.clear();
        sums.resize(stride, 0);
        for (costs, _) in costs.chunks_exact(stride).zip(inside).filter(|(_, inside)| **inside != 0) {
            for (sum, cost) in sums.iter_mut().zip(costs) {
                *sum += u16::from((2 * COST_NEUTRAL).saturating_sub(*cost));
            }
        }
        add_sums(sums, column);
    }
}

/// Disparities of a plane along a row: `start + step x`, steps of the volume.
#[derive(Clone, Copy, Debug)]
struct DisparityLine {
    start: f32,
    step: f32,
}

wide! {
    fn add_swept(costs: &[u8], inside: &[u8], stride: usize, count: usize, line: DisparityLine, sums: &mut Vec<u16>,
        column: &mut [u32]) = add_swept_kernel;
}

/// The same relative to the plane's disparity at each pixel: from `count` below to `count` above.
#[inline(always)]
fn add_swept_kernel(
    costs: &[u8],
    inside: &[u8],
    stride: usize,
    count: usize,
    line: DisparityLine,
    sums: &mut Vec<u16>,
    column: &mut [u32],
) {
    for (part, (costs, inside)) in costs.chunks(SUMMED_PX * stride).zip(inside.chunks(SUMMED_PX)).enumerate() {
        sums.clear();
        sums.resize(2 * count + 1, 0);
        for (x, (costs, inside)) in costs.chunks_exact(stride).zip(inside).enumerate() {
            let at = line.start + line.step * (part * SUMMED_PX + x) as f32 + 0.5;
            if *inside != 0 && at >= 0.0 && at < count as f32 {
                for (sum, cost) in sums[count - at as usize..].iter_mut().zip(&costs[..count]) {
                    *sum += u16::from(COST_NEUTRAL.saturating_sub(*cost));
                }
            }
        }
        add_sums(sums, column);
    }
}

#[inline(always)]
fn add_sums(sums: &[u16], column: &mut [u32]) {
    for (column, sum) in column.iter_mut().zip(sums) {
        *column += u32::from(*sum);
    }
}

/// The `count` highest local maxima of a histogram, as fronto-parallel planes.
fn push_peaks(histogram: &[u32], count: usize, out: &mut Vec<PlaneCoefficients>) {
    let mut limit = (u32::MAX, 0);
    for _ in 0..count {
        let at = |i: usize| histogram.get(i).copied().unwrap_or(0);
        let is_peak = |i: usize| at(i) > 0 && at(i) >= at(i.wrapping_sub(1)) && at(i) >= at(i + 1);
        let below = |i: usize| at(i) < limit.0 || (at(i) == limit.0 && i > limit.1);
        let next = (0..histogram.len()).filter(|&i| is_peak(i) && below(i)).max_by_key(|&i| (at(i), usize::MAX - i));
        let Some(i) = next else { return };
        out.push(Vector3::new(i as f64, 0.0, 0.0));
        limit = (at(i), i);
    }
}

/// The box of the region in the left window of a level, with a margin where the window has it.
pub(super) fn region_box(level: &RegionLevel, margin: usize) -> LevelBox {
    let (width, height) = (level.left.window.width, level.left.window.height);
    let (mut x, mut y) = ((width, 0), (height, 0));
    for (row, inside) in level.region.chunks_exact(width.max(1)).enumerate() {
        if let Some((first, last)) = ends_of(inside) {
            x = (x.0.min(first), x.1.max(last));
            y = (y.0.min(row), y.1.max(row));
        }
    }
    let (x0, y0) = (x.0.saturating_sub(margin), y.0.saturating_sub(margin));
    let (x1, y1) = ((x.1 + 1 + margin).min(width), (y.1 + 1 + margin).min(height));
    LevelBox { x: x0, y: y0, width: x1.saturating_sub(x0), height: y1.saturating_sub(y0) }
}

/// The first and the last non-zero position of a row.
pub(super) fn ends_of(row: &[u8]) -> Option<(usize, usize)> {
    // Most of a row is zero at both ends: these parts are skipped in blocks.
    const BLOCK: usize = 16;
    let is_clear = |block: &[u8]| block.iter().fold(0, |all, one| all | one) == 0;
    let before = BLOCK * row.chunks(BLOCK).take_while(|block| is_clear(block)).count();
    let behind = BLOCK * row.rchunks(BLOCK).take_while(|block| is_clear(block)).count();
    let first = before + row.get(before..)?.iter().position(|&at| at != 0)?;
    let last = row[..row.len() - behind].iter().rposition(|&at| at != 0)?;
    Some((first, last))
}

/// The disparities of a range, plus one at either end, at which the right window shows part of the left one; `None` if there
/// are none. It keeps the memory within the size of the images if the calibration is invalid.
fn visible(level: &RegionLevel, range: &RangeInclusive<i32>) -> Option<RangeInclusive<i32>> {
    let (left, right) = (&level.left.window, &level.right.window);
    let lowest = left.x.saturating_sub(right.x.saturating_add(right.width as i32));
    let highest = left.x.saturating_add(left.width as i32).saturating_sub(right.x);
    let widened = range.start().saturating_sub(1).max(lowest)..=range.end().saturating_add(1).min(highest);
    (!widened.is_empty()).then_some(widened)
}
