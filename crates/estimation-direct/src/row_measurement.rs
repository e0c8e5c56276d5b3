//! Measurement of a pair's row offset, from many points distributed over both images.
//!
//! Points with texture in both directions are matched in the right image: over all disparities at a quarter of the size, then
//! refined level by level, and finally to sub-pixel accuracy (Lucas and Kanade, with means and gains removed). The offset is a
//! robust affine fit to their row differences. It takes some milliseconds and is intended once per rig or scene.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_core::wide::wide;

use super::colour_planes::Wanted;
use super::disparity_plane::DisparityRange;
use super::front_end::{Side, StereoFrontEnd};
use super::image_plane::ImagePlane;
use super::region_pyramid::{PyramidSource, RegionLevel, RegionPyramid};
use pb3dp_estimation_core::row_offset::{RowMeasurement, RowOffset};

/// Level of the exhaustive search. Chosen by hand, not varied: with the rows on either side, offsets of up to 4 px are
/// found there; time falls to an eighth per level.
const COARSE: usize = 2;
/// Spacing of the points, pixels of the coarse level. Chosen by hand, not varied: 16 px at full size; time grows with the
/// inverse square.
const SPACING: usize = 4;
/// Half width of a patch. Chosen by hand, not varied: larger patches cross more depth edges, smaller ones match by chance
/// more often.
const RADIUS: usize = 4;
const SIDE: usize = 2 * RADIUS + 1;
const PATCH: usize = SIDE * SIDE;
/// Lowest correlation of a match, coarse and fine. Chosen by hand, not varied: with less, wrong matches enter the robust
/// fit; with more, noisy images have too few.
const CORRELATION_MIN: [f64; 2] = [0.75, 0.85];
/// Smallest difference in correlation between the best position and any position that is not its neighbour. Chosen by hand,
/// not varied: with less, repetitive texture enters the robust fit.
const MARGIN_MIN: f64 = 0.05;
/// Smallest root mean square of the gradient along rows and along columns, luminance per pixel. Chosen by hand, not varied:
/// four times what noise of `direct.search.noise_grey` makes on the coarse level (0.7, sqrt(2) x 2 / 4).
const GRADIENT_MIN: f64 = 3.0;
/// Smallest number of matches for an affine offset; with at least a quarter of that a constant is fitted. Chosen by hand,
/// not varied: 20 for each of three parameters.
const MATCHES_MIN: usize = 60;
/// Largest row offset that is matched, pixels. Chosen by hand, not varied: below the 10 px that the search covers: 4 on the
/// coarse level, 2 x 2 and 2 on the others.
const OFFSET_MAX_PX: f64 = 6.0;

/// One matched point: right pixel, and its row minus the left row.
#[derive(Clone, Copy, Debug)]
struct RowMatch {
    right_px: Vector2<f64>,
    offset_px: f64,
}

/// Measures the row offset of a pair of raw images that the front end has checked.
pub(super) fn measure_rows(front_end: &StereoFrontEnd, left: ImageView<'_>, right: ImageView<'_>) -> RowMeasurement {
    let middle = front_end.middle();
    let mut region = RegionMask::empty(front_end.size(Side::Left));
    for y in 0..middle.height as i64 {
        let (x, y) = (i64::from(middle.x), i64::from(middle.y) + y);
        region.insert_span(y, x, x + middle.width as i64 - 1);
    }
    let width = middle.width as f64;
    let source = PyramidSource {
        left,
        right,
        region: &region,
        disparity_px: DisparityRange { lowest: -0.1 * width, highest: 0.5 * width },
        rows: RowOffset::default(),
        wanted: Wanted::Luminance,
        search_area_px: usize::MAX,
    };
    let mut pyramid = RegionPyramid::default();
    if !pyramid.update(front_end, &source) || pyramid.levels().len() <= COARSE {
        return RowMeasurement::default();
    }
    let level = &pyramid.levels()[COARSE];
    let (columns, rows) = (level.left.window.width, level.left.window.height);
    let margin = RADIUS + 2;
    let mut search = CoarseSearch::new(level, front_end.kernels());
    let mut matches = Vec::new();
    for y in (margin..rows.saturating_sub(margin)).step_by(SPACING) {
        for x in (margin..columns.saturating_sub(margin)).step_by(SPACING) {
            matches.extend(find_again(pyramid.levels(), &mut search, Vector2::new(x as i64, y as i64)));
        }
    }
    let measured = fit(&matches);
    RowMeasurement { rows: front_end.rows_of_middle(&measured.rows), ..measured }
}

