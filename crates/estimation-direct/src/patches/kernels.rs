//! Running sums over patches, row by row.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::{LANES, wide};

use super::{PATCH_PX, PatchConfig, REACH_MAX, SIDE, SUPPORTS, USABLE};
use crate::named_sums::named_sums;

/// Largest number of shifts.
const SHIFTS_MAX: usize = 2 * REACH_MAX + 1;
/// Sums of: products of the left with the shifted right image, left, left squared, gradient squared, right, right squared.
const SUMS: usize = SHIFTS_MAX + 5;
const LEFT: usize = SHIFTS_MAX;
const LEFT_SQUARED: usize = SHIFTS_MAX + 1;
const GRADIENT_SQUARED: usize = SHIFTS_MAX + 2;
const RIGHT: usize = SHIFTS_MAX + 3;
const RIGHT_SQUARED: usize = SHIFTS_MAX + 4;

/// Sums over the columns of the last [`SIDE`] rows, and over whole patches.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    reach: usize,
    columns: [Vec<f32>; SUMS],
    patches: [Vec<f32>; SUMS],
    offset: Vec<f32>,
    correlation: Vec<f32>,
    weight: Vec<f32>,
    verdict: Vec<u8>,
    ones: Vec<f32>,
    zeros: Vec<f32>,
}

impl Rows {
    pub(super) fn start(&mut self, width: usize, reach: usize) {
        self.reach = reach;
        let wide = width + 2 * reach;
        for (k, sums) in self.columns.iter_mut().enumerate() {
            sums.clear();
            sums.resize(if k >= RIGHT { wide } else { width }, 0.0);
        }
        let patches = (width + 1).saturating_sub(SIDE);
        for values in [&mut self.offset, &mut self.correlation, &mut self.weight] {
            values.resize(patches, 0.0);
        }
        self.verdict.resize(patches, 0);
        for (k, sums) in self.patches.iter_mut().enumerate() {
            sums.resize(if k >= RIGHT { patches + 2 * reach } else { patches }, 0.0);
        }
        self.ones.clear();
        self.ones.resize(wide, 1.0);
        self.zeros.clear();
        self.zeros.resize(wide, 0.0);
    }

    /// Adds row `y` to the sums and subtracts the row that leaves the patch.
    pub(super) fn advance(
        &mut self,
        y: usize,
        width: usize,
        left: &[f32],
        gradient: &[f32],
        warped: &[f32],
        kernels: Kernels,
    ) {
        let wide = width + 2 * self.reach;
        let row = |values: &'_ [f32], width: usize, y: usize| -> std::ops::Range<usize> {
            let _ = values;
            y * width..(y + 1) * width
        };
        let (l, g, w) = (&left[row(left, width, y)], &gradient[row(gradient, width, y)], &warped[row(warped, wide, y)]);
        let (lo, go, wo) = match y.checked_sub(SIDE) {
            Some(old) => {
                (&left[row(left, width, old)], &gradient[row(gradient, width, old)], &warped[row(warped, wide, old)])
            }
            None => (&self.zeros[..width], &self.zeros[..width], &self.zeros[..wide]),
        };
        for k in 0..=2 * self.reach {
            slide(kernels, &mut self.columns[k], l, &w[k..k + width], lo, &wo[k..k + width]);
        }
        slide(kernels, &mut self.columns[LEFT], l, &self.ones, lo, &self.ones);
        slide(kernels, &mut self.columns[LEFT_SQUARED], l, l, lo, lo);
        slide(kernels, &mut self.columns[GRADIENT_SQUARED], g, g, go, go);
        slide(kernels, &mut self.columns[RIGHT], w, &self.ones, wo, &self.ones);
        slide(kernels, &mut self.columns[RIGHT_SQUARED], w, w, wo, wo);
    }

    /// Finds the best shift of every patch of the middle row.
    pub(super) fn peaks(&mut self, config: &PatchConfig, kernels: Kernels) {
        let used = (0..=2 * self.reach).chain(SHIFTS_MAX..SUMS);
        for k in used {
            row_sums(kernels, &self.columns[k], &mut self.patches[k]);
        }
        let (products, rest) = self.patches.split_at_mut(SHIFTS_MAX);
        let [left, left_squared, gradient, right, right_squared] = rest else { return };
        let floor = PATCH_PX * 0.25 * (config.texture_min * config.texture_min) as f32;
        let texture = PATCH_PX * (config.texture_min * config.texture_min) as f32;
        let half = PATCH_PX * (config.gradient_half * config.gradient_half) as f32;
        for (k, products) in products.iter_mut().enumerate().take(2 * self.reach + 1) {
            correlate(kernels, products, left, left_squared, &right[k..], &right_squared[k..], floor);
        }
        find_peaks(kernels, products, self.reach, &mut self.offset, &mut self.correlation);
        weigh(kernels, left, left_squared, gradient, texture, half, &mut self.weight);
    }

    /// Marks for every patch of the row whether its pixel is usable and supports the plane.
    pub(super) fn judge(&mut self, limits: PeakLimits, kernels: Kernels) {
        judge(kernels, &self.offset, &self.correlation, &self.weight, limits, &mut self.verdict);
    }

    /// Copies the marks to the pixels of a row of the region, and counts these pixels.
    pub(super) fn spread_row(&self, inside: &[u8], support: &mut [u8], kernels: Kernels) -> Tally<f64> {
        spread_row(kernels, inside, &self.verdict, &self.correlation, &self.weight, support)
    }

    /// Shift, correlation and weight of the patches of the row.
    pub(super) fn peaks_found(&self) -> RowPeaks<'_> {
        RowPeaks { offset: &self.offset, correlation: &self.correlation, weight: &self.weight }
    }
}

