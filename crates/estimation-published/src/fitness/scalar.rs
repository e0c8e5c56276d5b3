//! Portable kernels: the definition that the vector kernels reproduce bit for bit.

use super::batch::{BATCH, Batch};
use super::general::PlaneView;
use super::points::PointSet;
use super::rectified::{BITS_PER_WORD, FRACTION_BITS, TableView};

/// Whether a stored pixel has a hue within `tolerance` of a stored hue.
#[inline]
fn matches(pixel: u16, hue: u16, tolerance: u16) -> bool {
    pixel & 1 == 1 && pixel.wrapping_sub(hue).cast_signed().unsigned_abs() <= tolerance
}

/// One bit per pixel, 32 pixels per word.
pub(super) fn compare(pixels: &[u16], hue: u16, tolerance: u16, words: &mut [u32]) {
    for (pixels, word) in pixels.chunks_exact(BITS_PER_WORD).zip(words) {
        *word = pixels.iter().rev().fold(0, |bits, pixel| bits << 1 | u32::from(matches(*pixel, hue, tolerance)));
    }
}

/// Matches of each hypothesis, by table.
pub(super) fn count_rectified(view: &TableView<'_>, batch: &Batch, counts: &mut [i32; BATCH]) {
    for (lane, total) in counts.iter_mut().enumerate().take(batch.len) {
        let (slope_u, slope_v, offset) = (batch.slope_u[lane], batch.slope_v[lane], batch.offset[lane]);
        let mut count = 0;
        let mut start = 0;
        for row in &view.points.rows {
            let base = slope_v.wrapping_mul(row.dv).wrapping_add(offset);
            let words = view.words[start * view.words_per_point..].chunks_exact(view.words_per_point);
            for (du, words) in view.points.du[start..row.end].iter().zip(words) {
                let shift = slope_u.wrapping_mul(*du).wrapping_add(base) >> FRACTION_BITS;
                // A shift outside the window, above or (as unsigned) below, takes the bit that is always zero.
                let bit = shift.cast_unsigned().min(view.shifts) as usize;
                count += (words[bit / BITS_PER_WORD] >> (bit % BITS_PER_WORD) & 1) as i32;
            }
            start = row.end;
        }
        *total = count;
    }
}

/// Matches of one hypothesis, by homography.
///
/// The order of the operations is part of the definition: products before sums, left to right, no fused multiplication.
pub(super) fn count_general(view: &PlaneView<'_>, tolerance: u16, points: &PointSet, homography: &[f32; 8]) -> i32 {
    let [h00, h01, h02, h10, h11, h12, h20, h21] = *homography;
    let mut count = 0;
    for ((du, dv), hue) in points.du_real.iter().zip(&points.dv_real).zip(&points.hue).take(points.len()) {
        let inverse = 1.0 / (h20 * du + h21 * dv + 1.0);
        let u = round_to_i32((h00 * du + h01 * dv + h02) * inverse);
        let v = round_to_i32((h10 * du + h11 * dv + h12) * inverse);
        if (0..view.width).contains(&u) && (0..view.height).contains(&v) {
            let pixel = view.data[(view.base + v * view.width + u) as usize];
            count += i32::from(matches(pixel, *hue, tolerance));
        }
    }
    count
}

/// Nearest integer, ties to even, of a pixel coordinate; the lowest integer for what is far outside every image or not a
/// number. (Adding and subtracting 3 * 2^22 rounds: there, neighbouring numbers are one apart.)
#[inline]
fn round_to_i32(x: f32) -> i32 {
    const ROUNDER: f32 = 12_582_912.0;
    if x.abs() < 4_194_304.0 { ((x + ROUNDER) - ROUNDER) as i32 } else { i32::MIN }
}
