//! Separable smoothing of planes.

use super::image_plane::ImagePlane;
use crate::cpu::Kernels;
use crate::wide::{LANES, wide};

/// Most weights of a smoothing kernel on either side of its centre.
pub const RADIUS_MAX: usize = 15;

/// Weights of the spline's prefilter beyond this are below a thousandth, and smoothing makes them smaller.
const SPLINE_RADIUS: usize = 5;

/// A row of weights that sum up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taps {
    radius: usize,
    weights: [f32; 2 * RADIUS_MAX + 1],
}

impl Taps {
    /// A Gaussian of standard deviation `sigma_px`, looked up `shift_px` further on: the filtered signal at `i` is the smooth
    /// signal at `i + shift_px`. A shift of up to half a pixel is meant, which needs a sigma of 0.6 px or more.
    pub fn gaussian(sigma_px: f64, shift_px: f64) -> Self {
        let radius = ((3.0 * sigma_px + shift_px.abs()).ceil() as usize).clamp(1, RADIUS_MAX);
        let value = |i: usize| {
            let x = (i as f64 - radius as f64 - shift_px) / sigma_px.max(1e-3);
            if i <= 2 * radius { (-0.5 * x * x).exp() } else { 0.0 }
        };
        let sum: f64 = (0..=2 * radius).map(value).sum();
        Self { radius, weights: std::array::from_fn(|i| (value(i) / sum) as f32) }
    }

    /// A Gaussian of standard deviation `sigma_px`, then from values to the coefficients of the cubic spline through them:
    /// with the coefficients `c`, the filtered signal at `i` is `(c[i - 1] + 4 c[i] + c[i + 1]) / 6`.
    pub fn spline(sigma_px: f64) -> Self {
        let smooth = Self::gaussian(sigma_px, 0.0);
        // The impulse response of the spline's prefilter: pole sqrt(3) - 2 (Unser 1999).
        let pole = 3f64.sqrt() - 2.0;
        let response = |k: i32| 3f64.sqrt() * pole.powi(k.abs());
        let radius = (smooth.radius + SPLINE_RADIUS).min(RADIUS_MAX);
        let value = |i: usize| -> f64 {
            let at = i as i32 - radius as i32;
            let parts = smooth.weights().iter().enumerate();
            parts.map(|(j, weight)| f64::from(*weight) * response(at + smooth.radius as i32 - j as i32)).sum()
        };
        let sum: f64 = (0..=2 * radius).map(value).sum();
        Self { radius, weights: std::array::from_fn(|i| if i <= 2 * radius { (value(i) / sum) as f32 } else { 0.0 }) }
    }

    /// Weights on either side of the centre.
    pub fn radius(&self) -> usize {
        self.radius
    }

    /// The weights, first to last.
    pub fn weights(&self) -> &[f32] {
        &self.weights[..=2 * self.radius]
    }
}

/// Smooths planes; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct Smoother {
    row: Vec<f32>,
    between: ImagePlane,
}

impl Smoother {
    /// Writes `source`, smoothed along rows and along columns, into `out`; beyond its edges the plane is taken to go on as
    /// its outermost pixels.
    pub fn smooth(&mut self, source: &ImagePlane, rows: &Taps, columns: &Taps, out: &mut ImagePlane, kernels: Kernels) {
        let (width, height) = (source.width(), source.height());
        self.between.resize(width, height);
        out.resize(width, height);
        if width == 0 || height == 0 {
            return;
        }
        self.row.resize(width + 2 * RADIUS_MAX, 0.0);
        for y in 0..height {
            let line = source.row(y);
            let (before, rest) = self.row.split_at_mut(rows.radius);
            before.fill(line[0]);
            rest[..width].copy_from_slice(line);
            rest[width..width + rows.radius].fill(line[width - 1]);
            filter_row(kernels, &self.row, rows, self.between.row_mut(y));
        }
        filter_columns(kernels, &self.between, columns, out);
    }
}

wide! {
    fn filter_row(padded: &[f32], taps: &Taps, out: &mut [f32]) = filter_row_kernel;
}

wide! {
    fn filter_columns(source: &ImagePlane, taps: &Taps, out: &mut ImagePlane) = filter_columns_kernel;
}

/// Columns that are filtered side by side where the row is long enough: so many sums need not wait for each other.
const SIDE_BY_SIDE: usize = 4 * LANES;

/// Writes `N` neighbouring columns from `first` on: weight `j` meets the values from `starts[j] + first` on.
#[inline(always)]
fn filter_group<const N: usize>(values: &[f32], starts: &Starts, taps: &Taps, first: usize, out: &mut [f32]) {
    let mut sums = [0.0_f32; N];
    for (start, weight) in starts.iter().zip(taps.weights()) {
        let values = &values[start + first..][..N];
        for i in 0..N {
            sums[i] += weight * values[i];
        }
    }
    out[first..first + N].copy_from_slice(&sums);
}

