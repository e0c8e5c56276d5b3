//! Resampling of windows of a raw image to rectified pixels, cell by cell.
//!
//! A cell has 16 x 16 rectified pixels. The lens model is evaluated at the corners of the cells only; positions between them
//! are interpolated with cubic polynomials along rows and columns, and compared with the lens model at the centre of each cell.
//! A cell whose centre is off, or that the lens images only in part, is evaluated pixel by pixel. Colours are interpolated
//! with a cubic kernel (Keys 1981, a = -1/2).

mod cells;
mod source;
#[cfg(test)]
mod tests;

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::maps::PixelMap;

pub(super) use cells::{CELL, for_each_cell};
use cells::{CellPositions, extremes_kernel, whole};
pub(super) use source::{REDUCTION_MAX, ReducedImage};
use source::{RawImage, TAPS, Value};

use super::colour_planes::{ColourPlanes, OPPONENT_FROM_RGB, SATURATED, UNSEEN, Wanted};
use super::image_plane::PixelWindow;
use super::row_shift::keys;

/// Part of the output covered by a cell: slices from the cell's first pixel on.
struct CellOutput<'a> {
    /// Requested channels.
    pub wanted: Wanted,
    /// Columns and rows of the cell inside the window.
    pub size: (usize, usize),
    /// Pixels per row of the output.
    pub stride: usize,
    /// The planes.
    pub planes: [&'a mut [f32]; 3],
    /// The flags.
    pub flags: &'a mut [u8],
}

impl CellOutput<'_> {
    /// Marks all pixels as unseen.
    pub fn clear(&mut self) {
        for row in 0..self.size.1 {
            let span = row * self.stride..row * self.stride + self.size.0;
            for plane in self.planes.iter_mut().take(self.wanted.planes()) {
                plane[span.clone()].fill(0.0);
            }
            self.flags[span].fill(UNSEEN);
        }
    }
}

wide! {
    /// Interpolates the colours of a cell of a raw image.
    fn sample(raw: RawImage<'_, u8>, positions: &CellPositions, out: &mut CellOutput<'_>) = sample_kernel::<u8>;
}

wide! {
    /// Interpolates the colours of a cell of a reduced image.
    fn sample_reduced(raw: RawImage<'_, u16>, positions: &CellPositions, out: &mut CellOutput<'_>) = sample_kernel::<u16>;
}

/// Fills the part of a window inside the destination image from the whole raw image.
pub(super) fn resample(
    map: &PixelMap,
    raw: ImageView<'_>,
    window: PixelWindow,
    wanted: Wanted,
    kernels: Kernels,
    out: &mut ColourPlanes,
) {
    let (borrowed, mut converted) = (RawImage::borrowed(raw), Vec::new());
    fill_cells(map, window, wanted, kernels, out, |positions, cell| {
        let raw = borrowed.unwrap_or_else(|| RawImage::of_cell(raw, positions, &mut converted));
        sample(kernels, raw, positions, cell);
    });
}

/// As [`resample`], at a size reduced by `scale`: `map` and `window` are between reduced images.
#[allow(clippy::too_many_arguments, reason = "image, map, window and buffers")]
pub(super) fn resample_reduced(
    map: &PixelMap,
    raw: ImageView<'_>,
    window: PixelWindow,
    scale: usize,
    wanted: Wanted,
    kernels: Kernels,
    reduced: &mut ReducedImage,
    out: &mut ColourPlanes,
) {
    let window = window.clipped(map.size().width, map.size().height);
    reduced.update(map, raw, &window, scale, kernels);
    let raw = reduced.image();
    fill_cells(map, window, wanted, kernels, out, |positions, cell| sample_reduced(kernels, raw, positions, cell));
}

