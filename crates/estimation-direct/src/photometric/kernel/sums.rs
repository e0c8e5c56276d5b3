//! Sums over all points.

use pb3dp_estimation_core::wide::{LANES, sum_lanes, wide};

use super::compare::{Group, Lanes, Row, lanes, row};
use super::{CHANNELS_MAX, PointSet, SHARING, Thinning, Warp};

/// Number of sums per channel.
pub(crate) const SUMS: usize = 30;
/// Groups after which sums in single precision go to double precision.
const FOLDED: usize = 8;

/// Sums over all points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sums {
    /// Per channel; the order is that of [`products`] and [`SINGLES`].
    pub channel: [[f64; SUMS]; CHANNELS_MAX],
    /// Sum of Tukey's weights.
    pub weight: f64,
    /// Number of points inside the right planes.
    pub seen: f64,
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
    pub seen: f64,
    /// Squared residuals by their weights.
    pub squares: f64,
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

/// Places in [`Sums::channel`] of the sums of weights times gradient (times 1, x, y), row gradient, mean, residual, and one.
const SINGLES: [usize; 7] = [12, 13, 14, 27, 16, 19, 17];
/// Number of sums of products.
const PRODUCTS: usize = 25;
/// Sums of single factors, lane by lane.
#[repr(align(64))]
struct Singles([Lanes; 7]);
/// Places in [`Sums::channel`] of the products that are no sums for the sharpness.
const PRODUCT_PLACES: [usize; 23] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 15, 18, 20, 21, 22, 23, 24, 25, 26, 28, 29];

/// Sums of products, lane by lane; whole cache lines, which stores must not straddle.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Products([Lanes; PRODUCTS]);

impl Products {
    const NONE: Self = Self([[0.0; LANES]; PRODUCTS]);
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
    let mut channel = [[0.0_f64; SUMS]; CHANNELS_MAX];
    let mut sharpness = SharpnessSums::default();
    let mut group = Group::<N>::empty();
    let mut products = [Products::NONE; N];
    // Weight, seen, and both once more of the inner points, with their squared residuals.
    let mut counts = [[0.0_f32; LANES]; 5];
    let groups = points.x.len() / SHARING;
    let mut folded = 0;
    for index in (0..groups).step_by(thinning.step.max(1)) {
        let first = index * SHARING;
        group.compare(points, first, right, warp);
        let squares = group.squares();
        let inner = row(&points.inner, first);
        for k in 0..SHARING / LANES {
            let (weight, seen) = (lanes(&group.weight, k), lanes(&group.seen, k));
            let (inner, squares) = (lanes(inner, k), lanes(squares, k));
            for i in 0..LANES {
                counts[0][i] += weight[i];
                counts[1][i] += seen[i];
                counts[2][i] += weight[i] * inner[i];
                counts[3][i] += seen[i] * inner[i];
                counts[4][i] += weight[i] * inner[i] * squares[i];
            }
        }
        for c in 0..N {
            let places = Places::new(points, first, c, warp);
            let singles = add_products(&group, c, &places, &mut products[c]);
            for (k, single) in SINGLES.into_iter().zip(&singles) {
                channel[c][k] += f64::from(*single);
            }
            eliminate_offset(&mut channel[c], &singles);
        }
        folded += 1;
        if folded == FOLDED {
            fold(&mut products, &mut channel, &mut sharpness);
            folded = 0;
        }
    }
    fold(&mut products, &mut channel, &mut sharpness);
    let [weight, seen, inner_weight, inner_seen, squares] = counts.map(|lanes| f64::from(sum_lanes(&lanes)));
    Sums { channel, weight, seen, sharpness, inner: InnerSums { weight: inner_weight, seen: inner_seen, squares } }
}

/// Moves the sums of products on, and starts them again.
#[inline(always)]
fn fold<const N: usize>(
    products: &mut [Products; N],
    channel: &mut [[f64; SUMS]; CHANNELS_MAX],
    sharpness: &mut SharpnessSums,
) {
    for c in 0..N {
        let sums: [f64; PRODUCTS] = std::array::from_fn(|k| f64::from(sum_lanes(&products[c].0[k])));
        for (k, sum) in PRODUCT_PLACES.into_iter().zip(sums) {
            channel[c][k] += sum;
        }
        sharpness.weight += sums[22];
        sharpness.excess += sums[23];
        sharpness.curvature += sums[24];
        products[c] = Products::NONE;
    }
}

