//! Means of an image over the pixels of a level, with its rows moved by a fraction of a pixel.
//!
//! Moving rows (cubic, Keys 1981) and averaging over squares are both sums along columns. Here they are one sum of `scale + 3`
//! weighted rows, computed directly from the bytes of the image. The values of a pixel are interleaved.

use nalgebra::Vector2;
use pb3dp_estimation_core::wide::wide;

use pb3dp_estimation_core::row_offset::RowOffset;
use pb3dp_estimation_views::image_plane::ImagePlane;
use pb3dp_estimation_views::row_shift::{BLOCK, keys};

/// Rows of pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageRows<'a, T> {
    /// Values row by row; the values of a pixel are interleaved.
    pub values: &'a [T],
    /// Values per row.
    pub stride: usize,
    /// Offset of the first required column in a row.
    pub start: usize,
    /// Row of the full image at which the values begin.
    pub top: i32,
    /// Number of rows.
    pub rows: usize,
}

/// Grid of the means to compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    /// Side of the squares, pixels.
    pub scale: usize,
    /// First column and row, pixels of the full image.
    pub first: (i32, i32),
    /// Columns and rows, squares.
    pub size: (usize, usize),
    /// Row `v` of the means shows the image at row `v + offset`; `None`: rows are not moved.
    pub rows: Option<RowOffset>,
}

impl Grid {
    /// Offset of the first block of columns of a row of the full image, and the change from block to block, pixels.
    #[inline(always)]
    pub fn offsets(&self, row: f64) -> (f64, f64) {
        let Some(rows) = &self.rows else { return (0.0, 0.0) };
        // Evaluated at the centre of the block's columns.
        let centre = Vector2::new(f64::from(self.first.0) + (BLOCK - 1) as f64 / 2.0, row);
        (rows.at(&centre), rows.slope.x * BLOCK as f64)
    }

    /// First row and one past the last row of the full image that the means use, before clamping to the border.
    pub fn rows_read(&self) -> (i32, i32) {
        let s = self.scale as f64;
        let (first, last) = (f64::from(self.first.1), f64::from(self.first.1) + s * self.size.1 as f64 - 1.0);
        let blocks = (self.size.0 * self.scale).div_ceil(BLOCK).saturating_sub(1) as f64;
        let ends = |row: f64| {
            let (offset, step) = self.offsets(row);
            [offset, offset + step * blocks]
        };
        let corners = ends(first).into_iter().chain(ends(last));
        let (low, high) = corners.fold((f64::MAX, f64::MIN), |(low, high), at| (low.min(at), high.max(at)));
        let reach = if self.rows.is_some() { 3.0 } else { 0.0 };
        ((first + low - reach).floor() as i32, ((last + high + reach).ceil() as i32).saturating_add(1))
    }
}