fn fill_cells(
    map: &PixelMap,
    window: PixelWindow,
    wanted: Wanted,
    kernels: Kernels,
    out: &mut ColourPlanes,
    mut sample: impl FnMut(&CellPositions, &mut CellOutput<'_>),
) {
    let window = window.clipped(map.size().width, map.size().height);
    out.resize(window, wanted);
    for_each_cell(map, &window, kernels, |(x, y), positions| {
        let start = y * window.width + x;
        let planes = out.planes.each_mut().map(|plane| plane.values_mut().get_mut(start..).unwrap_or_default());
        let size = (CELL.min(window.width - x), CELL.min(window.height - y));
        let mut cell = CellOutput { wanted, size, stride: window.width, planes, flags: &mut out.flags[start..] };
        match positions {
            Some(positions) => sample(positions, &mut cell),
            None => cell.clear(),
        }
    });
}

#[inline(always)]
fn sample_kernel<T: Value>(raw: RawImage<'_, T>, positions: &CellPositions, out: &mut CellOutput<'_>) {
    // Taps begin before this position. Two pixels in the last corner, whose taps do not fill a register, are not used.
    let length = raw.values.len().saturating_sub(3 * raw.stride);
    let lines: [&[T]; 4] = std::array::from_fn(|j| &raw.values[(j * raw.stride).min(raw.values.len())..]);
    let lines = lines.map(|line| &line[..length.min(line.len())]);
    let may_be_saturated = may_be_saturated(&raw, positions);
    let count = out.size.0.min(CELL);
    // Of a whole row: with one pixel at a time, the second sums wait for the first to be stored, and take 1.7 times as long.
    let mut sums = [[0.0_f32; TAPS]; CELL];
    for y in 0..out.size.1.min(CELL) {
        let (columns, column_weights) = split(positions.base[0] - raw.first[0], &positions.at[0][y]);
        let (rows, mut row_weights) = split(positions.base[1] - raw.first[1], &positions.at[1][y]);
        row_weights.as_flattened_mut().iter_mut().for_each(|weight| *weight *= raw.share);
        let starts = first_taps(&raw, &columns, &rows);
        let mut flags = [0_u8; CELL];
        for i in 0..count {
            let start = starts[i] as usize;
            if start.saturating_add(TAPS) > length {
                (sums[i], flags[i]) = ([0.0; TAPS], UNSEEN);
                continue;
            }
            add_rows(&lines, start, (&row_weights, i), &mut sums[i]);
        }
        if may_be_saturated {
            mark_saturated(&raw, &columns, &rows, &mut flags[..count]);
        }
        // The fourth value of a pixel is overwritten by the next one.
        let mut line = [0.0_f32; 3 * CELL + 1];
        for i in 0..count {
            let pixel = add_columns(&sums[i], (&column_weights, i));
            line[3 * i..3 * i + 4].copy_from_slice(&pixel);
        }
        out.put(y, &line, &flags);
    }
}

/// Positions of the first taps of a row of pixels; beyond any image without a source.
#[inline(always)]
fn first_taps<T: Value>(raw: &RawImage<'_, T>, columns: &[i32; CELL], rows: &[i32; CELL]) -> [u32; CELL] {
    let (stride, last_column, last_row) = (raw.stride as u32, raw.width as i32 - 3, raw.height as i32 - 3);
    let mut starts = [0; CELL];
    for i in 0..CELL {
        let is_inside = (columns[i] >= 1) & (columns[i] <= last_column) & (rows[i] >= 1) & (rows[i] <= last_row);
        let start = (rows[i] as u32).wrapping_sub(1).wrapping_mul(stride);
        let start = start.wrapping_add((columns[i] as u32).wrapping_sub(1).wrapping_mul(3));
        starts[i] = if is_inside { start } else { u32::MAX };
    }
    starts
}

/// Sums of four rows of taps with the weights of pixel `i`.
#[inline(always)]
fn add_rows<T: Value>(
    lines: &[&[T]; 4],
    start: usize,
    (weights, i): (&[[f32; CELL]; 4], usize),
    out: &mut [f32; TAPS],
) {
    let taps = lines.map(|line| line.get(start..start + TAPS).and_then(|line| line.first_chunk::<TAPS>()));
    let [Some(a), Some(b), Some(c), Some(d)] = taps else { return };
    for k in 0..TAPS {
        let upper = weights[0][i] * a[k].grey() + weights[1][i] * b[k].grey();
        out[k] = upper + (weights[2][i] * c[k].grey() + weights[3][i] * d[k].grey());
    }
}

/// Sums along a row of taps with the weights of pixel `i`: red, green, blue and an unused value.
#[inline(always)]
fn add_columns(sums: &[f32; TAPS], (weights, i): (&[[f32; CELL]; 4], usize)) -> [f32; 4] {
    let mut pixel = [0.0; 4];
    for c in 0..4 {
        let left = weights[0][i] * sums[c] + weights[1][i] * sums[3 + c];
        pixel[c] = left + (weights[2][i] * sums[6 + c] + weights[3][i] * sums[9 + c]);
    }
    pixel
}

impl CellOutput<'_> {
    /// Writes one row: red, green and blue of its pixels, interleaved.
    #[inline(always)]
    fn put(&mut self, y: usize, line: &[f32; 3 * CELL + 1], flags: &[u8; CELL]) {
        let first = y * self.stride;
        copy(flags, self.size.0, &mut self.flags[first..]);
        if self.wanted == Wanted::Rgb {
            for (c, plane) in self.planes.iter_mut().enumerate() {
                let values: [f32; CELL] = std::array::from_fn(|i| line[3 * i + c]);
                copy(&values, self.size.0, &mut plane[first..]);
            }
            return;
        }
        for (plane, turn) in self.planes.iter_mut().zip(OPPONENT_FROM_RGB).take(self.wanted.planes()) {
            let mut values = [0.0_f32; CELL];
            for i in 0..CELL {
                values[i] = turn[0] * line[3 * i] + turn[1] * line[3 * i + 1] + turn[2] * line[3 * i + 2];
            }
            copy(&values, self.size.0, &mut plane[first..]);
        }
    }
}