fn find_again(levels: &[RegionLevel], search: &mut CoarseSearch<'_>, point: Vector2<i64>) -> Option<RowMatch> {
    let patch = Patch::take(levels[COARSE].left.luminance(), point)?;
    if !patch.has_texture {
        return None;
    }
    let mut place = search.find(&patch, point.y)?;
    let mut at = point;
    for level in levels[..COARSE].iter().rev() {
        at *= 2;
        let patch = Patch::take(level.left.luminance(), at)?;
        let around = (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| 2 * place + Vector2::new(dx, dy)));
        let scored = around.filter_map(|p| Some((patch.correlation_at(level.right.luminance(), p)?, p)));
        let (best, found) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
        if f64::from(best) < CORRELATION_MIN[1] {
            return None;
        }
        place = found;
    }
    let (left, right) = (levels[0].left.luminance(), levels[0].right.luminance());
    let shift = refine(left, right, at, place)?;
    let window = levels[0].right.window;
    let right_px =
        Vector2::new(place.x as f64 + shift.x + f64::from(window.x), place.y as f64 + shift.y + f64::from(window.y));
    let offset_px = right_px.y - (at.y as f64 + f64::from(levels[0].left.window.y));
    (offset_px.abs() <= OFFSET_MAX_PX).then_some(RowMatch { right_px, offset_px })
}

/// Matches patches on the coarse level of the right image.
struct CoarseSearch<'a> {
    right: &'a ImagePlane,
    /// Per patch position (its first column and row): 1 / norm of the patch minus its mean.
    certainty: ImagePlane,
    /// Correlations along the compared rows.
    scores: [Vec<f32>; 3],
    kernels: Kernels,
}

impl<'a> CoarseSearch<'a> {
    fn new(level: &'a RegionLevel, kernels: Kernels) -> Self {
        let right = level.right.luminance();
        let size = |length: usize| (length + 1).saturating_sub(SIDE);
        let mut certainty = ImagePlane::new(size(right.width()), size(right.height()));
        let mut columns = [vec![0.0; right.width()], vec![0.0; right.width()]];
        for y in 0..certainty.height() {
            let rows: [&[f32]; SIDE] = std::array::from_fn(|j| right.row(y + j));
            let [sums, squares] = &mut columns;
            certainty_row(kernels, &rows, sums, squares, certainty.row_mut(y));
        }
        Self { right, certainty, scores: Default::default(), kernels }
    }

    /// The best position of a patch on its row and the adjacent rows, if it is clearly the best.
    fn find(&mut self, patch: &Patch, y: i64) -> Option<Vector2<i64>> {
        let mut best = (f32::NEG_INFINITY, (0, 0));
        for (scores, row) in self.scores.iter_mut().zip(y - 1..=y + 1) {
            scores.clear();
            let top = usize::try_from(row - RADIUS as i64).ok().filter(|&top| top < self.certainty.height());
            let Some(top) = top else { continue };
            scores.resize(self.certainty.width(), 0.0);
            let rows: [&[f32]; SIDE] = std::array::from_fn(|j| self.right.row(top + j));
            correlate_row(self.kernels, &patch.values, &rows, self.certainty.row(top), scores);
            for (x, &score) in scores.iter().enumerate() {
                if score > best.0 {
                    best = (score, (x, row));
                }
            }
        }
        let (highest, (column, row)) = best;
        let others = self.scores.iter().flat_map(|scores| {
            let near = column.saturating_sub(1)..(column + 2).min(scores.len());
            scores[..near.start.min(scores.len())].iter().chain(&scores[near.end..])
        });
        let rival = others.fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        let is_clear = f64::from(highest) >= CORRELATION_MIN[0] && f64::from(highest - rival) >= MARGIN_MIN;
        is_clear.then(|| Vector2::new(column as i64 + RADIUS as i64, row))
    }
}

wide! {
    fn certainty_row(rows: &[&[f32]; SIDE], sums: &mut [f32], squares: &mut [f32], out: &mut [f32]) = certainty_row_kernel;
}

