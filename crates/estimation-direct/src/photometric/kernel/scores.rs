//! Scores (gradients of the cost) of single points.

use pb3dp_estimation_core::wide::{LANES, sum_lanes, wide};

use super::compare::{Group, Lanes, lanes};
use super::sums::Places;
use super::{CHANNELS_MAX, PointSet, SHARING, Warp};

/// Conversion of a point's derivatives into its score: weight of the channel, and the share of each of the four derivatives
/// that the gain takes up.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Projection {
    pub weight: f32,
    pub mean: [f32; 4],
}

/// Total scores due to image differences that the model does not include.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Unmodelled {
    /// A row offset of one pixel per column.
    pub row_by_column: [f64; 4],
    /// A row offset of one pixel per row, relative to the centre.
    pub row_by_row: [f64; 4],
    /// An additional blur of one image along the rows, with a variance of one squared pixel.
    pub blur: [f64; 4],
}

/// Lane sums over a group: a factor times the weights, alone and times each of the four derivatives.
#[derive(Clone, Copy)]
struct FactorSums {
    alone: Lanes,
    by_derivative: [Lanes; 4],
}

impl FactorSums {
    const ZERO: Self = Self { alone: [0.0; LANES], by_derivative: [[0.0; LANES]; 4] };

    #[inline(always)]
    fn add(&mut self, lane: usize, factor: f32, derivatives: [f32; 4]) {
        self.alone[lane] += factor;
        for (sums, derivative) in self.by_derivative.iter_mut().zip(derivatives) {
            sums[lane] += factor * derivative;
        }
    }
}

#[inline(always)]
fn scores_kernel(
    points: &PointSet,
    right: &[&[f32]; CHANNELS_MAX],
    warp: &Warp,
    projections: &[Projection; CHANNELS_MAX],
    scores: &mut [Vec<f32>; 4],
) -> Unmodelled {
    match warp.channels {
        1 => score_channels::<1>(points, right, warp, projections, scores),
        2 => score_channels::<2>(points, right, warp, projections, scores),
        _ => score_channels::<3>(points, right, warp, projections, scores),
    }
}

#[inline(always)]
fn score_channels<const N: usize>(
    points: &PointSet,
    right: &[&[f32]; CHANNELS_MAX],
    warp: &Warp,
    projections: &[Projection; CHANNELS_MAX],
    scores: &mut [Vec<f32>; 4],
) -> Unmodelled {
    let mut group = Group::<N>::empty();
    let mut unmodelled = Unmodelled::default();
    for index in 0..points.x.len() / SHARING {
        let first = index * SHARING;
        group.compare(points, first, right, warp);
        let mut out = [[0.0_f32; SHARING]; 4];
        for c in 0..N {
            let places = Places::new(points, first, c, warp);
            add_scores(&group, c, &places, &projections[c], &mut out, &mut unmodelled);
        }
        for (scores, out) in scores.iter_mut().zip(&out) {
            scores[first..first + SHARING].copy_from_slice(out);
        }
    }
    unmodelled
}

/// Adds the scores of a channel of a group with respect to `(d0, du, dv, row)`, and the scores with each unmodelled difference
/// in place of the residuals; the shares of the gain and of the group's offset are removed.
#[inline(always)]
fn add_scores<const N: usize>(
    group: &Group<N>,
    c: usize,
    places: &Places<'_>,
    p: &Projection,
    out: &mut [[f32; SHARING]; 4],
    unmodelled: &mut Unmodelled,
) {
    let own = &group.channel[c];
    // Sums of the weights themselves, and of the residuals times weights.
    let (mut sums, mut residuals) = (FactorSums::ZERO, [0.0_f32; LANES]);
    let mut derivatives = [[0.0_f32; SHARING]; 4];
    let mut differences = [[0.0_f32; SHARING]; 3];
    let mut difference_sums = [FactorSums::ZERO; 3];
    for i in 0..SHARING {
        let (g, m, gy) = (own.gradient[i], own.mean[i], places.left * places.gradient_y[i]);
        derivatives[0][i] = -g - p.mean[0] * m;
        derivatives[1][i] = -g * places.x[i] - p.mean[1] * m;
        derivatives[2][i] = -g * places.y[i] - p.mean[2] * m;
        derivatives[3][i] = gy - p.mean[3] * m;
        differences[0][i] = gy * places.x[i];
        differences[1][i] = gy * places.y[i];
        differences[2][i] = places.left * 0.5 * places.curvature[i];
    }
    for k in 0..SHARING / LANES {
        let (weight, certainty, residual) =
            (lanes(&group.weight, k), lanes(&own.certainty, k), lanes(&own.residual, k));
        let [d0, d1, d2, d3] = [0, 1, 2, 3].map(|j| lanes(&derivatives[j], k));
        for i in 0..LANES {
            let w = weight[i] * certainty[i];
            sums.add(i, w, [d0[i], d1[i], d2[i], d3[i]]);
            residuals[i] += w * residual[i];
        }
        for (difference, sums) in differences.iter().zip(&mut difference_sums) {
            let difference = lanes(difference, k);
            for i in 0..LANES {
                let pull = weight[i] * certainty[i] * difference[i];
                sums.add(i, pull, [d0[i], d1[i], d2[i], d3[i]]);
            }
        }
    }
    let weight = sum_lanes(&sums.alone).max(f32::MIN_POSITIVE);
    let mean_residual = sum_lanes(&residuals) / weight;
    let means: [f32; 4] = std::array::from_fn(|k| sum_lanes(&sums.by_derivative[k]) / weight);
    for i in 0..SHARING {
        let pull = p.weight * (group.weight[i] * own.certainty[i]) * (own.residual[i] - mean_residual);
        for j in 0..4 {
            out[j][i] += pull * (derivatives[j][i] - means[j]);
        }
    }
    let Unmodelled { row_by_column, row_by_row, blur } = unmodelled;
    for (scores, sums) in [row_by_column, row_by_row, blur].into_iter().zip(&difference_sums) {
        let pull = sum_lanes(&sums.alone);
        for j in 0..4 {
            scores[j] += f64::from(p.weight * (sum_lanes(&sums.by_derivative[j]) - pull * means[j]));
        }
    }
}

wide! {
    /// The gradient of the cost with respect to `(d0, du, dv, row)`, point by point, with gains and offsets eliminated. Returns
    /// the total gradient due to unmodelled differences between the images.
    pub(crate) fn scores(
        points: &PointSet,
        right: &[&[f32]; CHANNELS_MAX],
        warp: &Warp,
        projections: &[Projection; CHANNELS_MAX],
        scores: &mut [Vec<f32>; 4],
    ) -> Unmodelled = scores_kernel;
}