/// Copies the first `count` of a row of values; a whole row is a single store.
#[inline(always)]
fn copy<T: Copy>(from: &[T; CELL], count: usize, to: &mut [T]) {
    match to.first_chunk_mut::<CELL>() {
        Some(to) if count == CELL => *to = *from,
        _ => to[..count].copy_from_slice(&from[..count]),
    }
}

/// Values that are compared at once.
const LANES: usize = 32;

/// Whether the part of the image that a cell shows has a saturated value.
#[inline(always)]
fn may_be_saturated<T: Value>(raw: &RawImage<'_, T>, positions: &CellPositions) -> bool {
    let mut ends = [(0.0, 0.0); 2];
    extremes_kernel(&positions.at, &mut ends);
    if ends.iter().any(|(low, _)| *low < 0.0) {
        return true;
    }
    let span = |axis: usize, length: usize| {
        let first = i64::from(positions.base[axis] - raw.first[axis]);
        let pixel = |at: i64| at.clamp(0, length as i64) as usize;
        pixel(first + ends[axis].0 as i64 - 1)..pixel(first + ends[axis].1 as i64 + 3)
    };
    let (columns, rows) = (span(0, raw.width), span(1, raw.height));
    // Whole registers: a few more values than needed.
    let length = (3 * columns.len()).next_multiple_of(LANES);
    let (mut highest, mut last) = ([T::default(); LANES], T::default());
    for row in rows {
        let start = (row * raw.stride + 3 * columns.start).min(raw.values.len());
        let (values, rest) = raw.values[start..(start + length).min(raw.values.len())].as_chunks::<LANES>();
        for values in values {
            for k in 0..LANES {
                highest[k] = highest[k].max(values[k]);
            }
        }
        last = rest.iter().fold(last, |last, &value| last.max(value));
    }
    highest.into_iter().fold(last, T::max).is_saturated()
}

/// Flags the pixels with a saturated value in their neighbourhood.
#[inline(never)]
fn mark_saturated<T: Value>(raw: &RawImage<'_, T>, columns: &[i32; CELL], rows: &[i32; CELL], flags: &mut [u8]) {
    for ((column, row), flag) in columns.iter().zip(rows).zip(flags).filter(|(_, flag)| **flag == 0) {
        let mut values = raw.taps(*column, *row).into_iter().flatten().flat_map(|row| &row[..12]);
        *flag = u8::from(values.any(|value| value.is_saturated())) * SATURATED;
    }
}

/// Whole pixels, and the weights of the pixels at -1, 0, 1 and 2 from them.
#[inline(always)]
fn split(base: i32, at: &[f32; CELL]) -> ([i32; CELL], [[f32; CELL]; 4]) {
    let (mut numbers, mut weights) = ([0; CELL], [[0.0; CELL]; 4]);
    for i in 0..CELL {
        let (number, floor) = whole(base, at[i]);
        numbers[i] = number;
        let [a, b, c, d] = keys(at[i] - floor);
        (weights[0][i], weights[1][i], weights[2][i], weights[3][i]) = (a, b, c, d);
    }
    (numbers, weights)
}
