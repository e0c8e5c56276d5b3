//! The inner loop: compares points of the left eye with the right eye and sums up the normal equations.
//!
//! Unknown are the plane `(d0, du, dv)` and a row offset, shared by all channels, and of each channel a gain, and an offset for
//! every 128 points: light that does not turn with the surface, and highlights, differ between the eyes, but smoothly. What is
//! summed up is what these offsets leave of values, gradients and residuals.
//! With the gain split between the eyes, `r = s R(x - d, y + row) - L / s + offset`, the derivative by the logarithm of the
//! gain is the mean of both values. The derivative by the disparity is the gradient of the left eye alone: at a pixel, noise
//! of a value is independent of the noise of the slope, so noisy gradients do not move the place where the sums of `gradient x
//! residual` vanish. Between pixels it is not, because interpolation smooths noise by more the farther a pixel is: with the
//! right gradients a plane that faces the cameras, where all points lie at one fraction of a pixel, would be drawn to whole
//! pixels.
#![allow(clippy::needless_range_loop, reason = "several arrays are walked in step")]

use crate::wide::{LANES, sum_lanes, wide};

/// Most channels.
pub(crate) const CHANNELS_MAX: usize = 3;
/// Number of sums per channel.
pub(crate) const SUMS: usize = 30;
/// Value of pixels that must not be used in a channel; whatever touches one is left out.
pub(crate) const UNUSABLE: f32 = 1e6;
/// Values from here on have been touched.
pub(crate) const TOUCHED: f32 = 0.01 * UNUSABLE;

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
    /// Value (or [`UNUSABLE`]), gradients along columns and rows, and second derivative along columns, per channel.
    pub value: [Vec<f32>; CHANNELS_MAX],
    pub gradient_x: [Vec<f32>; CHANNELS_MAX],
    pub gradient_y: [Vec<f32>; CHANNELS_MAX],
    pub curvature: [Vec<f32>; CHANNELS_MAX],
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
    /// 1 / variance of the residual; 0 where the channel can not be used.
    certainty: [[f32; LANES]; N],
    /// 1, or 0 where the channel can not be used.
    usable: [[f32; LANES]; N],
    /// Right gradient squared minus left gradient squared.
    excess: [[f32; LANES]; N],
    /// Second derivative of the right eye along columns.
    bend: [[f32; LANES]; N],
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

/// Compares a group of points; `group` is overwritten.
#[inline(always)]
fn compare<const N: usize>(
    points: &PointSet,
    start: usize,
    right: &[&[f32]; CHANNELS_MAX],
    warp: &Warp,
    group: &mut Group<N>,
) {
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
    let mut any = [0.0_f32; LANES];
    let mut taps = [[0.0_f32; LANES]; 4];
    for c in 0..N {
        gather(right[c], &at, &mut taps);
        let shade = warp.shades[c];
        let (value, gx, gy) =
            (lanes(&points.value[c], start), lanes(&points.gradient_x[c], start), lanes(&points.gradient_y[c], start));
        for i in 0..LANES {
            // The uniform cubic B-spline of the four coefficients, its slope and its second derivative.
            let (p0, p1, p2, p3) = (taps[0][i], taps[1][i], taps[2][i], taps[3][i]);
            let worst = p0.max(p1).max(p2).max(p3).max(value[i]);
            let usable = if worst < TOUCHED { 1.0 } else { 0.0 };
            let (c0, c1) = ((p0 + 4.0 * p1 + p2) * (1.0 / 6.0), 0.5 * (p2 - p0));
            let (c2, c3) = (0.5 * (p0 + p2) - p1, (p3 - p0) * (1.0 / 6.0) + 0.5 * (p1 - p2));
            let shown = shade.right * (c0 + t[i] * (c1 + t[i] * (c2 + t[i] * c3)));
            let slope = shade.right * (c1 + t[i] * (2.0 * c2 + 3.0 * t[i] * c3));
            let (own, own_slope) = (shade.left * value[i], shade.left * gx[i]);
            let residual = shown - own + shade.offset + warp.row * shade.left * gy[i];
            let certainty = usable / (shade.variance + warp.place_variance * (own_slope * own_slope));
            group.residual[c][i] = residual;
            group.gradient[c][i] = own_slope;
            group.product[c][i] = slope * own_slope;
            group.mean[c][i] = 0.5 * (shown + own);
            group.certainty[c][i] = certainty;
            group.usable[c][i] = usable;
            group.excess[c][i] = slope * slope - own_slope * own_slope;
            group.bend[c][i] = shade.right * (2.0 * c2 + 6.0 * t[i] * c3);
            distance[i] += residual * residual * certainty;
            any[i] = usable.max(any[i]);
        }
    }
    let inverse_limit = 1.0 / warp.limit;
    for i in 0..LANES {
        let inner = (1.0 - distance[i] * inverse_limit).max(0.0);
        group.seen[i] *= any[i];
        group.weight[i] = group.seen[i] * inner * inner;
    }
}