#[inline(always)]
fn certainty_row_kernel(rows: &[&[f32]; SIDE], sums: &mut [f32], squares: &mut [f32], out: &mut [f32]) {
    // Grey levels relative to the middle of the luminance range, so that single precision is enough for the difference of the
    // squares.
    const MIDDLE: f32 = 220.0;
    sums.fill(0.0);
    squares.fill(0.0);
    for row in rows {
        for ((sum, square), value) in sums.iter_mut().zip(squares.iter_mut()).zip(*row) {
            let value = value - MIDDLE;
            *sum += value;
            *square += value * value;
        }
    }
    for ((out, sums), squares) in out.iter_mut().zip(sums.windows(SIDE)).zip(squares.windows(SIDE)) {
        let (mut sum, mut square) = (0.0, 0.0);
        for i in 0..SIDE {
            sum += sums[i];
            square += squares[i];
        }
        let variation = square - sum * sum * (1.0 / PATCH as f32);
        *out = if variation > 1.0 { 1.0 / variation.sqrt() } else { 0.0 };
    }
}

wide! {
    fn correlate_row(patch: &[f32; PATCH], rows: &[&[f32]; SIDE], certainty: &[f32], scores: &mut [f32]) = correlate_row_kernel;
}

/// Correlations of a patch (mean 0, norm 1) with all positions along a row.
#[inline(always)]
fn correlate_row_kernel(patch: &[f32; PATCH], rows: &[&[f32]; SIDE], certainty: &[f32], scores: &mut [f32]) {
    let width = scores.len();
    for (weights, row) in patch.chunks_exact(SIDE).zip(rows) {
        let shifted: [&[f32]; SIDE] = std::array::from_fn(|i| &row[i..i + width]);
        for (x, score) in scores.iter_mut().enumerate() {
            let mut sum = 0.0;
            for i in 0..SIDE {
                sum += weights[i] * shifted[i][x];
            }
            *score += sum;
        }
    }
    for (score, certainty) in scores.iter_mut().zip(certainty) {
        *score *= certainty;
    }
}

/// A patch, normalised to mean 0 and norm 1.
#[derive(Clone, Copy, Debug)]
struct Patch {
    values: [f32; PATCH],
    has_texture: bool,
}

impl Patch {
    fn take(plane: &ImagePlane, place: Vector2<i64>) -> Option<Self> {
        let (x, y) = (place.x, place.y);
        let r = RADIUS as i64;
        if x < r || y < r || x + r >= plane.width() as i64 || y + r >= plane.height() as i64 {
            return None;
        }
        let mut values = [0.0; PATCH];
        for j in 0..SIDE {
            let row = &plane.row(y as usize + j - RADIUS)[x as usize - RADIUS..=x as usize + RADIUS];
            values[j * SIDE..(j + 1) * SIDE].copy_from_slice(row);
        }
        let mean = values.iter().sum::<f32>() / PATCH as f32;
        let (mut along, mut down) = (0.0_f32, 0.0_f32);
        for j in 0..SIDE - 1 {
            for i in 0..SIDE - 1 {
                let at = j * SIDE + i;
                along += (values[at + 1] - values[at]).powi(2);
                down += (values[at + SIDE] - values[at]).powi(2);
            }
        }
        let enough = ((SIDE - 1) * (SIDE - 1)) as f32 * (GRADIENT_MIN * GRADIENT_MIN) as f32;
        values.iter_mut().for_each(|v| *v -= mean);
        let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
        if length <= 0.0 {
            return None;
        }
        values.iter_mut().for_each(|v| *v /= length);
        Some(Self { values, has_texture: along >= enough && down >= enough })
    }

    /// Correlation with the patch of another plane around a position; `None` if the patch is outside the plane or uniform.
    fn correlation_at(&self, plane: &ImagePlane, place: Vector2<i64>) -> Option<f32> {
        let (x, y) = (place.x, place.y);
        let r = RADIUS as i64;
        if x < r || y < r || x + r >= plane.width() as i64 || y + r >= plane.height() as i64 {
            return None;
        }
        let (x, y) = (x as usize - RADIUS, y as usize - RADIUS);
        let middle = plane.row(y + RADIUS)[x + RADIUS];
        let (mut product, mut sum, mut square) = ([0.0_f32; SIDE], [0.0_f32; SIDE], [0.0_f32; SIDE]);
        for (j, own) in self.values.chunks_exact(SIDE).enumerate() {
            let row = &plane.row(y + j)[x..x + SIDE];
            for i in 0..SIDE {
                let value = row[i] - middle;
                product[i] += own[i] * value;
                sum[i] += value;
                square[i] += value * value;
            }
        }
        let total = |values: [f32; SIDE]| values.iter().sum::<f32>();
        let variation = total(square) - total(sum).powi(2) / PATCH as f32;
        (variation > 0.0).then(|| total(product) / variation.sqrt())
    }
}

/// Number of sub-pixel steps. Chosen by hand, not varied: a match that still moves by 0.05 px is dropped.
const STEPS: usize = 5;

