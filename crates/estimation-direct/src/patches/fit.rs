//! Robust fit of a plane through the votes of patches.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::{LANES, wide};

use crate::named_sums::PlaneSums;

/// Votes `(x, y, offset, weight)`.
#[derive(Clone, Debug, Default)]
pub(super) struct PatchVotes {
    x: Vec<f32>,
    y: Vec<f32>,
    offset: Vec<f32>,
    weight: Vec<f32>,
}

impl PatchVotes {
    pub(super) fn clear(&mut self) {
        for values in [&mut self.x, &mut self.y, &mut self.offset, &mut self.weight] {
            values.clear();
        }
    }

    pub(super) fn push(&mut self, x: f32, y: f32, offset: f32, weight: f32) {
        self.x.push(x);
        self.y.push(y);
        self.offset.push(offset);
        self.weight.push(weight);
    }

    /// Adds the votes of a row from pixel `(x, y)` on; those outside the region get no weight.
    pub(super) fn extend_row(&mut self, x: usize, y: usize, inside: &[u8], offset: &[f32], weight: &[f32]) {
        self.x.extend((x..x + inside.len()).map(|x| x as f32));
        self.y.resize(self.x.len(), y as f32);
        self.offset.extend_from_slice(offset);
        self.weight.extend(inside.iter().zip(weight).map(|(inside, weight)| f32::from(*inside) * weight));
    }

    pub(super) fn len(&self) -> usize {
        self.x.len()
    }

    /// The plane through three votes; `None` if they are collinear.
    pub(super) fn through(&self, votes: [usize; 3]) -> Option<[f64; 3]> {
        let row = |i: usize| [1.0, f64::from(self.x[i]), f64::from(self.y[i])];
        let offset = Vector3::from(votes.map(|i| f64::from(self.offset[i])));
        let plane = Matrix3::from(votes.map(row)).transpose().try_inverse()? * offset;
        plane.iter().all(|v| v.is_finite()).then(|| plane.into())
    }

    /// Largest distance between two planes at the corners of the box around all votes with weight.
    pub(super) fn gap(&self, a: &[f64; 3], b: &[f64; 3]) -> f64 {
        let places = || self.x.iter().zip(&self.y).zip(&self.weight).filter(|(_, weight)| **weight > 0.0);
        let ends = |values: &mut dyn Iterator<Item = f32>| {
            values.fold((f32::MAX, f32::MIN), |(low, high), value| (low.min(value), high.max(value)))
        };
        let (x, y) = (ends(&mut places().map(|((x, _), _)| *x)), ends(&mut places().map(|((_, y), _)| *y)));
        let gap = |x: f32, y: f32| (a[0] - b[0] + (a[1] - b[1]) * f64::from(x) + (a[2] - b[2]) * f64::from(y)).abs();
        gap(x.0, y.0).max(gap(x.1, y.0)).max(gap(x.0, y.1)).max(gap(x.1, y.1))
    }

    /// Spreads the offsets of votes that were taken every `step` pixels over a grid, without their plane of least squares; NaN without a
    /// vote. Returns the grid's columns, and the number of places that are at least `apart` pixels. `None` if the votes determine no plane.
    pub(super) fn spread_over(&self, step: usize, apart: usize, grid: &mut Vec<f32>) -> Option<(usize, usize)> {
        let votes = || {
            let places = self.x.iter().zip(&self.y).zip(&self.offset);
            places.zip(&self.weight).filter(|(_, weight)| **weight > 0.0).map(|(((x, y), offset), _)| (*x, *y, *offset))
        };
        let row = |x: f32, y: f32| Vector3::new(1.0, f64::from(x), f64::from(y));
        let (mut squares, mut pull) = (Matrix3::zeros(), Vector3::zeros());
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (x, y, offset) in votes() {
            squares += row(x, y) * row(x, y).transpose();
            pull += row(x, y) * f64::from(offset);
            (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]);
        }
        let plane = squares.try_inverse()? * pull;
        let index = |value: f32, low: f32| ((value - low) as usize) / step.max(1);
        let (columns, rows) = (index(high[0], low[0]) + 1, index(high[1], low[1]) + 1);
        grid.clear();
        grid.resize(columns * rows, f32::NAN);
        for (x, y, offset) in votes() {
            grid[index(y, low[1]) * columns + index(x, low[0])] = offset - plane.dot(&row(x, y)) as f32;
        }
        Some((columns, apart.div_ceil(step.max(1))))
    }

    /// Fills the last group with votes of no weight.
    pub(super) fn pad(&mut self) {
        while !self.x.len().is_multiple_of(LANES) {
            self.push(0.0, 0.0, 0.0, 0.0);
        }
    }
}

