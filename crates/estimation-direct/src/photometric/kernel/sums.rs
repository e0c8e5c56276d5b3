//! Sums over all points.

use pb3dp_estimation_core::wide::{LANES, sum_lanes, wide};

use super::compare::{Group, Lanes, Row, lanes, row};
use super::{CHANNELS_MAX, PointSet, SHARING, Thinning, Warp};
use crate::named_sums::named_sums;

/// Number of groups after which single-precision sums are added in double precision. Chosen by hand, not varied: sums of
/// 1024 points keep most digits of single precision.
const FOLDED: usize = 8;

/// Sums over all points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sums {
    pub channel: [ChannelSums; CHANNELS_MAX],
    /// Sum of Tukey's weights.
    pub weight: f64,
    /// Number of points inside the right planes.
    pub visible: f64,
    pub sharpness: SharpnessSums,
    /// The same over the points well inside the region.
    pub inner: InnerSums,
}

/// Sums over the points well inside the region, and over the channels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct InnerSums {
    /// Sum of Tukey's weights.
    pub weight: f64,
    /// Number of points inside the right planes.
    pub visible: f64,
    /// Weighted sum of squared residuals.
    pub squares: f64,
}

/// Sums that measure the sharpness difference between the images, over points and channels, in units of the residuals'
/// variances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SharpnessSums {
    /// Squared gradients along columns of the right image minus those of the left image.
    pub excess: f64,
    /// Products of both images' second derivatives along columns.
    pub curvature: f64,
    /// Weights.
    pub weight: f64,
}

/// Sums over the points of one channel: products after elimination of the offsets, and single factors without it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ChannelSums {
    pub products: ProductSums<f64>,
    pub singles: SingleSums<f64>,
}

named_sums! {
    /// Weighted sums of the products of two factors, times the coordinates after the underscore. The factors: `g` gradient
    /// along the columns, `h` along the rows, `m` mean of both values, `r` residual, `s` gradient of the right image.
    pub(crate) struct ProductSums {
        gg, gg_x, gg_y, gg_xx, gg_xy, gg_yy, gr, gr_x, gr_y, gm, gm_x, gm_y, mm, mr, gs, rr, gh, gh_x, gh_y, hh, hm, hr,
        /// Tukey's weight if the channel is usable.
        usable,
    }
}

named_sums! {
    /// Weighted sums of single factors, named as in [`ProductSums`], and of the weights themselves.
    pub(crate) struct SingleSums { g, g_x, g_y, h, m, r, w, }
}

/// Lane-wise sums of products; aligned to whole cache lines, which stores must not straddle.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct LaneSums {
    products: ProductSums<Lanes>,
    excess: Lanes,
    curvature: Lanes,
}

impl LaneSums {
    const ZERO: Self = Self { products: ProductSums::ZERO, excess: [0.0; LANES], curvature: [0.0; LANES] };
}

/// Lane-wise sums of single factors, as [`LaneSums`].
#[repr(align(64))]
struct LaneSingles(SingleSums<Lanes>);

named_sums! {
    /// Sums over all channels: the fields of [`Sums`] and [`InnerSums`].
    struct PointCounts { weight, visible, inner_weight, inner_visible, inner_squares, }
}

#[inline(always)]
fn accumulate_kernel(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp, thinning: Thinning) -> Sums {
    match warp.channels {
        1 => accumulate_channels::<1>(points, right, warp, thinning),
        2 => accumulate_channels::<2>(points, right, warp, thinning),
        _ => accumulate_channels::<3>(points, right, warp, thinning),
    }
}

