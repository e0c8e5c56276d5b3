//! Separable smoothing of planes.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::{LANES, wide};

use super::image_plane::ImagePlane;

/// Largest number of kernel weights on each side of the centre. Chosen by hand, not varied: three standard deviations of 5
/// px; a wider kernel is cut off.
pub const RADIUS_MAX: usize = 15;

/// Weights of the spline's prefilter beyond this are below a thousandth (sqrt 3 (2 - sqrt 3)^6 = 0.0006), and smoothing reduces
/// them further.
const SPLINE_RADIUS: usize = 5;

/// Symmetric filter weights with sum 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taps {
    radius: usize,
    weights: [f32; 2 * RADIUS_MAX + 1],
}

impl Taps {
    /// A Gaussian of standard deviation `sigma_px`.
    pub fn gaussian(sigma_px: f64) -> Self {
        let radius = ((3.0 * sigma_px).ceil() as usize).clamp(1, RADIUS_MAX);
        let value = |i: usize| {
            let x = (i as f64 - radius as f64) / sigma_px.max(1e-3);
            if i <= 2 * radius { (-0.5 * x * x).exp() } else { 0.0 }
        };
        let sum: f64 = (0..=2 * radius).map(value).sum();
        Self { radius, weights: std::array::from_fn(|i| (value(i) / sum) as f32) }
    }

    /// A Gaussian of standard deviation `sigma_px`, followed by the cubic spline prefilter (values to coefficients): with the
    /// coefficients `c`, the filtered signal at `i` is `(c[i - 1] + 4 c[i] + c[i + 1]) / 6`.
    pub fn spline(sigma_px: f64) -> Self {
        let smooth = Self::gaussian(sigma_px);
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

    /// Number of weights on each side of the centre.
    #[inline]
    pub fn radius(&self) -> usize {
        self.radius
    }

    /// The weights, first to last.
    #[inline]
    pub fn weights(&self) -> &[f32] {
        &self.weights[..=2 * self.radius]
    }
}

/// Smooths planes; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct Smoother {
    row: Vec<f32>,
}

impl Smoother {
    /// Smooths pixels along rows and along columns; the border pixels are replicated beyond the edges.
    ///
    /// A pixel has as many values as there are planes in `out`; they are interleaved in the rows of `source`. `middle` is
    /// subtracted from them.
    pub fn smooth_pixels(
        &mut self,
        source: &PixelRows<'_>,
        rows: &Taps,
        columns: &Taps,
        middle: &[f32],
        out: &mut [ImagePlane],
        kernels: Kernels,
    ) {
        for plane in out.iter_mut() {
            plane.resize(source.size.0, source.size.1);
        }
        let width = source.size.0 * out.len();
        self.row.resize(2 * width + 2 * RADIUS_MAX * out.len(), 0.0);
        if source.size.0 == 0 {
            return;
        }
        match (out, middle) {
            ([out], [middle, ..]) => smooth_one(kernels, source, [rows, columns], [*middle], [out], &mut self.row),
            ([r, g, b], &[x, y, z, ..]) => {
                smooth_three(kernels, source, [rows, columns], [x, y, z], [r, g, b], &mut self.row);
            }
            _ => {}
        }
    }
}

/// Rows of pixels to be smoothed.
#[derive(Clone, Copy, Debug)]
pub struct PixelRows<'a> {
    /// Columns and rows of the whole image, pixels.
    pub size: (usize, usize),
    /// Some of its rows.
    pub values: &'a [f32],
    /// Values from one row to the next.
    pub stride: usize,
    /// Row of the whole image at which the values begin.
    pub first: usize,
    /// First row to compute, and one past the last: only these are written.
    pub wanted: (usize, usize),
}

