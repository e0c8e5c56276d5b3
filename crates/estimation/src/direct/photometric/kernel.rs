//! The inner loop: compares points of the left eye with the right eye and sums up the normal equations.
//!
//! Unknown are the plane `(d0, du, dv)` and a row offset, shared by all channels, and a gain and an offset of each channel.
//! With the gain split between the eyes, `r = s R(x - d, y + row) - L / s + offset`, both eyes are treated alike: the
//! derivative by the logarithm of the gain is the mean of both values, and the derivative by the disparity the mean of both
//! gradients (efficient second-order minimisation). Noise of a value is independent of the noise of a central difference
//! at the same place, so noisy gradients do not move the place where the sums of `gradient x residual` vanish.
#![allow(clippy::needless_range_loop, reason = "several arrays are walked in step")]

use crate::wide::{LANES, sum_lanes, wide};

/// Most channels.
pub(crate) const CHANNELS_MAX: usize = 4;
/// Number of sums per channel.
pub(crate) const SUMS: usize = 29;
/// Value of right pixels that must not be used: whatever touches one is an outlier beyond doubt.
pub(crate) const UNUSABLE: f32 = 1e6;

/// Points of the left eye, in groups of [`LANES`]; the last group is filled up with points of no weight.
#[derive(Clone, Debug, Default)]
pub(crate) struct PointSet {
    /// Column and row relative to the centre of the points, pixels of the level.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// 1, or 0 for a point that only fills up a group.
    pub unit: Vec<f32>,
    /// 1 for a point well inside the region, else 0.
    pub inner: Vec<f32>,
    /// First index of the point's row in the right planes.
    pub row_start: Vec<u32>,
    /// Value, and gradients along columns and rows, per channel.
    pub value: [Vec<f32>; CHANNELS_MAX],
    pub gradient_x: [Vec<f32>; CHANNELS_MAX],
    pub gradient_y: [Vec<f32>; CHANNELS_MAX],
}

/// What a channel is compared with.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ChannelState {
    /// Square root of the gain: the right values are multiplied, the left ones divided by it.
    pub gain_root: f64,
    /// Added to the difference, grey levels.
    pub offset: f64,
    /// Variance of the residuals of good points, squared grey levels.
    pub variance: f64,
}

/// A [`ChannelState`] for the inner loop.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shade {
    /// Right values and left values are multiplied by these.
    pub right: f32,
    pub left: f32,
    pub offset: f32,
    pub variance: f32,
}

impl From<&ChannelState> for Shade {
    fn from(state: &ChannelState) -> Self {
        Self {
            right: state.gain_root as f32,
            left: (1.0 / state.gain_root) as f32,
            offset: state.offset as f32,
            variance: state.variance as f32,
        }
    }
}

/// Where the points are looked up and how they are weighted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    /// Right column of the centre.
    pub column: f32,
    /// Right columns per left column and per left row.
    pub per_x: f32,
    pub per_y: f32,
    /// Row offset not yet in the right planes, pixels.
    pub row: f32,
    /// Columns of the right planes.
    pub width: usize,
    /// Number of channels.
    pub channels: usize,
    pub shades: [Shade; CHANNELS_MAX],
    /// Variance of the place at which a pixel samples the scene, squared pixels: gradient times this is noise.
    pub place_variance: f32,
    /// Tukey's limit of the sum over the channels of squared residuals over variances.
    pub limit: f32,
}

/// Sums over all points.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sums {
    /// Per channel; the order is that of [`terms`].
    pub channel: [[f64; SUMS]; CHANNELS_MAX],
    /// Sum of Tukey's weights.
    pub weight: f64,
    /// Number of points inside the right planes.
    pub seen: f64,
}

/// One group of points after the comparison, in `N` channels.
struct Group<const N: usize> {
    residual: [[f32; LANES]; N],
    gradient: [[f32; LANES]; N],
    /// Product of left and right gradient.
    product: [[f32; LANES]; N],
    mean: [[f32; LANES]; N],
    /// 1 / variance of the residual.
    certainty: [[f32; LANES]; N],
    /// Tukey's weight.
    weight: [f32; LANES],
    seen: [f32; LANES],
}

#[inline(always)]
fn lanes(values: &[f32], start: usize) -> &[f32; LANES] {
    values[start..].first_chunk().unwrap_or(&[0.0; LANES])
}

