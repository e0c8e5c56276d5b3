//! Patches that are found again in the other image.

use std::ops::Range;

use nalgebra::{Matrix2, Vector2};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;
use pb3dp_estimation_views::disparity_plane::DisparityRange;
use pb3dp_estimation_views::image_plane::ImagePlane;
use pb3dp_estimation_views::region_pyramid::RegionLevel;

/// Half width of a patch. Chosen by hand, not varied: larger patches cross more depth edges, smaller ones match by chance
/// more often.
pub(super) const RADIUS: usize = 4;
const SIDE: usize = 2 * RADIUS + 1;
const PATCH: usize = SIDE * SIDE;
/// Lowest correlation of a match, coarse and fine. Chosen by hand, not varied: with less, wrong matches enter the robust
/// fit; with more, noisy images have too few.
pub(super) const CORRELATION_MIN: [f64; 2] = [0.75, 0.85];
/// Smallest difference in correlation between the best position and any position that is not its neighbour. Chosen by hand,
/// not varied: with less, repetitive texture enters the robust fit.
const MARGIN_MIN: f64 = 0.05;
/// Smallest root mean square of the gradient along rows and along columns on the coarse level, luminance per pixel. Chosen by hand, not varied:
/// four times what noise of `direct.search.noise_grey` makes on the coarse level (0.7, sqrt(2) x 2 / 4).
pub(super) const GRADIENT_MIN: f64 = 3.0;

/// Matches patches on the coarse level of the right image.
pub(super) struct CoarseSearch<'a> {
    right: &'a ImagePlane,
    /// Per patch position (its first column and row): 1 / norm of the patch minus its mean.
    certainty: ImagePlane,
    /// Correlations along the compared rows.
    scores: Vec<Vec<f32>>,
    /// Rectified pixels per pixel of the level, and the first column of the right window minus that of the left one.
    scale: f64,
    column_shift: f64,
    /// Number of rows on either side that are compared.
    reach: i64,
    kernels: Kernels,
}

impl<'a> CoarseSearch<'a> {
    pub(super) fn new(level: &'a RegionLevel, reach: i64, kernels: Kernels) -> Self {
        let right = level.right.luminance();
        let size = |length: usize| (length + 1).saturating_sub(SIDE);
        let mut certainty = ImagePlane::new(size(right.width()), size(right.height()));
        let mut columns = [vec![0.0; right.width()], vec![0.0; right.width()]];
        for y in 0..certainty.height() {
            let rows: [&[f32]; SIDE] = std::array::from_fn(|j| right.row(y + j));
            let [sums, squares] = &mut columns;
            certainty_row(kernels, &rows, sums, squares, certainty.row_mut(y));
        }
        let (scale, column_shift) = (level.scale as f64, f64::from(level.column_shift()));
        Self { right, certainty, scores: Vec::new(), scale, column_shift, reach, kernels }
    }

    /// The best position of a left patch among disparities (pixels of the full size), on its row and the rows on either side, if it is clearly the
    /// best.
    pub(super) fn find(
        &mut self,
        patch: &Patch,
        at: Vector2<i64>,
        disparity_px: DisparityRange,
    ) -> Option<Vector2<i64>> {
        let columns = self.columns(at.x, disparity_px);
        if columns.is_empty() {
            return None;
        }
        let y = at.y;
        let mut best = (f32::NEG_INFINITY, (0, 0));
        self.scores.resize(2 * self.reach as usize + 1, Vec::new());
        for (scores, row) in self.scores.iter_mut().zip(y - self.reach..=y + self.reach) {
            scores.clear();
            let top = usize::try_from(row - RADIUS as i64).ok().filter(|&top| top < self.certainty.height());
            let Some(top) = top else { continue };
            scores.resize(columns.len(), 0.0);
            let rows: [&[f32]; SIDE] = std::array::from_fn(|j| &self.right.row(top + j)[columns.start..]);
            correlate_row(self.kernels, &patch.values, &rows, &self.certainty.row(top)[columns.clone()], scores);
            for (x, &score) in scores.iter().enumerate() {
                if score > best.0 {
                    best = (score, (x, row));
                }
            }
        }
        let (highest, (column, row)) = best;
        let others = self.scores.iter().flat_map(|scores| {
            let near = column.saturating_sub(1)..(column + 2).min(scores.len());
            scores[..near.start.min(scores.len())].iter().chain(scores.get(near.end..).unwrap_or_default())
        });
        let rival = others.fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        let is_clear = f64::from(highest) >= CORRELATION_MIN[0] && f64::from(highest - rival) >= MARGIN_MIN;
        is_clear.then(|| Vector2::new((columns.start + column + RADIUS) as i64, row))
    }

    /// First columns of the right patches that may show the same point as a left patch.
    fn columns(&self, left_column: i64, disparity_px: DisparityRange) -> Range<usize> {
        let at =
            |disparity_px: f64| left_column as f64 - (disparity_px / self.scale - self.column_shift) - RADIUS as f64;
        let (first, last) = (at(disparity_px.highest).floor(), at(disparity_px.lowest).ceil());
        let width = self.certainty.width();
        let [first, end] = [first, last + 1.0].map(|column| (column.max(0.0) as usize).min(width));
        first..end.max(first)
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
pub(super) struct Patch {
    values: [f32; PATCH],
    /// Norm before it was normalised.
    length: f64,
    /// Root mean square of the gradient along rows or down columns, the smaller one, luminance per pixel.
    pub(super) gradient: f64,
}

impl Patch {
    pub(super) fn take(plane: &ImagePlane, place: Vector2<i64>) -> Option<Self> {
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
        let gradient = (f64::from(along.min(down)) / ((SIDE - 1) * (SIDE - 1)) as f64).sqrt();
        values.iter_mut().for_each(|v| *v -= mean);
        let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
        if length <= 0.0 {
            return None;
        }
        values.iter_mut().for_each(|v| *v /= length);
        Some(Self { values, length: f64::from(length), gradient })
    }

    /// Correlation with the patch of another plane around a position; `None` if the patch is outside the plane or uniform.
    pub(super) fn correlation_at(&self, plane: &ImagePlane, place: Vector2<i64>) -> Option<f32> {
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

/// Largest number of sub-pixel steps, and the last one's size, pixels; a match that still moves by more is dropped. Chosen with figures: where
/// noise is a good part of the texture, steps are short, and five of them left an eighth of the way.
const STEPS: usize = 20;
const STEP_MIN_PX: f64 = 0.005;

/// Lucas-Kanade refinement of a match: correction of the right position, pixels, and the variance of its row for unit noise of the
/// image. `None` if it diverges.
pub(super) fn refine(
    left: &ImagePlane,
    right: &ImagePlane,
    at: Vector2<i64>,
    place: Vector2<i64>,
) -> Option<(Vector2<f64>, f64)> {
    let template = Patch::take(left, at)?;
    let mut shift = Vector2::zeros();
    for _ in 0..STEPS {
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
        let inverse = h.cholesky()?.inverse();
        let update = inverse * g;
        let row_variance = inverse[(1, 1)] / template.length.powi(2);
        shift += update;
        if shift.norm().is_nan() || shift.norm() > 1.5 {
            return None;
        }
        if update.norm() < STEP_MIN_PX {
            return Some((shift, row_variance));
        }
    }
    None
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