#[inline(always)]
fn accumulate_channels<const N: usize>(
    points: &PointSet,
    right: &[&[f32]; CHANNELS_MAX],
    warp: &Warp,
    thinning: Thinning,
) -> Sums {
    let mut channel = [ChannelSums::default(); CHANNELS_MAX];
    let mut sharpness = SharpnessSums::default();
    let mut group = Group::<N>::empty();
    let mut sums = [LaneSums::ZERO; N];
    let mut counts = PointCounts::ZERO;
    let groups = points.x.len() / SHARING;
    let mut folded = 0;
    for index in (0..groups).step_by(thinning.step.max(1)) {
        let first = index * SHARING;
        group.compare(points, first, right, warp);
        let squares = group.squares();
        let inner = row(&points.inner, first);
        for k in 0..SHARING / LANES {
            let (weight, visible) = (lanes(&group.weight, k), lanes(&group.visible, k));
            let (inner, squares) = (lanes(inner, k), lanes(squares, k));
            for i in 0..LANES {
                counts.weight[i] += weight[i];
                counts.visible[i] += visible[i];
                counts.inner_weight[i] += weight[i] * inner[i];
                counts.inner_visible[i] += visible[i] * inner[i];
                counts.inner_squares[i] += weight[i] * inner[i] * squares[i];
            }
        }
        for c in 0..N {
            let places = Places::new(points, first, c, warp);
            let singles = add_products(&group, c, &places, &mut sums[c]);
            channel[c].singles += singles;
            eliminate_offset(&mut channel[c].products, &singles);
        }
        folded += 1;
        if folded == FOLDED {
            fold(&mut sums, &mut channel, &mut sharpness);
            folded = 0;
        }
    }
    fold(&mut sums, &mut channel, &mut sharpness);
    let PointCounts { weight, visible, inner_weight, inner_visible, inner_squares: squares } = counts.folded();
    Sums {
        channel,
        weight,
        visible,
        sharpness,
        inner: InnerSums { weight: inner_weight, visible: inner_visible, squares },
    }
}

/// Adds the single-precision sums to the double-precision ones and resets them.
#[inline(always)]
fn fold<const N: usize>(
    sums: &mut [LaneSums; N],
    channel: &mut [ChannelSums; CHANNELS_MAX],
    sharpness: &mut SharpnessSums,
) {
    for c in 0..N {
        let products = sums[c].products.folded();
        channel[c].products += products;
        sharpness.weight += products.usable;
        sharpness.excess += f64::from(sum_lanes(&sums[c].excess));
        sharpness.curvature += f64::from(sum_lanes(&sums[c].curvature));
        sums[c] = LaneSums::ZERO;
    }
}

/// Constant data of a group of points in one channel.
pub(super) struct Places<'a> {
    pub x: &'a Row,
    pub y: &'a Row,
    pub gradient_y: &'a Row,
    pub curvature: &'a Row,
    /// Factor of the left values.
    pub left: f32,
}

impl<'a> Places<'a> {
    #[inline(always)]
    pub fn new(points: &'a PointSet, first: usize, c: usize, warp: &Warp) -> Self {
        Self {
            x: row(&points.x, first),
            y: row(&points.y, first),
            gradient_y: row(&points.gradient_y[c], first),
            curvature: row(&points.curvature[c], first),
            left: warp.shades[c].left,
        }
    }
}