/// Looks up the four right pixels around every point.
#[inline(always)]
fn gather(plane: &[f32], at: &[u32; LANES], taps: &mut [[f32; LANES]; 4]) {
    for i in 0..LANES {
        let four: &[f32; 4] = plane.get(at[i] as usize..).and_then(|rest| rest.first_chunk()).unwrap_or(&[UNUSABLE; 4]);
        for j in 0..4 {
            taps[j][i] = four[j];
        }
    }
}

#[inline(always)]
fn compare<const N: usize>(points: &PointSet, start: usize, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Group<N> {
    let mut group = Group {
        residual: [[0.0; LANES]; N],
        gradient: [[0.0; LANES]; N],
        product: [[0.0; LANES]; N],
        mean: [[0.0; LANES]; N],
        certainty: [[0.0; LANES]; N],
        weight: [0.0; LANES],
        seen: [0.0; LANES],
    };
    let (x, y, unit) = (lanes(&points.x, start), lanes(&points.y, start), lanes(&points.unit, start));
    let rows: &[u32; LANES] = points.row_start[start..].first_chunk().unwrap_or(&[0; LANES]);
    let (mut at, mut t) = ([0_u32; LANES], [0.0_f32; LANES]);
    let last = warp.width as f32 - 3.0;
    for i in 0..LANES {
        let column = warp.column + warp.per_x * x[i] + warp.per_y * y[i];
        let inside = if column >= 1.0 && column < last { unit[i] } else { 0.0 };
        let column = column.max(1.0).min(last - 1.0);
        let whole = column as i32;
        t[i] = column - whole as f32;
        at[i] = rows[i].wrapping_add((whole - 1) as u32);
        group.seen[i] = inside;
    }
    let mut distance = [0.0_f32; LANES];
    let mut taps = [[0.0_f32; LANES]; 4];
    for c in 0..N {
        gather(right[c], &at, &mut taps);
        let shade = warp.shades[c];
        let (value, gx, gy) =
            (lanes(&points.value[c], start), lanes(&points.gradient_x[c], start), lanes(&points.gradient_y[c], start));
        for i in 0..LANES {
            // Catmull-Rom between the middle taps, and its slope.
            let (p0, p1, p2, p3) = (taps[0][i], taps[1][i], taps[2][i], taps[3][i]);
            let (c1, c2, c3) = (p2 - p0, 2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3, 3.0 * (p1 - p2) + p3 - p0);
            let shown = shade.right * (p1 + 0.5 * t[i] * (c1 + t[i] * (c2 + t[i] * c3)));
            let slope = shade.right * (0.5 * c1 + t[i] * (c2 + 1.5 * t[i] * c3));
            let (own, own_slope) = (shade.left * value[i], shade.left * gx[i]);
            let residual = shown - own + shade.offset + warp.row * shade.left * gy[i];
            let certainty = 1.0 / (shade.variance + warp.place_variance * (own_slope * own_slope));
            group.residual[c][i] = residual;
            group.gradient[c][i] = 0.5 * (slope + own_slope);
            group.product[c][i] = slope * own_slope;
            group.mean[c][i] = 0.5 * (shown + own);
            group.certainty[c][i] = certainty;
            distance[i] += residual * residual * certainty;
        }
    }
    let inverse_limit = 1.0 / warp.limit;
    for i in 0..LANES {
        let inner = (1.0 - distance[i] * inverse_limit).max(0.0);
        group.weight[i] = group.seen[i] * inner * inner;
    }
    group
}

/// Half the lanes of a group: what is summed up is folded once before.
const HALF: usize = LANES / 2;

#[inline(always)]
fn accumulate_kernel(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums {
    match warp.channels {
        1 => accumulate_channels::<1>(points, right, warp),
        2 => accumulate_channels::<2>(points, right, warp),
        3 => accumulate_channels::<3>(points, right, warp),
        _ => accumulate_channels::<4>(points, right, warp),
    }
}

#[inline(always)]
fn accumulate_channels<const N: usize>(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums {
    let mut sums = [[[0.0_f32; HALF]; SUMS]; N];
    let (mut weight, mut seen) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    for start in (0..points.x.len() / LANES).map(|g| g * LANES) {
        let group = compare::<N>(points, start, right, warp);
        let (x, y) = (lanes(&points.x, start), lanes(&points.y, start));
        for i in 0..LANES {
            weight[i] += group.weight[i];
            seen[i] += group.seen[i];
        }
        for c in 0..N {
            let gy = lanes(&points.gradient_y[c], start);
            let left = warp.shades[c].left;
            for i in 0..HALF {
                let one = terms(&group, c, i, x[i], y[i], left * gy[i]);
                let j = i + HALF;
                let other = terms(&group, c, j, x[j], y[j], left * gy[j]);
                for k in 0..SUMS {
                    sums[c][k][i] += one[k] + other[k];
                }
            }
        }
    }
    let mut channel = [[0.0; SUMS]; CHANNELS_MAX];
    for (channel, sums) in channel.iter_mut().zip(&sums) {
        *channel = sums.map(|lanes| lanes.iter().map(|&lane| f64::from(lane)).sum());
    }
    Sums { channel, weight: f64::from(sum_lanes(&weight)), seen: f64::from(sum_lanes(&seen)) }
}

/// What one point adds to the sums of a channel; `h` is the gradient along rows.
#[inline(always)]
fn terms<const N: usize>(group: &Group<N>, c: usize, i: usize, x: f32, y: f32, h: f32) -> [f32; SUMS] {
    let (g, m, r) = (group.gradient[c][i], group.mean[c][i], group.residual[c][i]);
    let w = group.weight[i] * group.certainty[c][i];
    let wg = w * g;
    let (wgx, wgy, wh, wm, wr) = (wg * x, wg * y, w * h, w * m, w * r);
    [
        // Gradient by gradient, times 1, x, y, x x, x y, y y.
        wg * g,
        wgx * g,
        wgy * g,
        wgx * g * x,
        wgx * g * y,
        wgy * g * y,
        // Gradient by residual, by mean and alone, times 1, x, y.
        wg * r,
        wgx * r,
        wgy * r,
        wg * m,
        wgx * m,
        wgy * m,
        wg,
        wgx,
        wgy,
        // Gain and offset.
        wm * m,
        wm,
        w,
        wm * r,
        wr,
        // Left by right gradient, and the squared residual.
        w * group.product[c][i],
        wr * r,
        // Row offset by gradient (times 1, x, y), itself, mean, one, residual.
        wh * g,
        wgx * h,
        wgy * h,
        wh * h,
        wh * m,
        wh,
        wh * r,
    ]
}

wide! {
    /// The normal equations at one place; `right` holds a plane per channel.
    pub(crate) fn accumulate(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums = accumulate_kernel;
}

/// How the derivatives of a point become its score: weight of the channel, and what gain and offset take up of each of the
/// four derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Projection {
    pub weight: f32,
    pub mean: [f32; 4],
    pub one: [f32; 4],
}

#[inline(always)]
fn scores_kernel(
    points: &PointSet,
    right: &[&[f32]; CHANNELS_MAX],
    warp: &Warp,
    projections: &[Projection; CHANNELS_MAX],
    scores: &mut [Vec<f32>; 4],
) {
    match warp.channels {
        1 => score_channels::<1>(points, right, warp, projections, scores),
        2 => score_channels::<2>(points, right, warp, projections, scores),
        3 => score_channels::<3>(points, right, warp, projections, scores),
        _ => score_channels::<4>(points, right, warp, projections, scores),
    }
}

#[inline(always)]
fn score_channels<const N: usize>(
    points: &PointSet,
    right: &[&[f32]; CHANNELS_MAX],
    warp: &Warp,
    projections: &[Projection; CHANNELS_MAX],
    scores: &mut [Vec<f32>; 4],
) {
    for start in (0..points.x.len() / LANES).map(|g| g * LANES) {
        let group = compare::<N>(points, start, right, warp);
        let (x, y) = (lanes(&points.x, start), lanes(&points.y, start));
        let mut sums = [[0.0_f32; LANES]; 4];
        for (c, p) in projections.iter().enumerate().take(N) {
            let left = warp.shades[c].left;
            let gy = lanes(&points.gradient_y[c], start);
            for i in 0..LANES {
                let wr = p.weight * group.weight[i] * group.certainty[c][i] * group.residual[c][i];
                let (g, m) = (-group.gradient[c][i], group.mean[c][i]);
                let own = [g, g * x[i], g * y[i], left * gy[i]];
                for k in 0..4 {
                    sums[k][i] += wr * (own[k] - p.mean[k] * m - p.one[k]);
                }
            }
        }
        for (scores, sums) in scores.iter_mut().zip(&sums) {
            scores[start..start + LANES].copy_from_slice(sums);
        }
    }
}

wide! {
    /// The gradient of the cost by `(d0, du, dv, row)`, point by point, with gain and offset eliminated.
    pub(crate) fn scores(
        points: &PointSet,
        right: &[&[f32]; CHANNELS_MAX],
        warp: &Warp,
        projections: &[Projection; CHANNELS_MAX],
        scores: &mut [Vec<f32>; 4],
    ) = scores_kernel;
}
