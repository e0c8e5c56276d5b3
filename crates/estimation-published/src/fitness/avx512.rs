//! Kernels in 512-bit vectors. Same results as the portable ones.

use std::arch::x86_64::*;

use super::batch::{BATCH, Batch};
use super::general::{PlaneView, Scratch};
use super::points::{CHUNK, PointSet};
use super::rectified::{BITS_PER_WORD, FRACTION_BITS, TableView};

const FRACTION: u32 = FRACTION_BITS;
/// Hypotheses per vector.
const LANES: usize = 16;
/// Hypotheses that share a pass over the points: two vectors.
const GROUP: usize = 2 * LANES;

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn load_i32(values: &[i32; LANES]) -> __m512i {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm512_loadu_si512(values.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn load_u32(values: &[u32; LANES]) -> __m512i {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm512_loadu_si512(values.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn load_u16(values: &[u16; 32]) -> __m512i {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm512_loadu_si512(values.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn load_f32(values: &[f32; LANES]) -> __m512 {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm512_loadu_ps(values.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn store_i32(values: &mut [i32; LANES], vector: __m512i) {
    // SAFETY: the array holds one vector; unaligned store.
    unsafe { _mm512_storeu_si512(values.as_mut_ptr().cast(), vector) }
}

/// See [`super::scalar::compare`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn compare(pixels: &[u16], hue: u16, tolerance: u16, words: &mut [u32]) {
    let (pixels, _) = pixels.as_chunks::<BITS_PER_WORD>();
    let hue = _mm512_set1_epi16(hue.cast_signed());
    for (pixels, word) in pixels.iter().zip(words) {
        *word = match_bits(pixels, hue, tolerance);
    }
}

/// One bit for each of 32 pixels: has a hue within `tolerance` of its partner's.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn match_bits(pixels: &[u16; 32], hues: __m512i, tolerance: u16) -> u32 {
    let pixels = load_u16(pixels);
    let distance = _mm512_abs_epi16(_mm512_sub_epi16(pixels, hues));
    let valid = _mm512_test_epi16_mask(pixels, _mm512_set1_epi16(1));
    _mm512_mask_cmple_epu16_mask(valid, distance, _mm512_set1_epi16(tolerance.cast_signed()))
}

/// See [`super::scalar::count_rectified`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn count_rectified(view: &TableView<'_>, batch: &Batch, counts: &mut [i32; BATCH]) {
    for group in 0..batch.len.div_ceil(GROUP) {
        match view.words_per_point {
            8 => count_group::<0>(view, batch, group * GROUP, counts),
            LANES => count_group::<1>(view, batch, group * GROUP, counts),
            _ => count_group::<2>(view, batch, group * GROUP, counts),
        }
    }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn two_vectors(values: &[i32; BATCH], first: usize) -> [__m512i; 2] {
    let (vectors, _) = values.as_chunks::<LANES>();
    [load_i32(&vectors[first / LANES]), load_i32(&vectors[first / LANES + 1])]
}

/// `BLOCKS` is 0 for a table of half a vector, 1 for one vector, 2 for more.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn count_group<const BLOCKS: usize>(view: &TableView<'_>, batch: &Batch, first: usize, counts: &mut [i32; BATCH]) {
    let slope_u = two_vectors(&batch.slope_u, first);
    let slope_v = two_vectors(&batch.slope_v, first);
    let offset = two_vectors(&batch.offset, first);
    let limit = _mm512_set1_epi32(view.shifts.cast_signed());
    let mut sums = [_mm512_setzero_si512(); 2];
    let mut start = 0;
    for row in &view.points.rows {
        let dv = _mm512_set1_epi32(row.dv);
        let base = [0, 1].map(|k| _mm512_add_epi32(_mm512_mullo_epi32(slope_v[k], dv), offset[k]));
        let tables = view.words[start * view.words_per_point..].chunks_exact(view.words_per_point);
        for (du, table) in view.points.du[start..row.end].iter().zip(tables) {
            let du = _mm512_set1_epi32(*du);
            for k in 0..2 {
                let fixed = _mm512_add_epi32(_mm512_mullo_epi32(slope_u[k], du), base[k]);
                let bit = _mm512_min_epu32(_mm512_srai_epi32::<FRACTION>(fixed), limit);
                sums[k] = _mm512_add_epi32(sums[k], look_up::<BLOCKS>(table, bit));
            }
        }
        start = row.end;
    }
    let (vectors, _) = counts.as_chunks_mut::<LANES>();
    store_i32(&mut vectors[first / LANES], sums[0]);
    store_i32(&mut vectors[first / LANES + 1], sums[1]);
}

/// Bit `bit` of a point's table, as 0 or 1, for each of sixteen hypotheses.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn look_up<const BLOCKS: usize>(table: &[u32], bit: __m512i) -> __m512i {
    let index = _mm512_srli_epi32::<5>(bit);
    let word = match (BLOCKS, table.first_chunk::<8>()) {
        (0, Some(half)) => {
            // SAFETY: the array holds half a vector; unaligned load.
            let half = unsafe { _mm256_loadu_si256(half.as_ptr().cast()) };
            _mm512_permutexvar_epi32(index, _mm512_castsi256_si512(half))
        }
        _ => {
            let (blocks, _) = table.as_chunks::<LANES>();
            let mut word = _mm512_permutexvar_epi32(index, load_u32(&blocks[0]));
            if BLOCKS > 1 {
                let block_of = _mm512_srli_epi32::<4>(index);
                for (block, words) in (1..).zip(&blocks[1..]) {
                    let here = _mm512_cmpeq_epi32_mask(block_of, _mm512_set1_epi32(block));
                    word = _mm512_mask_permutexvar_epi32(word, here, index, load_u32(words));
                }
            }
            word
        }
    };
    let place = _mm512_and_si512(bit, _mm512_set1_epi32(31));
    _mm512_and_si512(_mm512_srlv_epi32(word, place), _mm512_set1_epi32(1))
}

/// See [`super::scalar::count_general`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn count_general(
    view: &PlaneView<'_>,
    tolerance: u16,
    points: &PointSet,
    homography: &[f32; 8],
    scratch: &mut Scratch,
) -> i32 {
    let h = homography.map(|x| _mm512_set1_ps(x));
    let mut count = 0;
    for (block, start) in points.blocks() {
        let (du, dv) = (block.du.as_chunks::<LANES>().0, block.dv.as_chunks::<LANES>().0);
        let (places, _) = scratch.places.as_chunks_mut::<LANES>();
        for ((du, dv), places) in du.iter().zip(dv).zip(places) {
            store_i32(places, addresses(view, &h, load_f32(du), load_f32(dv)));
        }
        // SAFETY: the loop above has written as many places as the block has points, all made by `addresses` for this view.
        unsafe { scratch.read(view, block.hue.len()) };
        let (hues, pixels) = (block.hue.as_chunks::<CHUNK>().0, scratch.pixels.as_chunks::<CHUNK>().0);
        for (index, (hues, pixels)) in hues.iter().zip(pixels).enumerate() {
            let bits = match_bits(pixels, load_u16(hues), tolerance);
            count += (bits & points.chunk_mask(start + index * CHUNK)).count_ones();
        }
    }
    count.cast_signed()
}

/// Address of the pixel that each of sixteen points falls on, 0 outside the image.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn addresses(view: &PlaneView<'_>, h: &[__m512; 8], du: __m512, dv: __m512) -> __m512i {
    let line =
        |a: __m512, b: __m512, c: __m512| _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(a, du), _mm512_mul_ps(b, dv)), c);
    let one = _mm512_set1_ps(1.0);
    let inverse = _mm512_div_ps(one, line(h[6], h[7], one));
    let u = _mm512_cvtps_epi32(_mm512_mul_ps(line(h[0], h[1], h[2]), inverse));
    let v = _mm512_cvtps_epi32(_mm512_mul_ps(line(h[3], h[4], h[5]), inverse));
    // A negative number is a large unsigned one.
    let inside = _mm512_cmplt_epu32_mask(u, _mm512_set1_epi32(view.width));
    let inside = _mm512_mask_cmplt_epu32_mask(inside, v, _mm512_set1_epi32(view.height));
    let row = _mm512_mullo_epi32(v, _mm512_set1_epi32(view.width));
    _mm512_maskz_add_epi32(inside, _mm512_add_epi32(row, u), _mm512_set1_epi32(view.base))
}