wide! {
    /// Means of red, green and blue, interleaved; `out` gets one extra column.
    pub(super) fn average_colours(source: &ImageRows<'_, u8>, grid: &Grid, out: &mut ImagePlane) = average::<u8, 3, { 3 * BLOCK }>;
}

wide! {
    /// Means of one channel.
    pub(super) fn average_bytes(source: &ImageRows<'_, u8>, grid: &Grid, out: &mut ImagePlane) = average::<u8, 1, BLOCK>;
}

wide! {
    /// Means of one resampled channel.
    pub(super) fn average_values(source: &ImageRows<'_, f32>, grid: &Grid, out: &mut ImagePlane) = average::<f32, 1, BLOCK>;
}

/// The means of `N` values per pixel; `W` is the number of values of a block.
#[inline(always)]
fn average<T: Copy, const N: usize, const W: usize>(source: &ImageRows<'_, T>, grid: &Grid, out: &mut ImagePlane)
where
    f32: From<T>,
{
    let (scale, width) = (grid.scale, grid.size.0 * grid.scale);
    out.resize(grid.size.0 * N + 1, grid.size.1);
    // The pooling of the last pixel reads beyond it.
    let mut full = [[0.0_f32; W]; 2];
    for y in 0..grid.size.1 {
        let row = f64::from(grid.first.1) + (y * scale) as f64;
        let (first, step) = grid.offsets(row + (scale - 1) as f64 / 2.0);
        let out = out.row_mut(y);
        out.fill(0.0);
        for block in 0..width.div_ceil(BLOCK) {
            let offset = first + step * block as f64;
            let floor = offset.floor();
            let weights = Weights::new(grid.rows.is_some().then_some((offset - floor) as f32), scale);
            let top = (row + floor) as i64 - i64::from(source.top);
            mix(source, top, block * W, &weights, &mut full[0]);
            let columns = BLOCK.min(width - block * BLOCK);
            pool::<N>(&full.as_flattened()[..columns * N + 1], scale, block * BLOCK, out);
        }
    }
}

/// Weights of neighbouring rows.
struct Weights {
    /// Cumulative weights of the moved rows.
    before: [f32; 5],
    scale: usize,
    /// Range of the `scale + 3` rows, counted from the row above, with a weight.
    range: (usize, usize),
}

impl Weights {
    #[inline(always)]
    fn new(fraction: Option<f32>, scale: usize) -> Self {
        let share = 1.0 / (scale * scale) as f32;
        match fraction {
            Some(fraction) => {
                let [a, b, c, _] = keys(fraction);
                let before = [0.0, share * a, share * (a + b), share * (a + b + c), share];
                Self { before, scale, range: (0, scale + 3) }
            }
            None => Self { before: [0.0, 0.0, share, share, share], scale, range: (1, scale + 1) },
        }
    }

    /// The weight of a row: the weights of the moved rows, summed over the rows of the square.
    #[inline(always)]
    fn of(&self, row: usize) -> f32 {
        self.before[(row + 1).min(4)] - self.before[(row + 1).saturating_sub(self.scale).min(4)]
    }
}

/// The weighted sum of rows around row `top` of the image; rows beyond the border replicate the border.
#[inline(always)]
fn mix<T: Copy, const W: usize>(
    source: &ImageRows<'_, T>,
    top: i64,
    column: usize,
    weights: &Weights,
    out: &mut [f32; W],
) where
    f32: From<T>,
{
    let last = source.rows as i64 - 1;
    let mut sums = [0.0_f32; W];
    for j in weights.range.0..weights.range.1 {
        let start = (top + j as i64 - 1).clamp(0, last) as usize * source.stride + source.start + column;
        let weight = weights.of(j);
        if let Some(values) = source.values.get(start..start + W).and_then(|values| values.first_chunk::<W>()) {
            for i in 0..W {
                sums[i] += weight * f32::from(values[i]);
            }
        } else {
            // At the end of the last row, where less than a whole block remains.
            for (sum, value) in sums.iter_mut().zip(&source.values[start..]) {
                *sum += weight * f32::from(*value);
            }
        }
    }
    *out = sums;
}

/// Sums the values of a block along rows, square by square, from the full-size column `first` on.
#[inline(always)]
fn pool<const N: usize>(full: &[f32], scale: usize, first: usize, out: &mut [f32]) {
    let to = first / scale * N;
    match scale {
        1 => out[to..to + full.len()].copy_from_slice(full),
        2 => pool_squares::<N, 2>(full, &mut out[to..]),
        4 => pool_squares::<N, 4>(full, &mut out[to..]),
        8 => pool_squares::<N, 8>(full, &mut out[to..]),
        _ => {
            for (i, pixel) in full.chunks_exact(N).enumerate().take((full.len() - 1) / N) {
                let out = &mut out[(first + i) / scale * N..][..N];
                for (out, value) in out.iter_mut().zip(pixel) {
                    *out += value;
                }
            }
        }
    }
}

/// As [`pool`] for squares of side `S`, each summed at once.
#[inline(always)]
fn pool_squares<const N: usize, const S: usize>(full: &[f32], out: &mut [f32]) {
    let count = (full.len() - 1) / (N * S);
    if N == 1 {
        for (out, values) in out.iter_mut().zip(full.as_chunks::<S>().0) {
            *out = values.iter().fold(0.0, |sum, value| sum + value);
        }
        return;
    }
    for i in 0..count {
        // Four values at once; the next pixel overwrites the fourth.
        let mut sum = [0.0_f32; 4];
        for h in 0..S {
            if let Some(values) = full[(i * S + h) * N..].first_chunk::<4>() {
                for c in 0..4 {
                    sum[c] += values[c];
                }
            }
        }
        out[i * N..i * N + 4].copy_from_slice(&sum);
    }
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use pb3dp_estimation_core::cpu::Kernels;

    use super::*;
    use pb3dp_estimation_views::colour_planes::{ColourPlanes, Wanted};
    use pb3dp_estimation_views::image_plane::PixelWindow;
    use pb3dp_estimation_views::row_shift::shift_rows;

    fn image() -> RgbImage {
        RgbImage::from_fn(100, 80, |x, y| {
            let noise = |k: u32| ((x * 31 + y * 57 + k * 17).wrapping_mul(2_654_435_761) >> 24) as u8;
            image::Rgb([noise(1), noise(2), noise(3)])
        })
    }

    /// Reference: the mean over one square of a plane of the whole image.
    fn mean(plane: &ImagePlane, grid: &Grid, x: usize, y: usize) -> f32 {
        let s = grid.scale;
        let (left, top) = (grid.first.0 as usize + s * x, grid.first.1 as usize + s * y);
        (0..s).map(|v| plane.row(top + v)[left..left + s].iter().sum::<f32>()).sum::<f32>() / (s * s) as f32
    }

    #[test]
    fn means_are_those_of_rows_that_were_moved_with_every_kernel() {
        let image = image();
        let moved = RowOffset { centre_px: Vector2::new(50.0, 40.0), offset_px: -1.3, slope: Vector2::new(0.01, 0.0) };
        for (scale, rows) in [1, 2, 4, 8, 16].into_iter().flat_map(|s| [(s, None), (s, Some(moved))]) {
            // Up to the last column; blocks of columns begin at the window.
            let (x, size) = (if scale == 1 { 15 } else { 4 }, (96 / scale - usize::from(scale == 1) * 11, 64 / scale));
            let grid = Grid { scale, first: (x, 8), size, rows };
            let (mut whole, mut shifted) = (ColourPlanes::default(), ColourPlanes::default());
            let window = PixelWindow { x, y: 0, width: 100 - x as usize, height: 80 };
            whole.update((&image).into(), window, Wanted::Rgb, Kernels::best());
            if let Some(rows) = &rows {
                shift_rows(&whole, rows, Kernels::best(), &mut shifted);
                whole = shifted;
            }
            let source =
                ImageRows { values: image.as_raw().as_slice(), stride: 300, start: 3 * x as usize, top: 0, rows: 80 };
            let mut first: Option<ImagePlane> = None;
            for kernels in pb3dp_estimation_test_support::every_kernel() {
                let mut out = ImagePlane::default();
                average_colours(kernels, &source, &grid, &mut out);
                let local = Grid { first: (0, 8), ..grid };
                for (x, y) in (0..size.0).flat_map(|x| (0..size.1).map(move |y| (x, y))) {
                    for (c, plane) in whole.planes.iter().enumerate() {
                        let expected = mean(plane, &local, x, y);
                        let got = out.row(y)[3 * x + c];
                        assert!((got - expected).abs() < 1e-2, "{scale} {rows:?} {x} {y}: {got}, not {expected}");
                    }
                }
                assert_eq!(*first.get_or_insert(out.clone()), out, "{}", kernels.set().name());
            }
        }
    }

    #[test]
    fn one_channel_is_averaged_as_three_are() {
        let image = image();
        let rows = RowOffset { centre_px: Vector2::zeros(), offset_px: 0.7, slope: Vector2::new(0.0, 0.004) };
        for scale in [1, 2, 4, 16] {
            // Its rows extend beyond the border.
            let grid = Grid { scale, first: (0, 0), size: (80 / scale, 80 / scale), rows: Some(rows) };
            assert!(grid.rows_read().0 <= -1 && grid.rows_read().1 >= 80);
            let green: Vec<u8> = image.pixels().map(|pixel| pixel.0[1]).collect();
            let floats: Vec<f32> = green.iter().map(|&value| f32::from(value)).collect();
            let three = ImageRows { values: image.as_raw().as_slice(), stride: 300, start: 0, top: 0, rows: 80 };
            let one = ImageRows { values: green.as_slice(), stride: 100, start: 0, top: 0, rows: 80 };
            let value = ImageRows { values: floats.as_slice(), stride: 100, start: 0, top: 0, rows: 80 };
            let mut out = [ImagePlane::default(), ImagePlane::default(), ImagePlane::default()];
            let kernels = Kernels::best();
            average_colours(kernels, &three, &grid, &mut out[0]);
            average_bytes(kernels, &one, &grid, &mut out[1]);
            average_values(kernels, &value, &grid, &mut out[2]);
            for (x, y) in (0..grid.size.0).flat_map(|x| (0..grid.size.1).map(move |y| (x, y))) {
                let [three, one, value] = [out[0].row(y)[3 * x + 1], out[1].row(y)[x], out[2].row(y)[x]];
                assert!((three - one).abs() < 1e-3 && one == value, "{scale} {x} {y}: {three} {one} {value}");
            }
        }
    }
}
