//! Comparison of a group of points with the right image.

use pb3dp_estimation_core::wide::LANES;

use super::{CHANNELS_MAX, PointSet, SHARING, TOUCHED, UNUSABLE, Warp};

/// One value for every point of a group.
pub(super) type Row = [f32; SHARING];
/// One value for every lane of a sum.
pub(super) type Lanes = [f32; LANES];

/// A group of points after the comparison, in `N` channels.
#[repr(align(64))]
pub(super) struct Group<const N: usize> {
    pub channel: [Channel; N],
    /// Tukey's weight.
    pub weight: Row,
    pub visible: Row,
    at: [u32; SHARING],
    t: Row,
    distance: Row,
    any: Row,
    taps: [[f32; 4]; SHARING],
}

/// One channel of a group.
#[repr(align(64))]
pub(super) struct Channel {
    pub residual: Row,
    /// Gradient of the left image along columns.
    pub gradient: Row,
    /// Gradient of the right image along columns.
    pub slope: Row,
    pub mean: Row,
    /// 1 / variance of the residual; 0 if the channel is unusable.
    pub certainty: Row,
    /// 1, or 0 if the channel is unusable.
    pub usable: Row,
    /// Second derivative of the right image along columns.
    pub bend: Row,
}

/// The values of a group.
#[inline(always)]
pub(super) fn row(values: &[f32], first: usize) -> &Row {
    values[first..].first_chunk().unwrap_or(&[0.0; SHARING])
}

impl<const N: usize> Group<N> {
    #[inline(always)]
    pub fn empty() -> Self {
        let none = [0.0; SHARING];
        let channel = || Channel {
            residual: none,
            gradient: none,
            slope: none,
            mean: none,
            certainty: none,
            usable: none,
            bend: none,
        };
        Self {
            channel: std::array::from_fn(|_| channel()),
            weight: none,
            visible: none,
            at: [0; SHARING],
            t: none,
            distance: none,
            any: none,
            taps: [[0.0; 4]; SHARING],
        }
    }

    /// Compares the points from `first` on.
    #[inline(always)]
    pub fn compare(&mut self, points: &PointSet, first: usize, right: &[&[f32]; CHANNELS_MAX], warp: &Warp) {
        self.locate(points, first, warp);
        self.distance = [0.0; SHARING];
        self.any = [0.0; SHARING];
        for c in 0..N {
            self.look_up(right[c]);
            self.compare_channel(points, first, c, warp);
        }
        let inverse_limit = 1.0 / warp.limit;
        for i in 0..SHARING {
            let inner = larger(1.0 - self.distance[i] * inverse_limit, 0.0);
            let visible = self.visible[i] * self.any[i];
            self.visible[i] = visible;
            self.weight[i] = visible * inner * inner;
        }
    }

    /// Squared residuals divided by variances, summed over the channels.
    #[inline(always)]
    pub fn squares(&self) -> &Row {
        &self.distance
    }

    /// Computes the positions of the points in the right planes.
    #[inline(always)]
    fn locate(&mut self, points: &PointSet, first: usize, warp: &Warp) {
        let (x, y, unit) = (row(&points.x, first), row(&points.y, first), row(&points.unit, first));
        let rows: &[u32; SHARING] = points.row_start[first..].first_chunk().unwrap_or(&[0; SHARING]);
        let last = warp.width as f32 - 3.0;
        for i in 0..SHARING {
            let column = warp.column + warp.per_x * x[i] + warp.per_y * y[i];
            self.visible[i] = if column >= 1.0 && column < last { unit[i] } else { 0.0 };
            let column = smaller(larger(column, 1.0), last - 1.0);
            // SAFETY: `larger` and `smaller` leave no NaN, and both limits are small numbers.
            let whole: i32 = unsafe { column.to_int_unchecked() };
            self.t[i] = column - whole as f32;
            self.at[i] = rows[i].wrapping_add((whole - 1) as u32);
        }
    }

    /// Loads the four right pixels around every point.
    #[inline(always)]
    fn look_up(&mut self, plane: &[f32]) {
        let mut last = 0;
        for &at in &self.at {
            last = if at > last { at } else { last };
        }
        if last as usize + 4 > plane.len() {
            self.taps = [[UNUSABLE; 4]; SHARING];
            return;
        }
        for (taps, &at) in self.taps.iter_mut().zip(&self.at) {
            // SAFETY: the four values from the last of all positions on are in the plane.
            *taps = unsafe { plane.as_ptr().add(at as usize).cast::<[f32; 4]>().read_unaligned() };
        }
    }

    #[inline(always)]
    fn compare_channel(&mut self, points: &PointSet, first: usize, c: usize, warp: &Warp) {
        let (value, gx) = (row(&points.value[c], first), row(&points.gradient_x[c], first));
        let gy = row(&points.gradient_y[c], first);
        let (shade, out) = (warp.shades[c], &mut self.channel[c]);
        for i in 0..SHARING {
            // The uniform cubic B-spline of the four coefficients, its slope and its second derivative.
            let [p0, p1, p2, p3] = self.taps[i];
            let t = self.t[i];
            let worst = larger(larger(larger(p0, p1), larger(p2, p3)), value[i]);
            let usable = if worst < TOUCHED { 1.0 } else { 0.0 };
            let (c0, c1) = ((p0 + 4.0 * p1 + p2) * (1.0 / 6.0), 0.5 * (p2 - p0));
            let (c2, c3) = (0.5 * (p0 + p2) - p1, (p3 - p0) * (1.0 / 6.0) + 0.5 * (p1 - p2));
            let shown = shade.right * (c0 + t * (c1 + t * (c2 + t * c3)));
            let (own, own_slope) = (shade.left * value[i], shade.left * gx[i]);
            let residual = shown - own + shade.offset + warp.row * shade.left * gy[i];
            let certainty = usable / (shade.variance + warp.place_variance * (own_slope * own_slope));
            out.residual[i] = residual;
            out.gradient[i] = own_slope;
            out.slope[i] = shade.right * (c1 + t * (2.0 * c2 + 3.0 * t * c3));
            out.mean[i] = 0.5 * (shown + own);
            out.certainty[i] = certainty;
            out.usable[i] = usable;
            out.bend[i] = shade.right * (2.0 * c2 + 6.0 * t * c3);
            self.distance[i] += residual * residual * certainty;
            self.any[i] = larger(usable, self.any[i]);
        }
    }
}

/// The larger of two values; the second if the first is not a number.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two values; the second if the first is not a number.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Lanes `16 k .. 16 (k + 1)` of a row.
#[inline(always)]
pub(super) fn lanes(row: &Row, k: usize) -> &Lanes {
    row[k * LANES..].first_chunk().unwrap_or(&[0.0; LANES])
}
