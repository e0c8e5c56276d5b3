//! The visible surface of a region, pixel by pixel, from one pair: for objects that are no plane.
//!
//! Semi-global matching ([`super::search`]) gives most pixels a disparity, and the median of those around it is that of the surface.
//! A pixel without a clear disparity gets that of its neighbours in the row; at a depth edge, where the left camera sees what the right one
//! does not, that of the farther neighbour.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_views::disparity_plane::DisparityRange;
use pb3dp_estimation_views::region_pyramid::RegionLevel;

use super::search::aggregate::{Penalties, WinnerRules};
use super::search::volume::LevelBox;
use super::search::{Disparities, PlaneSearch, PlaneSearchConfig};

/// The shape of a larger region is computed at half the size, or less. Chosen by hand, not varied: memory and time grow with it.
pub(super) const AREA_MAX_PX: usize = 160_000;
/// The same for the points of a whole image in which a target is searched. Chosen by hand, not varied: an image of 640 x 480 px at an eighth.
pub(super) const COARSE_MAX_PX: usize = 9000;
/// Costs of changes of disparity. Larger than those of the search for planes, which collects single clear pixels. Chosen: of 9 to 64
/// regions of each kind (non-planar, across an edge, textured, low texture, small), 0.4 to 2 % more pixels are within 1 px of the
/// truth than with 20 and 90, and as many as with 40 and 120 within 0.5 %.
const PENALTIES: Penalties = Penalties { small: 30, large: 120 };
/// Chosen likewise: with 0.05 there are up to 0.2 % less.
const UNIQUENESS: f32 = 0.1;
/// Half of the side of the square whose median disparity a pixel gets, pixels of the level. Chosen likewise: with 3 there are 0.4 to 1.3 %
/// less, with 2 up to 2.5 %.
pub(super) const REACH: usize = 5;
/// Standard deviation over the median deviation of the mean of two: normal distribution, two independent values.
const SIGMA_OF_PAIRS: f64 = 1.4826 * std::f64::consts::SQRT_2;
/// Standard deviation of the disparity of a smooth surface, pixels of the level, beside the scatter that the square shows: the noise of
/// neighbours is not independent.
const SMOOTH_SIGMA_PX: f64 = 0.2;
/// Neighbours whose disparities differ by more belong to two surfaces, pixels of the level: the matching charges the small penalty up to
/// one pixel.
pub(super) const EDGE_PX: f32 = 1.0;

/// Share of a region's pixels that must have a match: with a wrong depth range or exchanged images pixels match by chance. Chosen with
/// figures: of 21 real regions 63 to 98 % have a match; with ranges beside the object, or exchanged images, 24 to 54 %.
const MATCHED_MIN: f64 = 0.55;

/// Checks that enough pixels have a match.
pub(super) fn check_matched(pixels: &[ShapePixel]) -> Result<(), EstimationError> {
    let matched = pixels.iter().filter(|pixel| pixel.is_measured).count() as f64 / pixels.len().max(1) as f64;
    match matched >= MATCHED_MIN {
        true => Ok(()),
        false => {
            Err(EstimationError::NoSurface { matched_percent: 100.0 * matched, needed_percent: 100.0 * MATCHED_MIN })
        }
    }
}

/// A pixel of the region with its disparity, both in rectified pixels of the full image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShapePixel {
    pub(super) at_px: Vector2<f64>,
    pub(super) disparity_px: f64,
    pub(super) sigma_px: f64,
    pub(super) is_measured: bool,
}

/// Parameters of a search for the disparities of all pixels of a surface.
pub(super) fn surface_search(config: &PlaneSearchConfig) -> PlaneSearchConfig {
    let winner = WinnerRules { uniqueness: UNIQUENESS, ..config.winner };
    PlaneSearchConfig { penalties: PENALTIES, winner, ..*config }
}

/// The disparities of a region, row by row; none if the right image shows none of the range.
pub(super) fn shape_of(
    level: &RegionLevel,
    range_px: DisparityRange,
    config: &PlaneSearchConfig,
    kernels: Kernels,
) -> Vec<ShapePixel> {
    let mut search = PlaneSearch::default();
    if !search.match_pixels(level, range_px, &surface_search(config), kernels) {
        return Vec::new();
    }
    let found = search.disparities();
    let LevelBox { width, height, .. } = found.area;
    let mut pixels = Vec::with_capacity(level.area_px);
    let (mut near, mut row) = (Vec::new(), Vec::with_capacity(width));
    for y in 0..height {
        row.clear();
        row.extend((0..width).map(|x| around(found.values, [width, height], [x, y], &mut near)));
        fill(&mut row);
        let inside = &level.region[(found.area.y + y) * level.left.window.width + found.area.x..][..width];
        let shown = row.iter().enumerate().zip(inside).filter(|(_, inside)| **inside != 0);
        pixels
            .extend(shown.filter_map(|((x, value), _)| Some(pixel(level, found.area, found.first, [x, y], (*value)?))));
    }
    pixels
}