/// Limits of a patch's correlation peak: largest distance, and smallest correlation.
#[derive(Clone, Copy, Debug)]
pub(super) struct PeakLimits {
    pub shift_px: f32,
    pub correlation: f32,
}

/// Results of the patches of a row: shift in columns to the best agreement (beyond the reach if it is at its end), its
/// correlation, and the weight of the patch, 0 without texture.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowPeaks<'a> {
    pub offset: &'a [f32],
    pub correlation: &'a [f32],
    pub weight: &'a [f32],
}

wide! {
    fn judge(offset: &[f32], correlation: &[f32], weight: &[f32], limits: PeakLimits, verdict: &mut [u8]) = judge_kernel;
}

#[inline(always)]
fn judge_kernel(offset: &[f32], correlation: &[f32], weight: &[f32], limits: PeakLimits, verdict: &mut [u8]) {
    let peaks = offset.iter().zip(correlation).zip(weight);
    for (verdict, ((offset, correlation), weight)) in verdict.iter_mut().zip(peaks) {
        let agrees = (offset.abs() <= limits.shift_px) & (*correlation >= limits.correlation);
        let textured = if agrees { SUPPORTS | USABLE } else { 0 };
        *verdict = if *weight > 0.0 { textured } else { USABLE };
    }
}

wide! {
    fn spread_row(inside: &[u8], verdict: &[u8], correlation: &[f32], weight: &[f32], support: &mut [u8]) -> Tally<f64> = spread_row_kernel;
}

#[inline(always)]
fn spread_row_kernel(
    inside: &[u8],
    verdict: &[u8],
    correlation: &[f32],
    weight: &[f32],
    support: &mut [u8],
) -> Tally<f64> {
    for ((support, inside), verdict) in support.iter_mut().zip(inside).zip(verdict) {
        *support = inside * verdict;
    }
    let mut tally = Tally::ZERO;
    let pixels = inside.chunks_exact(LANES).zip(support.chunks_exact(LANES));
    let patches = correlation.chunks_exact(LANES).zip(weight.chunks_exact(LANES));
    for ((inside, support), (correlation, weight)) in pixels.zip(patches) {
        for i in 0..LANES {
            tally.count(i, inside[i], support[i], correlation[i], weight[i]);
        }
    }
    for at in inside.len() / LANES * LANES..inside.len() {
        tally.count(0, inside[at], support[at], correlation[at], weight[at]);
    }
    tally.folded()
}

named_sums! {
    /// Counts of pixels of the region: those with texture, those that support the plane, and the sum of the latter's
    /// correlations.
    pub(super) struct Tally { textured, supporting, correlation, }
}