/// Lucas-Kanade refinement of a match: correction of the right position, pixels. `None` if it diverges.
fn refine(left: &ImagePlane, right: &ImagePlane, at: Vector2<i64>, place: Vector2<i64>) -> Option<Vector2<f64>> {
    let template = Patch::take(left, at)?;
    let mut shift = Vector2::zeros();
    for step in 0..STEPS {
        let sampled = sample(right, place, &shift)?;
        let (mut h, mut g) = (Matrix2::zeros(), Vector2::zeros());
        for j in 1..SIDE - 1 {
            for i in 1..SIDE - 1 {
                let k = j * SIDE + i;
                let gradient = Vector2::new(
                    0.25 * (sampled[k + 1] - sampled[k - 1] + f64::from(template.values[k + 1])
                        - f64::from(template.values[k - 1])),
                    0.25 * (sampled[k + SIDE] - sampled[k - SIDE] + f64::from(template.values[k + SIDE])
                        - f64::from(template.values[k - SIDE])),
                );
                h += gradient * gradient.transpose();
                g += gradient * (f64::from(template.values[k]) - sampled[k]);
            }
        }
        let update = h.cholesky()?.solve(&g);
        shift += update;
        if shift.norm().is_nan() || shift.norm() > 1.5 || (step + 1 == STEPS && update.norm() > 0.05) {
            return None;
        }
    }
    Some(shift)
}

/// A patch of the right image at a sub-pixel position, normalised.
fn sample(right: &ImagePlane, place: Vector2<i64>, shift: &Vector2<f64>) -> Option<[f64; PATCH]> {
    let floor = shift.map(f64::floor);
    let (a, b) = (shift.x - floor.x, shift.y - floor.y);
    let first = (place.x - RADIUS as i64 + floor.x as i64, place.y - RADIUS as i64 + floor.y as i64);
    let (x, y) = (usize::try_from(first.0).ok()?, usize::try_from(first.1).ok()?);
    if x + SIDE >= right.width() || y + SIDE >= right.height() {
        return None;
    }
    let mut values = [0.0; PATCH];
    for (j, values) in values.chunks_exact_mut(SIDE).enumerate() {
        let (upper, lower) = (&right.row(y + j)[x..=x + SIDE], &right.row(y + j + 1)[x..=x + SIDE]);
        let down = |i: usize| f64::from(upper[i]) * (1.0 - b) + f64::from(lower[i]) * b;
        for (i, value) in values.iter_mut().enumerate() {
            *value = down(i) * (1.0 - a) + down(i + 1) * a;
        }
    }
    let mean = values.iter().sum::<f64>() / PATCH as f64;
    values.iter_mut().for_each(|v| *v -= mean);
    let length = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    (length > 0.0).then(|| values.map(|v| v / length))
}

/// Robust fit of an affine function of the right pixel to the matches.
fn fit(matches: &[RowMatch]) -> RowMeasurement {
    let median = |mut values: Vec<f64>| -> f64 {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    let count = matches.len();
    if count < MATCHES_MIN / 4 {
        return RowMeasurement { matches: count, ..RowMeasurement::default() };
    }
    let centre_px = matches.iter().map(|m| m.right_px).sum::<Vector2<f64>>() / count as f64;
    let mut p = Vector3::new(median(matches.iter().map(|m| m.offset_px).collect()), 0.0, 0.0);
    let parameters = |m: &RowMatch| Vector3::new(1.0, m.right_px.x - centre_px.x, m.right_px.y - centre_px.y);
    let mut spread_px = 0.0;
    for _ in 0..10 {
        let residuals: Vec<f64> = matches.iter().map(|m| m.offset_px - p.dot(&parameters(m))).collect();
        spread_px = (1.4826 * median(residuals.iter().map(|r| r.abs()).collect())).max(0.01);
        if count < MATCHES_MIN {
            break;
        }
        let (mut h, mut g) = (Matrix3::zeros(), Vector3::zeros());
        for (m, r) in matches.iter().zip(&residuals) {
            let w = (1.0 - (r / (4.0 * spread_px)).powi(2)).max(0.0).powi(2);
            let x = parameters(m);
            h += w * x * x.transpose();
            g += w * x * *r;
        }
        let Some(h) = h.cholesky() else { break };
        p += h.solve(&g);
    }
    let rows = RowOffset { centre_px, offset_px: p.x, slope: Vector2::new(p.y, p.z) };
    RowMeasurement { rows, matches: count, spread_px }
}