/// Where the values of the weights begin.
type Starts = [usize; 2 * RADIUS_MAX + 1];

/// In a row, every weight begins one value further on.
const ROW_STARTS: Starts = {
    let mut starts = [0; 2 * RADIUS_MAX + 1];
    let mut j = 0;
    while j < starts.len() {
        starts[j] = j;
        j += 1;
    }
    starts
};

/// Writes all columns of a row; the last group may overlap the one before.
#[inline(always)]
fn filter_groups(values: &[f32], starts: &Starts, taps: &Taps, out: &mut [f32]) {
    let width = out.len();
    let mut first = 0;
    while first + SIDE_BY_SIDE <= width {
        filter_group::<SIDE_BY_SIDE>(values, starts, taps, first, out);
        first += SIDE_BY_SIDE;
    }
    while first < width && width >= LANES {
        filter_group::<LANES>(values, starts, taps, first.min(width - LANES), out);
        first += LANES;
    }
    while first < width {
        filter_group::<1>(values, starts, taps, first, out);
        first += 1;
    }
}

#[inline(always)]
fn filter_row_kernel(padded: &[f32], taps: &Taps, out: &mut [f32]) {
    filter_groups(padded, &ROW_STARTS, taps, out);
}

#[inline(always)]
fn filter_columns_kernel(source: &ImagePlane, taps: &Taps, out: &mut ImagePlane) {
    let (width, height, radius) = (source.width(), source.height(), taps.radius as isize);
    let mut starts = [0; 2 * RADIUS_MAX + 1];
    for y in 0..height {
        for (j, start) in starts.iter_mut().enumerate().take(taps.weights().len()) {
            *start = (y as isize + j as isize - radius).clamp(0, height as isize - 1) as usize * width;
        }
        filter_groups(source.values(), &starts, taps, out.row_mut(y));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussians_keep_the_mean_and_move_by_their_shift() {
        for (sigma, shift) in [(0.7, 0.0), (0.8, 0.5), (1.5, -0.31), (3.0, 0.2)] {
            let taps = Taps::gaussian(sigma, shift);
            let moment = |power: i32| -> f64 {
                let at = |i: usize| i as f64 - taps.radius() as f64;
                taps.weights().iter().enumerate().map(|(i, w)| f64::from(*w) * at(i).powi(power)).sum()
            };
            assert!((moment(0) - 1.0).abs() < 1e-6);
            assert!((moment(1) - shift).abs() < 0.01, "{} for {shift}", moment(1));
            assert!((moment(2) - shift * shift - sigma * sigma).abs() < 0.1 * sigma * sigma);
        }
    }

    #[test]
    fn splines_go_through_the_smooth_values() {
        for sigma in [0.4, 0.6, 1.3] {
            let (spline, plain) = (Taps::spline(sigma), Taps::gaussian(sigma, 0.0));
            let tap = |taps: &Taps, at: i32| {
                let index = at + taps.radius() as i32;
                usize::try_from(index).ok().and_then(|i| taps.weights().get(i)).map_or(0.0, |w| f64::from(*w))
            };
            for at in -8..=8 {
                let through = (tap(&spline, at - 1) + 4.0 * tap(&spline, at) + tap(&spline, at + 1)) / 6.0;
                assert!((through - tap(&plain, at)).abs() < 1e-3, "{sigma} {at}: {through}");
            }
        }
    }

    #[test]
    fn every_kernel_smooths_as_a_plain_sum_does() {
        let value = |x: i32, y: i32| ((x * 37 + y * 101) % 97) as f32 - 40.0;
        for (width, height) in [(61, 23), (16, 5), (9, 7), (1, 1)] {
            let plane = ImagePlane::from_fn(width, height, |x, y| value(x as i32, y as i32));
            let (rows, columns) = (Taps::gaussian(1.1, 0.0), Taps::gaussian(0.8, 0.4));
            let expected = |x: usize, y: usize| -> f64 {
                let mut sum = 0.0;
                for (j, b) in columns.weights().iter().enumerate() {
                    for (i, a) in rows.weights().iter().enumerate() {
                        let u = (x as i32 + i as i32 - rows.radius() as i32).clamp(0, width as i32 - 1);
                        let v = (y as i32 + j as i32 - columns.radius() as i32).clamp(0, height as i32 - 1);
                        sum += f64::from(a * b * value(u, v));
                    }
                }
                sum
            };
            let mut first: Option<ImagePlane> = None;
            for kernels in Kernels::available() {
                let mut out = ImagePlane::default();
                Smoother::default().smooth(&plane, &rows, &columns, &mut out, kernels);
                for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                    assert!((f64::from(out.row(y)[x]) - expected(x, y)).abs() < 1e-3);
                }
                assert_eq!(*first.get_or_insert(out.clone()), out, "{}", kernels.set().name());
            }
        }
    }
}