wide! {
    fn smooth_one(source: &PixelRows<'_>, taps: [&Taps; 2], middle: [f32; 1], out: [&mut ImagePlane; 1], scratch: &mut [f32])
        = smooth_pixels_kernel::<1>;
}

wide! {
    fn smooth_three(source: &PixelRows<'_>, taps: [&Taps; 2], middle: [f32; 3], out: [&mut ImagePlane; 3], scratch: &mut [f32])
        = smooth_pixels_kernel::<3>;
}

#[inline(always)]
fn smooth_pixels_kernel<const N: usize>(
    source: &PixelRows<'_>,
    [along, across]: [&Taps; 2],
    middle: [f32; N],
    mut out: [&mut ImagePlane; N],
    scratch: &mut [f32],
) {
    let (width, stride) = (source.size.0 * N, source.stride);
    let (padded, mixed) = scratch.split_at_mut(width + 2 * RADIUS_MAX * N);
    let mixed = &mut mixed[..width];
    let (side, last) = (along.radius * N, source.size.1 as isize - 1);
    let mut row_starts = ROW_STARTS;
    for start in &mut row_starts {
        *start *= N;
    }
    let mut starts = [0; 2 * RADIUS_MAX + 1];
    for y in source.wanted.0..source.wanted.1 {
        for (j, start) in starts.iter_mut().enumerate().take(across.weights().len()) {
            let row = (y as isize + j as isize - across.radius as isize).clamp(0, last) as usize;
            *start = (row - source.first) * stride;
        }
        filter_groups(source.values, &starts, across, &mut padded[side..side + width]);
        for k in 0..side {
            padded[k] = padded[side + k % N];
            padded[side + width + k] = padded[side + width - N + k % N];
        }
        filter_groups(padded, &row_starts, along, mixed);
        take_apart(mixed, &middle, out.each_mut().map(|plane| plane.row_mut(y)));
    }
}

/// Writes the values of pixels, minus `middle`, each channel into its own row.
#[inline(always)]
fn take_apart<const N: usize>(pixels: &[f32], middle: &[f32; N], mut out: [&mut [f32]; N]) {
    let (pixels, _) = pixels.as_chunks::<N>();
    let (groups, rest) = pixels.as_chunks::<LANES>();
    for (k, group) in groups.iter().enumerate() {
        for (c, out) in out.iter_mut().enumerate() {
            // A whole group at a time: with known positions the compiler shuffles instead of gathering.
            let values: [f32; LANES] = std::array::from_fn(|i| group[i][c] - middle[c]);
            out[k * LANES..][..LANES].copy_from_slice(&values);
        }
    }
    for (i, pixel) in rest.iter().enumerate() {
        for (c, out) in out.iter_mut().enumerate() {
            out[groups.len() * LANES + i] = pixel[c] - middle[c];
        }
    }
}

/// Number of columns filtered together in a long row: with this many independent sums no sum waits for another.
const SIDE_BY_SIDE: usize = 4 * LANES;

/// Start positions of the values for each weight.
type Starts = [usize; 2 * RADIUS_MAX + 1];

/// Within a row, each weight starts one value further on.
const ROW_STARTS: Starts = {
    let mut starts = [0; 2 * RADIUS_MAX + 1];
    let mut j = 0;
    while j < starts.len() {
        starts[j] = j;
        j += 1;
    }
    starts
};

/// Writes all columns of a row; the last group may overlap the previous one.
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

/// Writes `N` adjacent columns from `first` on: weight `j` applies to the values from `starts[j] + first` on. Uses the symmetry
/// of the weights.
#[inline(always)]
fn filter_group<const N: usize>(values: &[f32], starts: &Starts, taps: &Taps, first: usize, out: &mut [f32]) {
    let (weights, radius) = (taps.weights(), taps.radius);
    let mut sums = [0.0_f32; N];
    let centre = &values[starts[radius] + first..][..N];
    for i in 0..N {
        sums[i] = weights[radius] * centre[i];
    }
    for (k, weight) in weights[radius + 1..].iter().enumerate() {
        let before = &values[starts[radius - 1 - k] + first..][..N];
        let after = &values[starts[radius + 1 + k] + first..][..N];
        for i in 0..N {
            sums[i] += weight * (before[i] + after[i]);
        }
    }
    out[first..first + N].copy_from_slice(&sums);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussians_keep_the_mean_and_have_their_width() {
        for sigma in [0.7, 0.8, 1.5, 3.0] {
            let taps = Taps::gaussian(sigma);
            let moment = |power: i32| -> f64 {
                let at = |i: usize| i as f64 - taps.radius() as f64;
                taps.weights().iter().enumerate().map(|(i, w)| f64::from(*w) * at(i).powi(power)).sum()
            };
            assert!((moment(0) - 1.0).abs() < 1e-6 && moment(1).abs() < 1e-6);
            assert!((moment(2) - sigma * sigma).abs() < 0.1 * sigma * sigma);
        }
    }

    #[test]
    fn splines_go_through_the_smooth_values() {
        for sigma in [0.4, 0.6, 1.3] {
            let (spline, plain) = (Taps::spline(sigma), Taps::gaussian(sigma));
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

    /// Smooths by definition: a sum over all pairs of weights, with replicated borders.
    fn plain_sum(
        value: impl Fn(usize, usize) -> f32,
        size: (usize, usize),
        taps: (&Taps, &Taps),
        at: (usize, usize),
    ) -> f64 {
        let (mut sum, along, across) = (0.0, taps.0, taps.1);
        for (j, b) in across.weights().iter().enumerate() {
            for (i, a) in along.weights().iter().enumerate() {
                let u = (at.0 as i32 + i as i32 - along.radius() as i32).clamp(0, size.0 as i32 - 1) as usize;
                let v = (at.1 as i32 + j as i32 - across.radius() as i32).clamp(0, size.1 as i32 - 1) as usize;
                sum += f64::from(*a) * f64::from(*b) * f64::from(value(u, v));
            }
        }
        sum
    }

    fn check<const N: usize>((width, height): (usize, usize), middle: [f32; N]) {
        let value = |x: usize, y: usize, c: usize| ((x * 37 + y * 101 + c * 53) % 97) as f32;
        let (along, across) = (Taps::spline(0.6), Taps::gaussian(0.8));
        // One row is missing at each end, and there is one extra column.
        let rows = ImagePlane::from_fn(N * width + 1, height - 2, |i, y| {
            if i < N * width { value(i / N, y + 1, i % N) } else { f32::NAN }
        });
        let size = (width, height);
        let edge = 1 + across.radius();
        let (values, stride) = (rows.values(), rows.width());
        let source = PixelRows { size, values, stride, first: 1, wanted: (edge, height - edge) };
        let mut first: Option<[ImagePlane; N]> = None;
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut out = std::array::from_fn(|_| ImagePlane::default());
            Smoother::default().smooth_pixels(&source, &along, &across, &middle, &mut out, kernels);
            for (c, out) in out.iter().enumerate() {
                for (x, y) in (0..width).flat_map(|x| (edge..height - edge).map(move |y| (x, y))) {
                    let expected = plain_sum(|u, v| value(u, v, c), size, (&along, &across), (x, y));
                    let found = f64::from(out.row(y)[x] + middle[c]);
                    assert!((found - expected).abs() < 1e-3, "{width} {x} {y} {c}: {found}, not {expected}");
                }
            }
            assert_eq!(*first.get_or_insert(out.clone()), out, "{}", kernels.set().name());
        }
    }

    #[test]
    fn pixels_are_smoothed_as_a_plain_sum_does_with_every_kernel() {
        for size in [(91, 20), (61, 23), (16, 9), (9, 11)] {
            check(size, [3.0, -5.0, 40.0]);
            check(size, [7.5]);
        }
    }
}