/// The pixels of a region with a clear disparity, and that disparity, both in rectified pixels of the full image.
pub(super) fn clear_pixels(
    level: &RegionLevel,
    range_px: DisparityRange,
    config: &PlaneSearchConfig,
    kernels: Kernels,
) -> Vec<(Vector2<f64>, f64)> {
    let mut search = PlaneSearch::default();
    if !search.match_pixels(level, range_px, config, kernels) {
        return Vec::new();
    }
    let Disparities { area, first, values } = search.disparities();
    let at = |(i, value): (usize, &f32)| {
        let at = Vector2::new(area.x + i % area.width, area.y + i / area.width);
        let is_inside = level.region[at.y * level.left.window.width + at.x] != 0;
        let disparity = (f64::from(*value) + f64::from(first)) * level.scale as f64;
        (is_inside && value.is_finite()).then(|| (level.full_from_level(&at.map(|x| x as f64)), disparity))
    };
    values.iter().enumerate().filter_map(at).collect()
}

/// A disparity with its standard deviation, pixels of the level.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Value {
    disparity: f32,
    sigma: f32,
    is_measured: bool,
}

/// Median of the clear disparities around a pixel, and their scatter about it; `None` if the pixel itself has no clear one. The scatter is that of
/// the means of opposite pixels, which a slope leaves equal.
fn around(values: &[f32], [width, height]: [usize; 2], [x, y]: [usize; 2], near: &mut Vec<f32>) -> Option<Value> {
    values[y * width + x].is_finite().then_some(())?;
    near.clear();
    for row in y.saturating_sub(REACH)..=(y + REACH).min(height - 1) {
        let part = &values[row * width + x.saturating_sub(REACH)..=row * width + (x + REACH).min(width - 1)];
        near.extend(part.iter().filter(|d| d.is_finite()));
    }
    let middle = near.len() / 2;
    let disparity = *near.select_nth_unstable_by(middle, f32::total_cmp).1;
    near.clear();
    let reach = [y.min(height - 1 - y), x.min(width - 1 - x)].map(|to_border| REACH.min(to_border));
    let half = (2 * reach[0] + 1) * (2 * reach[1] + 1) / 2;
    near.extend((0..half).filter_map(|k| {
        let (row, column) = (k / (2 * reach[1] + 1), k % (2 * reach[1] + 1));
        let one = values[(y - reach[0] + row) * width + x - reach[1] + column];
        let opposite = values[(y + reach[0] - row) * width + x + reach[1] - column];
        let deviation = (0.5 * (one + opposite) - disparity).abs();
        deviation.is_finite().then_some(deviation)
    }));
    let middle = near.len() / 2;
    let scatter = match near.is_empty() {
        true => f64::from(EDGE_PX),
        false => SIGMA_OF_PAIRS * f64::from(*near.select_nth_unstable_by(middle, f32::total_cmp).1),
    };
    Some(Value { disparity, sigma: SMOOTH_SIGMA_PX.hypot(scatter) as f32, is_measured: true })
}

/// Gives the pixels of a row that have none a disparity of their neighbours, with half of the difference as an additional error.
fn fill(row: &mut [Option<Value>]) {
    let mut x = 0;
    while let Some(first) = (x..row.len()).find(|&at| row[at].is_none()) {
        let end = (first..row.len()).find(|&at| row[at].is_some()).unwrap_or(row.len());
        let (before, after) = (first.checked_sub(1).and_then(|at| row[at]), row.get(end).copied().flatten());
        for (i, value) in row[first..end].iter_mut().enumerate() {
            *value = match (before, after) {
                (Some(a), Some(b)) => Some(between(a, b, (i + 1) as f32 / (end - first + 1) as f32)),
                (one, other) => {
                    one.or(other).map(|one| Value { sigma: one.sigma.hypot(EDGE_PX), is_measured: false, ..one })
                }
            };
        }
        x = end;
    }
}

/// The disparity at a share of the way between two neighbours of a gap.
fn between(a: Value, b: Value, share: f32) -> Value {
    let apart = (a.disparity - b.disparity).abs();
    let disparity = match apart > EDGE_PX {
        true => a.disparity.min(b.disparity),
        false => a.disparity + share * (b.disparity - a.disparity),
    };
    Value { disparity, sigma: a.sigma.max(b.sigma).hypot(0.5 * apart), is_measured: false }
}

fn pixel(level: &RegionLevel, area: LevelBox, first: i32, [x, y]: [usize; 2], value: Value) -> ShapePixel {
    let scale = level.scale as f64;
    ShapePixel {
        at_px: level.full_from_level(&Vector2::new((area.x + x) as f64, (area.y + y) as f64)),
        disparity_px: scale * (f64::from(value.disparity) + f64::from(first)),
        sigma_px: scale * f64::from(value.sigma),
        is_measured: value.is_measured,
    }
}