/// What the points of a group are in one channel, apart from what they see.
pub(super) struct Places<'a> {
    pub x: &'a Row,
    pub y: &'a Row,
    pub gradient_y: &'a Row,
    pub curvature: &'a Row,
    /// The left values are multiplied by this.
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

/// Adds the products of a group's points in a channel, and returns the sums of [`SINGLES`].
#[inline(always)]
fn add_products<const N: usize>(
    group: &Group<N>,
    c: usize,
    places: &Places<'_>,
    Products(products): &mut Products,
) -> [f32; 7] {
    let own = &group.channel[c];
    let mut singles = Singles([[0.0; LANES]; 7]);
    let Singles(singles) = &mut singles;
    for k in 0..SHARING / LANES {
        let (x, y) = (lanes(places.x, k), lanes(places.y, k));
        let (gy, curvature) = (lanes(places.gradient_y, k), lanes(places.curvature, k));
        let (gradient, mean, residual) = (lanes(&own.gradient, k), lanes(&own.mean, k), lanes(&own.residual, k));
        let (slope, bend) = (lanes(&own.slope, k), lanes(&own.bend, k));
        let (weight, certainty, usable) = (lanes(&group.weight, k), lanes(&own.certainty, k), lanes(&own.usable, k));
        // One loop for all: it becomes one vector instruction per operation.
        for i in 0..LANES {
            let (x, y, h, w) = (x[i], y[i], places.left * gy[i], weight[i] * certainty[i]);
            let (g, m, r, s) = (gradient[i], mean[i], residual[i], slope[i]);
            let wg = w * g;
            let (wgx, wgy, wh, wm, wr, ws) = (wg * x, wg * y, w * h, w * m, w * r, w * s);
            let (wgg, wgxg, wgyg) = (wg * g, wgx * g, wgy * g);
            // Gradient by gradient, times 1, x, y, x x, x y, y y.
            products[0][i] += wgg;
            products[1][i] += wgxg;
            products[2][i] += wgyg;
            products[3][i] += wgxg * x;
            products[4][i] += wgxg * y;
            products[5][i] += wgyg * y;
            // Gradient by residual and by mean, times 1, x, y.
            products[6][i] += wg * r;
            products[7][i] += wgx * r;
            products[8][i] += wgy * r;
            products[9][i] += wg * m;
            products[10][i] += wgx * m;
            products[11][i] += wgy * m;
            // Mean by mean and by residual.
            products[12][i] += wm * m;
            products[13][i] += wm * r;
            // Left by right gradient, and the squared residual.
            products[14][i] += ws * g;
            products[15][i] += wr * r;
            // Row gradient by gradient (times 1, x, y), itself, mean, residual.
            products[16][i] += wg * h;
            products[17][i] += wgx * h;
            products[18][i] += wgy * h;
            products[19][i] += wh * h;
            products[20][i] += wh * m;
            products[21][i] += wh * r;
            // Tukey's weight where the channel can be used.
            products[22][i] += weight[i] * usable[i];
            // Sharpness.
            products[23][i] += ws * s - wgg;
            products[24][i] += w * bend[i] * (places.left * curvature[i]);
            singles[0][i] += wg;
            singles[1][i] += wgx;
            singles[2][i] += wgy;
            singles[3][i] += wh;
            singles[4][i] += wm;
            singles[5][i] += wr;
            singles[6][i] += w;
        }
    }
    std::array::from_fn(|k| sum_lanes(&singles[k]))
}

/// Takes what one common offset of a group's points takes off the sums of products.
#[inline(always)]
fn eliminate_offset(s: &mut [f64; SUMS], singles: &[f32; 7]) {
    let [g, gx, gy, h, m, r, w] = singles.map(f64::from);
    if w <= 0.0 {
        return;
    }
    let by = 1.0 / w;
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

wide! {
    /// The normal equations at one place; `right` holds a plane per channel.
    pub(crate) fn accumulate(points: &PointSet, right: &[&[f32]; CHANNELS_MAX], warp: &Warp, thinning: Thinning) -> Sums
        = accumulate_kernel;
}