impl<const N: usize> Group<N> {
    #[inline(always)]
    fn empty() -> Self {
        Self {
            residual: [[0.0; LANES]; N],
            gradient: [[0.0; LANES]; N],
            product: [[0.0; LANES]; N],
            mean: [[0.0; LANES]; N],
            certainty: [[0.0; LANES]; N],
            usable: [[0.0; LANES]; N],
            excess: [[0.0; LANES]; N],
            bend: [[0.0; LANES]; N],
            weight: [0.0; LANES],
            seen: [0.0; LANES],
        }
    }
}

/// Half the lanes of a group: what is summed up is folded once before.
const HALF: usize = LANES / 2;
/// Points that share an offset: they are ordered by blocks of 8 x 8 pixels, so these are neighbours.
const SHARING: usize = 8 * LANES;

#[inline(always)]
fn accumulate_kernel(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums {
    match warp.channels {
        1 => accumulate_channels::<1>(points, right, warp),
        2 => accumulate_channels::<2>(points, right, warp),
        _ => accumulate_channels::<3>(points, right, warp),
    }
}

#[inline(always)]
fn accumulate_channels<const N: usize>(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums {
    let mut channel = [[0.0_f64; SUMS]; CHANNELS_MAX];
    let mut group = Group::<N>::empty();
    let mut sums = [[[0.0_f32; HALF]; SUMS]; N];
    let (mut weight, mut seen) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    let length = points.x.len();
    let mut first = 0;
    while first < length {
        let end = (first + SHARING).min(length);
        let mut start = first;
        while start + LANES <= end {
            compare::<N>(points, start, right, warp, &mut group);
            let (x, y) = (lanes(&points.x, start), lanes(&points.y, start));
            for i in 0..LANES {
                weight[i] += group.weight[i];
                seen[i] += group.seen[i];
            }
            for c in 0..N {
                let gy = lanes(&points.gradient_y[c], start);
                let left = warp.shades[c].left;
                for half in [0, HALF] {
                    let new = terms(&group, c, half, x, y, gy, left);
                    for k in 0..SUMS {
                        for i in 0..HALF {
                            sums[c][k][i] += new[k][i];
                        }
                    }
                }
            }
            start += LANES;
        }
        for c in 0..N {
            let mut own = [0.0_f64; SUMS];
            for k in 0..SUMS {
                let s = &mut sums[c][k];
                let sum = ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
                own[k] = f64::from(sum);
                *s = [0.0; HALF];
            }
            eliminate_offset(&mut own);
            for k in 0..SUMS {
                channel[c][k] += own[k];
            }
        }
        first = end;
    }
    Sums { channel, weight: f64::from(sum_lanes(&weight)), seen: f64::from(sum_lanes(&seen)) }
}

/// Takes what one common offset of all points takes off the sums of products; the sums of single factors stay.
#[inline(always)]
fn eliminate_offset(s: &mut [f64; SUMS]) {
    if s[17] <= 0.0 {
        return;
    }
    let by = 1.0 / s[17];
    let ([g, gx, gy], [h, m, r]) = ([s[12], s[13], s[14]], [s[27], s[16], s[19]]);
    let taken = [
        (0, g * g),
        (1, g * gx),
        (2, g * gy),
        (3, gx * gx),
        (4, gx * gy),
        (5, gy * gy),
        (6, g * r),
        (7, gx * r),
        (8, gy * r),
        (9, g * m),
        (10, gx * m),
        (11, gy * m),
        (15, m * m),
        (18, m * r),
        // Both eyes show the same gradients.
        (20, g * g),
        (22, h * g),
        (23, h * gx),
        (24, h * gy),
        (25, h * h),
        (26, h * m),
        (28, h * r),
    ];
    for (k, product) in taken {
        s[k] -= by * product;
    }
}

/// Half the lanes from a place on.
#[inline(always)]
fn half_of(lanes: &[f32; LANES], from: usize) -> [f32; HALF] {
    let mut out = [0.0; HALF];
    out.copy_from_slice(&lanes[from..from + HALF]);
    out
}

/// Products lane by lane.
#[inline(always)]
fn times(a: &[f32; HALF], b: &[f32; HALF]) -> [f32; HALF] {
    let mut out = [0.0; HALF];
    for i in 0..HALF {
        out[i] = a[i] * b[i];
    }
    out
}

/// What half a group of points adds to the sums of a channel, lane by lane; the gradients along rows are `left` times `gy`.
#[inline(always)]
fn terms<const N: usize>(
    group: &Group<N>,
    c: usize,
    half: usize,
    x: &[f32; LANES],
    y: &[f32; LANES],
    gy: &[f32; LANES],
    left: f32,
) -> [[f32; HALF]; SUMS] {
    let pick = |lanes: &[f32; LANES]| half_of(lanes, half);
    let (x, y, h) = (pick(x), pick(y), times(&[left; HALF], &pick(gy)));
    let (g, m, r) = (pick(&group.gradient[c]), pick(&group.mean[c]), pick(&group.residual[c]));
    let w = times(&pick(&group.weight), &pick(&group.certainty[c]));
    let wg = times(&w, &g);
    let (wgx, wgy, wh) = (times(&wg, &x), times(&wg, &y), times(&w, &h));
    let (wm, wr) = (times(&w, &m), times(&w, &r));
    let (wgxg, wgyg) = (times(&wgx, &g), times(&wgy, &g));
    [
        // Gradient by gradient, times 1, x, y, x x, x y, y y.
        times(&wg, &g),
        wgxg,
        wgyg,
        times(&wgxg, &x),
        times(&wgxg, &y),
        times(&wgyg, &y),
        // Gradient by residual, by mean and alone, times 1, x, y.
        times(&wg, &r),
        times(&wgx, &r),
        times(&wgy, &r),
        times(&wg, &m),
        times(&wgx, &m),
        times(&wgy, &m),
        wg,
        wgx,
        wgy,
        // Gain and offset.
        times(&wm, &m),
        wm,
        w,
        times(&wm, &r),
        wr,
        // Left by right gradient, and the squared residual.
        times(&w, &pick(&group.product[c])),
        times(&wr, &r),
        // Row offset by gradient (times 1, x, y), itself, mean, one, residual.
        times(&wh, &g),
        times(&wgx, &h),
        times(&wgy, &h),
        times(&wh, &h),
        times(&wh, &m),
        wh,
        times(&wh, &r),
        // Tukey's weight where the channel can be used.
        times(&pick(&group.weight), &pick(&group.usable[c])),
    ]
}

wide! {
    /// The normal equations at one place; `right` holds a plane per channel.
    pub(crate) fn accumulate(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> Sums = accumulate_kernel;
}

/// What tells how much less sharp one eye is than the other: sums over points and channels, in units of the residuals'
/// variances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SharpnessSums {
    /// Squared gradients along columns of the right eye minus those of the left one.
    pub excess: f64,
    /// Products of both eyes' second derivatives along columns.
    pub curvature: f64,
    /// Weights.
    pub weight: f64,
}

#[inline(always)]
fn sharpness_kernel(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> SharpnessSums {
    match warp.channels {
        1 => sharpness_channels::<1>(points, right, warp),
        2 => sharpness_channels::<2>(points, right, warp),
        _ => sharpness_channels::<3>(points, right, warp),
    }
}

#[inline(always)]
fn sharpness_channels<const N: usize>(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> SharpnessSums {
    let mut sums = [[0.0_f32; LANES]; 3];
    let mut group = Group::<N>::empty();
    for start in (0..points.x.len() / LANES).map(|g| g * LANES) {
        compare::<N>(points, start, right, warp, &mut group);
        for c in 0..N {
            let (left, curvature) = (warp.shades[c].left, lanes(&points.curvature[c], start));
            for i in 0..LANES {
                let w = group.weight[i] * group.certainty[c][i];
                sums[0][i] += w * group.excess[c][i];
                sums[1][i] += w * group.bend[c][i] * (left * curvature[i]);
                sums[2][i] += group.weight[i] * group.usable[c][i];
            }
        }
    }
    let [excess, curvature, weight] = sums.map(|lanes| f64::from(sum_lanes(&lanes)));
    SharpnessSums { excess, curvature, weight }
}

wide! {
    /// How the sharpness of both eyes compares.
    pub(crate) fn sharpness(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) -> SharpnessSums
        = sharpness_kernel;
}

/// How the derivatives of a point become its score: weight of the channel, and what the gain takes up of each of the four
/// derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Projection {
    pub weight: f32,
    pub mean: [f32; 4],
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
) {
    let length = points.x.len();
    let mut group = Group::<N>::empty();
    let mut first = 0;
    while first < length {
        let end = (first + SHARING).min(length);
        // Sums of weights, and of residuals and derivatives times weights.
        let mut sums = [[[0.0_f32; LANES]; 6]; N];
        let mut start = first;
        while start + LANES <= end {
            compare::<N>(points, start, right, warp, &mut group);
            for c in 0..N {
                for i in 0..LANES {
                    let w = group.weight[i] * group.certainty[c][i];
                    let own = derivatives(points, &group, c, (start, i), warp, &projections[c]);
                    sums[c][0][i] += w;
                    sums[c][1][i] += w * group.residual[c][i];
                    for k in 0..4 {
                        sums[c][2 + k][i] += w * own[k];
                    }
                }
            }
            start += LANES;
        }
        let mut means = [[0.0_f32; 6]; N];
        for c in 0..N {
            let weight = sum_lanes(&sums[c][0]).max(f32::MIN_POSITIVE);
            for k in 1..6 {
                means[c][k] = sum_lanes(&sums[c][k]) / weight;
            }
        }
        let mut start = first;
        while start + LANES <= end {
            compare::<N>(points, start, right, warp, &mut group);
            let mut out = [[0.0_f32; LANES]; 4];
            for c in 0..N {
                for i in 0..LANES {
                    let w = projections[c].weight * group.weight[i] * group.certainty[c][i];
                    let wr = w * (group.residual[c][i] - means[c][1]);
                    let own = derivatives(points, &group, c, (start, i), warp, &projections[c]);
                    for k in 0..4 {
                        out[k][i] += wr * (own[k] - means[c][2 + k]);
                    }
                }
            }
            for k in 0..4 {
                scores[k][start..start + LANES].copy_from_slice(&out[k]);
            }
            start += LANES;
        }
        first = end;
    }
}

/// Derivatives of a residual by `(d0, du, dv, row)` without what the gain takes up of them.
#[inline(always)]
fn derivatives<const N: usize>(
    points: &PointSet,
    group: &Group<N>,
    c: usize,
    (start, i): (usize, usize),
    warp: &Warp,
    p: &Projection,
) -> [f32; 4] {
    let (x, y, gy) = (lanes(&points.x, start), lanes(&points.y, start), lanes(&points.gradient_y[c], start));
    let (g, m) = (-group.gradient[c][i], group.mean[c][i]);
    let own = [g, g * x[i], g * y[i], warp.shades[c].left * gy[i]];
    [own[0] - p.mean[0] * m, own[1] - p.mean[1] * m, own[2] - p.mean[2] * m, own[3] - p.mean[3] * m]
}

wide! {
    /// The gradient of the cost by `(d0, du, dv, row)`, point by point, with gains and offsets eliminated.
    pub(crate) fn scores(
        points: &PointSet,
        right: &[&[f32]; CHANNELS_MAX],
        warp: &Warp,
        projections: &[Projection; CHANNELS_MAX],
        scores: &mut [Vec<f32>; 4],
    ) = scores_kernel;
}