/// Adds the products of a group's points in a channel, and returns the sums of single factors.
#[inline(always)]
fn add_products<const N: usize>(
    group: &Group<N>,
    c: usize,
    places: &Places<'_>,
    sums: &mut LaneSums,
) -> SingleSums<f64> {
    let own = &group.channel[c];
    let LaneSums { products, excess, curvature: bends } = sums;
    let mut singles = LaneSingles(SingleSums::ZERO);
    let LaneSingles(singles) = &mut singles;
    for k in 0..SHARING / LANES {
        let (x, y) = (lanes(places.x, k), lanes(places.y, k));
        let (gy, curvature) = (lanes(places.gradient_y, k), lanes(places.curvature, k));
        let (gradient, mean, residual) = (lanes(&own.gradient, k), lanes(&own.mean, k), lanes(&own.residual, k));
        let (slope, bend) = (lanes(&own.slope, k), lanes(&own.bend, k));
        let (weight, certainty, usable) = (lanes(&group.weight, k), lanes(&own.certainty, k), lanes(&own.usable, k));
        // One loop for everything: it becomes one vector instruction per operation.
        for i in 0..LANES {
            let (x, y, h, w) = (x[i], y[i], places.left * gy[i], weight[i] * certainty[i]);
            let (g, m, r, s) = (gradient[i], mean[i], residual[i], slope[i]);
            let wg = w * g;
            let (wgx, wgy, wh, wm, wr, ws) = (wg * x, wg * y, w * h, w * m, w * r, w * s);
            let (wgg, wgxg, wgyg) = (wg * g, wgx * g, wgy * g);
            // Gradient by gradient, times 1, x, y, x x, x y, y y.
            products.gg[i] += wgg;
            products.gg_x[i] += wgxg;
            products.gg_y[i] += wgyg;
            products.gg_xx[i] += wgxg * x;
            products.gg_xy[i] += wgxg * y;
            products.gg_yy[i] += wgyg * y;
            // Gradient by residual and by mean, times 1, x, y.
            products.gr[i] += wg * r;
            products.gr_x[i] += wgx * r;
            products.gr_y[i] += wgy * r;
            products.gm[i] += wg * m;
            products.gm_x[i] += wgx * m;
            products.gm_y[i] += wgy * m;
            // Mean by mean and by residual.
            products.mm[i] += wm * m;
            products.mr[i] += wm * r;
            // Left by right gradient, and the squared residual.
            products.gs[i] += ws * g;
            products.rr[i] += wr * r;
            // Row gradient by gradient (times 1, x, y), itself, mean, residual.
            products.gh[i] += wg * h;
            products.gh_x[i] += wgx * h;
            products.gh_y[i] += wgy * h;
            products.hh[i] += wh * h;
            products.hm[i] += wh * m;
            products.hr[i] += wh * r;
            // Tukey's weight if the channel is usable.
            products.usable[i] += weight[i] * usable[i];
            // Sharpness.
            excess[i] += ws * s - wgg;
            bends[i] += w * bend[i] * (places.left * curvature[i]);
            singles.g[i] += wg;
            singles.g_x[i] += wgx;
            singles.g_y[i] += wgy;
            singles.h[i] += wh;
            singles.m[i] += wm;
            singles.r[i] += wr;
            singles.w[i] += w;
        }
    }
    singles.folded()
}

/// Subtracts the part of the sums of products that a common offset of the group takes up.
#[inline(always)]
fn eliminate_offset(sums: &mut ProductSums<f64>, singles: &SingleSums<f64>) {
    let SingleSums { g, g_x, g_y, h, m, r, w } = *singles;
    if w <= 0.0 {
        return;
    }
    let by = 1.0 / w;
    sums.gg -= by * (g * g);
    sums.gg_x -= by * (g * g_x);
    sums.gg_y -= by * (g * g_y);
    sums.gg_xx -= by * (g_x * g_x);
    sums.gg_xy -= by * (g_x * g_y);
    sums.gg_yy -= by * (g_y * g_y);
    sums.gr -= by * (g * r);
    sums.gr_x -= by * (g_x * r);
    sums.gr_y -= by * (g_y * r);
    sums.gm -= by * (g * m);
    sums.gm_x -= by * (g_x * m);
    sums.gm_y -= by * (g_y * m);
    sums.mm -= by * (m * m);
    sums.mr -= by * (m * r);
    // Both images have the same gradients.
    sums.gs -= by * (g * g);
    sums.gh -= by * (h * g);
    sums.gh_x -= by * (h * g_x);
    sums.gh_y -= by * (h * g_y);
    sums.hh -= by * (h * h);
    sums.hm -= by * (h * m);
    sums.hr -= by * (h * r);
}

wide! {
    /// Accumulates the normal equations at one state; `right` holds a plane per channel.
    pub(crate) fn accumulate(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp, thinning: Thinning) -> Sums
        = accumulate_kernel;
}
