//! Resampling of windows of a raw image to rectified pixels, cell by cell.
//!
//! A cell has 16 x 16 rectified pixels. The lens model is evaluated at the corners of the cells only; positions between them
//! are interpolated with cubic polynomials along rows and columns, and compared with the lens model at the centre of each cell.
//! A cell whose centre is off, or that the lens images only in part, is evaluated pixel by pixel. Colours are interpolated
//! with a cubic kernel (Keys 1981, a = -1/2).
//!
//! Neighbours in a row of a cell are nearly neighbours in the source: their distance changes by a pixel or two along the row.
//! All 16 pixels are therefore summed at once over a few more pixels than the kernel has, with weights that are zero where a
//! pixel is not theirs. Strongly turned or bent cells are interpolated pixel by pixel.

mod cells;
mod patch;
mod source;
#[cfg(test)]
mod tests;

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::maps::PixelMap;

use cells::CellPositions;
pub(super) use cells::{CELL, for_each_cell};
use patch::Patch;
pub(super) use source::REDUCTION_MAX;
pub use source::ReducedImage;
use source::{RawImage, Value};

use super::colour_planes::{ColourPlanes, SATURATED, UNSEEN, Wanted};
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
    fn sample(raw: RawImage<'_, u8>, positions: &CellPositions, patch: &mut Patch, out: &mut CellOutput<'_>) = sample_kernel::<u8>;
}

wide! {
    /// Interpolates the colours of a cell of a reduced image.
    fn sample_reduced(raw: RawImage<'_, u16>, positions: &CellPositions, patch: &mut Patch, out: &mut CellOutput<'_>) = sample_kernel::<u16>;
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
    let (borrowed, mut converted, mut patch) = (RawImage::borrowed(raw), Vec::new(), Patch::default());
    fill_cells(map, window, wanted, kernels, out, |positions, cell| {
        let raw = borrowed.unwrap_or_else(|| RawImage::of_cell(raw, positions, &mut converted));
        sample(kernels, raw, positions, &mut patch, cell);
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
    let mut patch = Patch::default();
    fill_cells(map, window, wanted, kernels, out, |positions, cell| {
        sample_reduced(kernels, raw, positions, &mut patch, cell);
    });
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
fn sample_kernel<T: Value>(
    raw: RawImage<'_, T>,
    positions: &CellPositions,
    patch: &mut Patch,
    out: &mut CellOutput<'_>,
) {
    let fits = patch.take(&raw, positions, out.wanted);
    for y in 0..out.size.1.min(CELL) {
        let (mut values, mut flags) = ([[0.0_f32; CELL]; 3], [0_u8; CELL]);
        if fits {
            patch.row(positions, y, out.wanted, &mut values);
        } else {
            singly(&raw, positions, y, out.wanted, &mut values);
        }
        if !fits || !patch.is_inside {
            mark_unseen(&raw, positions, y, &mut values, &mut flags);
        }
        if !fits || patch.may_be_saturated {
            mark_saturated(&raw, positions, y, &mut flags);
        }
        let first = y * out.stride;
        copy(&flags, out.size.0, &mut out.flags[first..]);
        for (plane, values) in out.planes.iter_mut().zip(&values).take(out.wanted.planes()) {
            copy(values, out.size.0, &mut plane[first..]);
        }
    }
}

/// Interpolates a row of a cell pixel by pixel.
#[inline(never)]
fn singly<T: Value>(
    raw: &RawImage<'_, T>,
    positions: &CellPositions,
    y: usize,
    wanted: Wanted,
    out: &mut [[f32; CELL]; 3],
) {
    for i in 0..CELL {
        let [(column, at_column), (row, at_row)] = raw.split(positions, y, i);
        let Some(taps) = raw.taps(column, row) else { continue };
        let (columns, rows) = (keys(at_column), keys(at_row));
        let mut colour = [0.0; 3];
        for (taps, weight) in taps.into_iter().zip(rows) {
            for (pixel, column) in taps.as_chunks::<3>().0.iter().zip(columns) {
                for (colour, value) in colour.iter_mut().zip(pixel) {
                    *colour += weight * column * raw.share * value.grey();
                }
            }
        }
        for (c, out) in out.iter_mut().enumerate().take(wanted.planes()) {
            out[i] = wanted.channel(c, colour);
        }
    }
}

/// Flags the pixels that the source does not show.
#[inline(never)]
fn mark_unseen<T: Value>(
    raw: &RawImage<'_, T>,
    positions: &CellPositions,
    y: usize,
    values: &mut [[f32; CELL]; 3],
    flags: &mut [u8; CELL],
) {
    for i in 0..CELL {
        let [(column, _), (row, _)] = raw.split(positions, y, i);
        if raw.taps(column, row).is_none() {
            flags[i] = UNSEEN;
            values.iter_mut().for_each(|values| values[i] = 0.0);
        }
    }
}

/// Flags the pixels with a saturated value in their neighbourhood.
#[inline(never)]
fn mark_saturated<T: Value>(raw: &RawImage<'_, T>, positions: &CellPositions, y: usize, flags: &mut [u8; CELL]) {
    for (i, flag) in flags.iter_mut().enumerate() {
        let [(column, _), (row, _)] = raw.split(positions, y, i);
        let taps = raw.taps(column, row).into_iter().flatten().flatten();
        *flag |= u8::from(taps.into_iter().any(|value| value.is_saturated())) * SATURATED;
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
