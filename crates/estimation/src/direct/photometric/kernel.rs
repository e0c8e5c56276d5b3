//! The inner loop: compares points of the left eye with the right eye and sums up the normal equations.
//!
//! Unknown are the plane `(d0, du, dv)` and a row offset, shared by all channels, and a gain and an offset of each channel.
//! With the gain split between the eyes, `r = s R(x - d, y + row) - L / s + offset`, both eyes are treated alike: the
//! derivative by the logarithm of the gain is the mean of both values, and the derivative by the disparity the mean of both
//! gradients (efficient second-order minimisation). Noise of a value is independent of the noise of a central difference
//! at the same place, so noisy gradients do not move the place where the sums of `gradient x residual` vanish.

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
    pub states: [ChannelState; CHANNELS_MAX],
    /// Variance of the place at which a pixel samples the scene, squared pixels: gradient times this is noise.
    pub place_variance: f32,
    /// Tukey's limit of the sum over the channels of squared residuals over variances.
    pub limit: f32,
}

/// Sums over all points.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sums {
    /// Per channel; the names of the indices are those of [`accumulate_kernel`].
    pub channel: [[f64; SUMS]; CHANNELS_MAX],
    /// Sum of Tukey's weights.
    pub weight: f64,
    /// Number of points inside the right planes.
    pub seen: f64,
}

/// One group of points after the comparison.
struct Group {
    residual: [[f32; LANES]; CHANNELS_MAX],
    gradient: [[f32; LANES]; CHANNELS_MAX],
    /// Product of left and right gradient.
    product: [[f32; LANES]; CHANNELS_MAX],
    mean: [[f32; LANES]; CHANNELS_MAX],
    /// 1 / variance of the residual.
    certainty: [[f32; LANES]; CHANNELS_MAX],
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
fn compare(points: &PointSet, start: usize, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Group {
    let mut group = Group {
        residual: [[0.0; LANES]; CHANNELS_MAX],
        gradient: [[0.0; LANES]; CHANNELS_MAX],
        product: [[0.0; LANES]; CHANNELS_MAX],
        mean: [[0.0; LANES]; CHANNELS_MAX],
        certainty: [[0.0; LANES]; CHANNELS_MAX],
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
    for c in 0..warp.channels {
        gather(right[c], &at, &mut taps);
        let state = &warp.states[c];
        let (gain, back) = (state.gain_root as f32, (1.0 / state.gain_root) as f32);
        let (offset, variance) = (state.offset as f32, state.variance as f32);
        let (value, gx, gy) =
            (lanes(&points.value[c], start), lanes(&points.gradient_x[c], start), lanes(&points.gradient_y[c], start));
        for i in 0..LANES {
            // Catmull-Rom between the middle taps, and its slope.
            let (p0, p1, p2, p3) = (taps[0][i], taps[1][i], taps[2][i], taps[3][i]);
            let (c1, c2, c3) = (p2 - p0, 2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3, 3.0 * (p1 - p2) + p3 - p0);
            let shown = gain * (p1 + 0.5 * t[i] * (c1 + t[i] * (c2 + t[i] * c3)));
            let slope = gain * (0.5 * c1 + t[i] * (c2 + 1.5 * t[i] * c3));
            let (own, own_slope) = (back * value[i], back * gx[i]);
            let residual = shown - own + offset + warp.row * back * gy[i];
            let gradient = 0.5 * (slope + own_slope);
            let certainty = 1.0 / (variance + warp.place_variance * (own_slope * own_slope));
            group.residual[c][i] = residual;
            group.gradient[c][i] = gradient;
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

#[inline(always)]
fn accumulate_kernel(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums {
    let mut sums = [[[0.0_f32; LANES]; SUMS]; CHANNELS_MAX];
    let (mut weight, mut seen) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    for start in (0..points.x.len() / LANES).map(|g| g * LANES) {
        let group = compare(points, start, right, warp);
        let (x, y) = (lanes(&points.x, start), lanes(&points.y, start));
        for i in 0..LANES {
            weight[i] += group.weight[i];
            seen[i] += group.seen[i];
        }
        for (c, sums) in sums.iter_mut().enumerate().take(warp.channels) {
            let back = (1.0 / warp.states[c].gain_root) as f32;
            let gy = lanes(&points.gradient_y[c], start);
            let (g, m, r) = (&group.gradient[c], &group.mean[c], &group.residual[c]);
            for i in 0..LANES {
                let w = group.weight[i] * group.certainty[c][i];
                let (x, y) = (x[i], y[i]);
                let (wg, h) = (w * g[i], back * gy[i]);
                let (wgx, wgy, wh) = (wg * x, wg * y, w * h);
                let (wm, wr) = (w * m[i], w * r[i]);
                // Gradient by gradient, times 1, x, y, x x, x y, y y.
                sums[0][i] += wg * g[i];
                sums[1][i] += wgx * g[i];
                sums[2][i] += wgy * g[i];
                sums[3][i] += wgx * g[i] * x;
                sums[4][i] += wgx * g[i] * y;
                sums[5][i] += wgy * g[i] * y;
                // Gradient by residual, by mean and alone, times 1, x, y.
                sums[6][i] += wg * r[i];
                sums[7][i] += wgx * r[i];
                sums[8][i] += wgy * r[i];
                sums[9][i] += wg * m[i];
                sums[10][i] += wgx * m[i];
                sums[11][i] += wgy * m[i];
                sums[12][i] += wg;
                sums[13][i] += wgx;
                sums[14][i] += wgy;
                // Gain and offset.
                sums[15][i] += wm * m[i];
                sums[16][i] += wm;
                sums[17][i] += w;
                sums[18][i] += wm * r[i];
                sums[19][i] += wr;
                // Left by right gradient, and the squared residual.
                sums[20][i] += w * group.product[c][i];
                sums[21][i] += wr * r[i];
                // Row offset by gradient (times 1, x, y), itself, mean, one, residual.
                sums[22][i] += wh * g[i];
                sums[23][i] += wgx * h;
                sums[24][i] += wgy * h;
                sums[25][i] += wh * h;
                sums[26][i] += wh * m[i];
                sums[27][i] += wh;
                sums[28][i] += wh * r[i];
            }
        }
    }
    Sums {
        channel: sums.map(|channel| channel.map(|lanes| f64::from(sum_lanes(&lanes)))),
        weight: f64::from(sum_lanes(&weight)),
        seen: f64::from(sum_lanes(&seen)),
    }
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
    for start in (0..points.x.len() / LANES).map(|g| g * LANES) {
        let group = compare(points, start, right, warp);
        let (x, y) = (lanes(&points.x, start), lanes(&points.y, start));
        let mut sums = [[0.0_f32; LANES]; 4];
        for (c, p) in projections.iter().enumerate().take(warp.channels) {
            let back = (1.0 / warp.states[c].gain_root) as f32;
            let gy = lanes(&points.gradient_y[c], start);
            for i in 0..LANES {
                let wr = p.weight * group.weight[i] * group.certainty[c][i] * group.residual[c][i];
                let (g, m) = (-group.gradient[c][i], group.mean[c][i]);
                let own = [g, g * x[i], g * y[i], back * gy[i]];
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