impl Tally<[f32; LANES]> {
    #[inline(always)]
    fn count(&mut self, lane: usize, inside: u8, support: u8, correlation: f32, weight: f32) {
        let supports = if support & SUPPORTS != 0 { 1.0 } else { 0.0 };
        self.textured[lane] += if weight > 0.0 { f32::from(inside) } else { 0.0 };
        self.supporting[lane] += supports;
        self.correlation[lane] += supports * correlation;
    }
}

wide! {
    fn slide(sums: &mut [f32], a: &[f32], b: &[f32], a_old: &[f32], b_old: &[f32]) = slide_kernel;
}

#[inline(always)]
fn slide_kernel(sums: &mut [f32], a: &[f32], b: &[f32], a_old: &[f32], b_old: &[f32]) {
    for ((((sum, a), b), a_old), b_old) in sums.iter_mut().zip(a).zip(b).zip(a_old).zip(b_old) {
        *sum += a * b - a_old * b_old;
    }
}

wide! {
    fn row_sums(columns: &[f32], out: &mut [f32]) = row_sums_kernel;
}

#[inline(always)]
fn row_sums_kernel(columns: &[f32], out: &mut [f32]) {
    for (out, columns) in out.iter_mut().zip(columns.windows(SIDE)) {
        let pairs: [f32; SIDE / 2] = std::array::from_fn(|i| columns[2 * i] + columns[2 * i + 1]);
        *out =
            ((pairs[0] + pairs[1]) + (pairs[2] + pairs[3])) + ((pairs[4] + pairs[5]) + (pairs[6] + columns[SIDE - 1]));
    }
}

wide! {
    fn correlate(products: &mut [f32], left: &[f32], left_squared: &[f32], right: &[f32], right_squared: &[f32], floor: f32) = correlate_kernel;
}

/// Converts sums of products into correlations.
#[inline(always)]
fn correlate_kernel(
    products: &mut [f32],
    left: &[f32],
    left_squared: &[f32],
    right: &[f32],
    right_squared: &[f32],
    floor: f32,
) {
    let rest = left.iter().zip(left_squared).zip(right.iter().zip(right_squared));
    for (product, ((l, ll), (r, rr))) in products.iter_mut().zip(rest) {
        let covariance = *product - l * r * (1.0 / PATCH_PX);
        let left = (ll - l * l * (1.0 / PATCH_PX)).max(0.0) + floor;
        let right = (rr - r * r * (1.0 / PATCH_PX)).max(0.0) + floor;
        *product = covariance / (left * right).sqrt();
    }
}

wide! {
    fn find_peaks(correlations: &[Vec<f32>], reach: usize, offset: &mut [f32], correlation: &mut [f32]) = find_peaks_kernel;
}

/// The highest correlation and its sub-column position by a parabola; at an end of the reach: one column beyond.
#[inline(always)]
fn find_peaks_kernel(correlations: &[Vec<f32>], reach: usize, offset: &mut [f32], correlation: &mut [f32]) {
    correlation.copy_from_slice(&correlations[0]);
    offset.fill(-(reach as f32) - 1.0);
    for k in 1..=2 * reach {
        let end = k == 2 * reach;
        let next = if end { &correlations[k] } else { &correlations[k + 1] };
        let around = correlations[k - 1].iter().zip(&correlations[k]).zip(next);
        for ((offset, best), ((before, at), after)) in offset.iter_mut().zip(correlation.iter_mut()).zip(around) {
            let curvature = (2.0 * at - before - after).max(1e-6);
            let fraction = (0.5 * (after - before) / curvature).clamp(-0.5, 0.5);
            let place = if end { reach as f32 + 1.0 } else { k as f32 - reach as f32 + fraction };
            let better = *at > *best;
            *offset = if better { place } else { *offset };
            *best = if better { *at } else { *best };
        }
    }
}

wide! {
    fn weigh(left: &[f32], left_squared: &[f32], gradient: &[f32], texture: f32, half: f32, weight: &mut [f32]) = weigh_kernel;
}

#[inline(always)]
fn weigh_kernel(left: &[f32], left_squared: &[f32], gradient: &[f32], texture: f32, half: f32, weight: &mut [f32]) {
    for (((weight, l), ll), g) in weight.iter_mut().zip(left).zip(left_squared).zip(gradient) {
        let variation = ll - l * l * (1.0 / PATCH_PX);
        *weight = if variation < texture { 0.0 } else { g / (g + half) };
    }
}
