//! The inner loops: one source for every vector width. Each step is a separate loop over a chunk, which compiles to a few
//! vector instructions; only the look-ups in between process one element at a time.

use pb3dp_estimation_core::wide::wide;

use super::batch::{BATCH, Batch, FRACTION_BITS};
use super::points::{CHUNK, PointSet};

/// Number of point chunks whose positions and pixels are buffered.
const BLOCK: usize = 16;

/// Number of hypotheses that look up together.
const LANES: usize = 16;

/// Number of columns whose hues are compared in one step, one bit each.
pub(super) const BITS_PER_WORD: usize = 32;

/// The match bits of one kind of points.
#[derive(Clone, Copy)]
pub(super) struct TableView<'a> {
    /// Number of usable bits per point; the next bit exists and is zero.
    pub shifts: u32,
    /// At least 8.
    pub words_per_point: usize,
    /// All points' words.
    pub words: &'a [u32],
    pub points: &'a PointSet,
}

/// The right image as read by the kernels. Pixel (u, v) is element `base + v width + u`; element 0 has no hue and represents
/// everything outside the image.
#[derive(Clone, Copy)]
pub(super) struct PlaneView<'a> {
    pub data: &'a [u16],
    pub base: i32,
    pub width: i32,
    pub height: i32,
}

/// 1 if a stored pixel has a hue within `tolerance` of a valid stored hue, otherwise 0.
#[inline(always)]
fn matches(pixel: u16, hue: u16, tolerance: u16) -> u16 {
    let is_near = pixel.wrapping_sub(hue).cast_signed().unsigned_abs() <= tolerance;
    pixel & hue & u16::from(is_near)
}

wide! {
    /// One bit per pixel: set if it has a hue within `tolerance` of `hue`. 32 pixels per word.
    pub(super) fn compare(pixels: &[u16], hue: u16, tolerance: u16, words: &mut [u32]) = compare_kernel;
}

#[inline(always)]
fn compare_kernel(pixels: &[u16], hue: u16, tolerance: u16, words: &mut [u32]) {
    let (pixels, _) = pixels.as_chunks::<BITS_PER_WORD>();
    for (pixels, word) in pixels.iter().zip(words) {
        *word = (0..)
            .zip(pixels)
            .fold(0, |bits, (place, pixel)| bits | u32::from(matches(*pixel, hue, tolerance)) << place);
    }
}

wide! {
    /// Matches of each hypothesis, from the table.
    pub(super) fn count_rectified(view: &TableView<'_>, batch: &Batch, counts: &mut [i32; BATCH]) = count_rectified_kernel;
}

#[inline(always)]
fn count_rectified_kernel(view: &TableView<'_>, batch: &Batch, counts: &mut [i32; BATCH]) {
    /// Number of words per point of the usual table; its positions are masked instead of checked.
    const FEW: usize = 8;
    if view.words_per_point == FEW {
        let (tables, _) = view.words.as_chunks::<FEW>();
        count_in_tables(view, batch, tables.iter(), |table, word| table[word % FEW], counts);
    } else {
        let tables = view.words.chunks_exact(view.words_per_point);
        count_in_tables(view, batch, tables, |table, word| table[word], counts);
    }
}

#[inline(always)]
fn count_in_tables<Table: Copy>(
    view: &TableView<'_>,
    batch: &Batch,
    tables: impl Iterator<Item = Table> + Clone,
    word_at: impl Fn(Table, usize) -> u32,
    counts: &mut [i32; BATCH],
) {
    let (slopes_u, _) = batch.slope_u.as_chunks::<LANES>();
    let (slopes_v, _) = batch.slope_v.as_chunks::<LANES>();
    let (offsets, _) = batch.offset.as_chunks::<LANES>();
    let (counts, _) = counts.as_chunks_mut::<LANES>();
    let groups = slopes_u.iter().zip(slopes_v).zip(offsets).zip(counts).take(batch.len.div_ceil(LANES));
    for (((slope_u, slope_v), offset), counts) in groups {
        let mut sums = [0; LANES];
        let mut tables = tables.clone();
        let mut start = 0;
        for row in &view.points.rows {
            let base: [i32; LANES] = std::array::from_fn(|i| slope_v[i].wrapping_mul(row.dv).wrapping_add(offset[i]));
            for (du, table) in view.points.du[start..row.end].iter().zip(&mut tables) {
                // A shift outside the window, above or (as unsigned) below, maps to the bit that is always zero.
                let bits: [u32; LANES] = std::array::from_fn(|i| {
                    let shift = slope_u[i].wrapping_mul(*du).wrapping_add(base[i]) >> FRACTION_BITS;
                    shift.cast_unsigned().min(view.shifts)
                });
                for i in 0..LANES {
                    let word = word_at(table, bits[i] as usize / BITS_PER_WORD);
                    sums[i] += (word >> (bits[i] % BITS_PER_WORD as u32) & 1).cast_signed();
                }
            }
            start = row.end;
        }
        *counts = sums;
    }
}

wide! {
    /// Matches of one hypothesis, by homography.
    pub(super) fn count_general(view: &PlaneView<'_>, tolerance: u16, points: &PointSet, homography: &[f32; 8]) -> i32 = count_general_kernel;
}

/// 3 * 2^22: at this value adjacent floats differ by one, so adding it rounds to an integer, stored in the lowest bits.
const ROUNDER: f32 = 12_582_912.0;

/// The order of the operations is part of the definition: products before sums, left to right, no fused multiplication.
#[inline(always)]
fn count_general_kernel(view: &PlaneView<'_>, tolerance: u16, points: &PointSet, homography: &[f32; 8]) -> i32 {
    let [h00, h01, h02, h10, h11, h12, h20, h21] = *homography;
    let (width, height) = (view.width as f32, view.height as f32);
    let (du, _) = points.du_real.as_chunks::<CHUNK>();
    let (dv, _) = points.dv_real.as_chunks::<CHUNK>();
    let (hues, _) = points.hue.as_chunks::<CHUNK>();
    // A NaN is not inside either.
    let inside = |x: f32, size: f32| (x - ROUNDER >= 0.0) & (x - ROUNDER < size);
    let whole = |x: f32| (x.to_bits() & 0xFFFF).cast_signed();
    // A separate pass for each step, over many chunks: values written one by one are not read immediately as a vector.
    let (mut places, mut pixels) = ([[0; CHUNK]; BLOCK], [[0; CHUNK]; BLOCK]);
    let mut count = 0;
    for ((du, dv), hues) in du.chunks(BLOCK).zip(dv.chunks(BLOCK)).zip(hues.chunks(BLOCK)) {
        for ((du, dv), places) in du.iter().zip(dv).zip(&mut places) {
            for i in 0..CHUNK {
                let inverse = 1.0 / (h20 * du[i] + h21 * dv[i] + 1.0);
                let u = (h00 * du[i] + h01 * dv[i] + h02) * inverse + ROUNDER;
                let v = (h10 * du[i] + h11 * dv[i] + h12) * inverse + ROUNDER;
                let place = view.base + whole(v) * view.width + whole(u);
                places[i] = if inside(u, width) & inside(v, height) { place } else { 0 };
            }
        }
        for (pixels, places) in pixels.iter_mut().zip(&places).take(hues.len()) {
            for (pixel, place) in pixels.iter_mut().zip(places) {
                *pixel = view.data[*place as usize];
            }
        }
        for (pixels, hues) in pixels.iter().zip(hues) {
            let found: u16 = pixels.iter().zip(hues).map(|(pixel, hue)| matches(*pixel, *hue, tolerance)).sum();
            count += i32::from(found);
        }
    }
    count
}