/// Number of re-weighting steps. Chosen by hand, not varied: time grows with it; outliers keep some weight in the first
/// steps.
const STEPS: usize = 4;

/// Fits `offset = p0 + p1 x + p2 y` with Tukey's weights, whose width shrinks to `width_px`; `None` if the votes do not
/// determine a plane.
pub(super) fn fit_votes(votes: &mut PatchVotes, width_px: f64, kernels: Kernels) -> Option<[f64; 3]> {
    votes.pad();
    let mut plane = Vector3::zeros();
    for step in 0..STEPS {
        let width = width_px * if step == 0 { 2.0 } else { 1.33 };
        let p: [f32; 3] = std::array::from_fn(|k| plane[k] as f32);
        let scale = (1.0 / (width * width)) as f32;
        let sums = sums(kernels, &votes.x, &votes.y, &votes.offset, &votes.weight, p, scale);
        // The weight of twenty pixels of sharp patches.
        if sums.w < 20.0 {
            return None;
        }
        plane += sums.step()?;
    }
    plane.iter().all(|v| v.is_finite()).then(|| plane.into())
}

/// Total weight of the votes near a plane, by Tukey's weights of this width.
pub(super) fn weight_near(votes: &PatchVotes, plane: &[f64; 3], width_px: f64, kernels: Kernels) -> f64 {
    weighted(votes, plane, width_px, kernels).w
}

/// A plane moved to the centre of the votes near it; `None` if they do not determine one.
pub(super) fn improve(votes: &PatchVotes, plane: &[f64; 3], width_px: f64, kernels: Kernels) -> Option<[f64; 3]> {
    let moved = Vector3::from(*plane) + weighted(votes, plane, width_px, kernels).step()?;
    moved.iter().all(|v| v.is_finite()).then(|| moved.into())
}

/// Weighted sums over padded votes.
fn weighted(votes: &PatchVotes, plane: &[f64; 3], width_px: f64, kernels: Kernels) -> PlaneSums<f64> {
    let scale = (1.0 / (width_px * width_px)) as f32;
    sums(kernels, &votes.x, &votes.y, &votes.offset, &votes.weight, plane.map(|p| p as f32), scale)
}

wide! {
    fn sums(x: &[f32], y: &[f32], offset: &[f32], weight: &[f32], plane: [f32; 3], scale: f32) -> PlaneSums<f64> = sums_kernel;
}

#[inline(always)]
fn sums_kernel(x: &[f32], y: &[f32], offset: &[f32], weight: &[f32], plane: [f32; 3], scale: f32) -> PlaneSums<f64> {
    let mut sums = PlaneSums::ZERO;
    let places = x.chunks_exact(LANES).zip(y.chunks_exact(LANES));
    let votes = offset.chunks_exact(LANES).zip(weight.chunks_exact(LANES));
    for ((x, y), (offset, weight)) in places.zip(votes) {
        for i in 0..LANES {
            let r = offset[i] - (plane[0] + plane[1] * x[i] + plane[2] * y[i]);
            let inlier = (1.0 - r * r * scale).max(0.0);
            let w = weight[i] * inlier * inlier;
            sums.add(i, x[i], y[i], w, w * r);
        }
    }
    sums.folded()
}
