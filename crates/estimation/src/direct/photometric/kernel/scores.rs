//! What every point pulls.

use super::compare::{Group, Row, lanes};
use super::sums::Places;
use super::{CHANNELS_MAX, PointSet, SHARING, Warp};
use crate::wide::{LANES, sum_lanes, wide};

/// How the derivatives of a point become its score: weight of the channel, and what the gain takes up of each of the four
/// derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Projection {
    pub weight: f32,
    pub mean: [f32; 4],
}

/// What the scores would be in all if both eyes differed in ways that the model leaves out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Unmodelled {
    /// Rows off by a pixel per column.
    pub row_by_column: [f64; 4],
    /// Rows off by a pixel per row, beyond the middle.
    pub row_by_row: [f64; 4],
    /// One eye blurred along the rows by a variance of one squared pixel more.
    pub blur: [f64; 4],
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
            add_scores(&group, c, &places, &projections[c], &group.channel[c].residual, &mut out);
            add_unmodelled(&group, c, &places, &projections[c], &mut unmodelled);
        }
        for (scores, out) in scores.iter_mut().zip(&out) {
            scores[first..first + SHARING].copy_from_slice(out);
        }
    }
    unmodelled
}

/// Adds what a channel of a group would pull in all with the residuals of each of these differences.
#[inline(always)]
fn add_unmodelled<const N: usize>(
    group: &Group<N>,
    c: usize,
    places: &Places<'_>,
    p: &Projection,
    unmodelled: &mut Unmodelled,
) {
    let (mut by_column, mut by_row, mut blurred) = ([0.0; SHARING], [0.0; SHARING], [0.0; SHARING]);
    for i in 0..SHARING {
        let gradient_y = places.left * places.gradient_y[i];
        by_column[i] = gradient_y * places.x[i];
        by_row[i] = gradient_y * places.y[i];
        blurred[i] = places.left * 0.5 * places.curvature[i];
    }
    let Unmodelled { row_by_column, row_by_row, blur } = unmodelled;
    for (sums, residuals) in [(row_by_column, &by_column), (row_by_row, &by_row), (blur, &blurred)] {
        let mut out = [[0.0; SHARING]; 4];
        add_scores(group, c, places, p, residuals, &mut out);
        for (sum, out) in sums.iter_mut().zip(&out) {
            *sum += out.iter().map(|score| f64::from(*score)).sum::<f64>();
        }
    }
}

/// Adds what a channel of a group with these residuals pulls at `(d0, du, dv, row)`, without what the gain and the group's
/// offset take up.
#[inline(always)]
fn add_scores<const N: usize>(
    group: &Group<N>,
    c: usize,
    places: &Places<'_>,
    p: &Projection,
    residuals: &Row,
    out: &mut [[f32; SHARING]; 4],
) {
    let own = &group.channel[c];
    // Sums of weights, and of residuals and derivatives times weights.
    let mut sums = [[0.0_f32; LANES]; 6];
    let mut derivatives = [[0.0_f32; SHARING]; 4];
    for i in 0..SHARING {
        let (g, m) = (own.gradient[i], own.mean[i]);
        derivatives[0][i] = -g - p.mean[0] * m;
        derivatives[1][i] = -g * places.x[i] - p.mean[1] * m;
        derivatives[2][i] = -g * places.y[i] - p.mean[2] * m;
        derivatives[3][i] = places.left * places.gradient_y[i] - p.mean[3] * m;
    }
    for k in 0..SHARING / LANES {
        let (weight, certainty, residual) = (lanes(&group.weight, k), lanes(&own.certainty, k), lanes(residuals, k));
        let [d0, d1, d2, d3] = [0, 1, 2, 3].map(|j| lanes(&derivatives[j], k));
        for i in 0..LANES {
            let w = weight[i] * certainty[i];
            sums[0][i] += w;
            sums[1][i] += w * residual[i];
            sums[2][i] += w * d0[i];
            sums[3][i] += w * d1[i];
            sums[4][i] += w * d2[i];
            sums[5][i] += w * d3[i];
        }
    }
    let weight = sum_lanes(&sums[0]).max(f32::MIN_POSITIVE);
    let means: [f32; 6] = std::array::from_fn(|k| sum_lanes(&sums[k]) / weight);
    for i in 0..SHARING {
        let pull = p.weight * (group.weight[i] * own.certainty[i]) * (residuals[i] - means[1]);
        for j in 0..4 {
            out[j][i] += pull * (derivatives[j][i] - means[2 + j]);
        }
    }
}

wide! {
    /// The gradient of the cost by `(d0, du, dv, row)`, point by point, with gains and offsets eliminated; returns what it
    /// would be in all if the eyes differed in ways that are not modelled.
    pub(crate) fn scores(
        points: &PointSet,
        right: &[&[f32]; CHANNELS_MAX],
        warp: &Warp,
        projections: &[Projection; CHANNELS_MAX],
        scores: &mut [Vec<f32>; 4],
    ) -> Unmodelled = scores_kernel;
}
