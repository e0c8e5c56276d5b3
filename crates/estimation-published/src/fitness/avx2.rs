//! Kernels in 256-bit vectors. Same results as the portable ones.

use std::arch::x86_64::*;

use super::batch::{BATCH, Batch};
use super::general::{PlaneView, Scratch};
use super::points::{CHUNK, PointSet};
use super::rectified::{BITS_PER_WORD, FRACTION_BITS, TableView};

const FRACTION: i32 = FRACTION_BITS as i32;
/// Hypotheses per vector.
const LANES: usize = 8;
/// Hypotheses that share a pass over the points: two vectors.
const GROUP: usize = 2 * LANES;

#[inline]
#[target_feature(enable = "avx2")]
fn load_i32(values: &[i32; LANES]) -> __m256i {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm256_loadu_si256(values.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load_u32(values: &[u32; LANES]) -> __m256i {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm256_loadu_si256(values.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load_u16(values: &[u16; 16]) -> __m256i {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm256_loadu_si256(values.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load_f32(values: &[f32; LANES]) -> __m256 {
    // SAFETY: the array holds one vector; unaligned load.
    unsafe { _mm256_loadu_ps(values.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn store_i32(values: &mut [i32; LANES], vector: __m256i) {
    // SAFETY: the array holds one vector; unaligned store.
    unsafe { _mm256_storeu_si256(values.as_mut_ptr().cast(), vector) }
}

/// See [`super::scalar::compare`].
#[target_feature(enable = "avx2")]
pub(super) fn compare(pixels: &[u16], hue: u16, tolerance: u16, words: &mut [u32]) {
    let (pixels, _) = pixels.as_chunks::<BITS_PER_WORD>();
    let hue = _mm256_set1_epi16(hue.cast_signed());
    for (pixels, word) in pixels.iter().zip(words) {
        *word = match_bits(pixels, [hue, hue], tolerance);
    }
}

/// One bit for each of 32 pixels: has a hue within `tolerance` of its partner's.
#[inline]
#[target_feature(enable = "avx2")]
fn match_bits(pixels: &[u16; 32], hues: [__m256i; 2], tolerance: u16) -> u32 {
    let tolerance = _mm256_set1_epi16(tolerance.cast_signed());
    let (halves, _) = pixels.as_chunks::<16>();
    let half = |index: usize| {
        let pixels = load_u16(&halves[index]);
        let distance = _mm256_abs_epi16(_mm256_sub_epi16(pixels, hues[index]));
        let near = _mm256_cmpeq_epi16(_mm256_max_epu16(distance, tolerance), tolerance);
        let valid = _mm256_srai_epi16::<15>(_mm256_slli_epi16::<15>(pixels));
        _mm256_and_si256(near, valid)
    };
    // Packing works within 128-bit lanes: put the quarters back in order.
    let packed = _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi16(half(0), half(1)));
    _mm256_movemask_epi8(packed).cast_unsigned()
}

/// See [`super::scalar::count_rectified`].
#[target_feature(enable = "avx2")]
pub(super) fn count_rectified(view: &TableView<'_>, batch: &Batch, counts: &mut [i32; BATCH]) {
    for group in 0..batch.len.div_ceil(GROUP) {
        if view.words_per_point == LANES {
            count_group::<true>(view, batch, group * GROUP, counts);
        } else {
            count_group::<false>(view, batch, group * GROUP, counts);
        }
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn two_vectors(values: &[i32; BATCH], first: usize) -> [__m256i; 2] {
    let (vectors, _) = values.as_chunks::<LANES>();
    [load_i32(&vectors[first / LANES]), load_i32(&vectors[first / LANES + 1])]
}

#[inline]
#[target_feature(enable = "avx2")]
fn count_group<const ONE_BLOCK: bool>(view: &TableView<'_>, batch: &Batch, first: usize, counts: &mut [i32; BATCH]) {
    let slope_u = two_vectors(&batch.slope_u, first);
    let slope_v = two_vectors(&batch.slope_v, first);
    let offset = two_vectors(&batch.offset, first);
    let limit = _mm256_set1_epi32(view.shifts.cast_signed());
    let (blocks, _) = view.words.as_chunks::<LANES>();
    let blocks_per_point = view.words_per_point / LANES;
    let mut sums = [_mm256_setzero_si256(); 2];
    let mut start = 0;
    for row in &view.points.rows {
        let dv = _mm256_set1_epi32(row.dv);
        let base = [0, 1].map(|k| _mm256_add_epi32(_mm256_mullo_epi32(slope_v[k], dv), offset[k]));
        let tables = blocks[start * blocks_per_point..].chunks_exact(blocks_per_point);
        for (du, table) in view.points.du[start..row.end].iter().zip(tables) {
            let du = _mm256_set1_epi32(*du);
            for k in 0..2 {
                let fixed = _mm256_add_epi32(_mm256_mullo_epi32(slope_u[k], du), base[k]);
                let bit = _mm256_min_epu32(_mm256_srai_epi32::<FRACTION>(fixed), limit);
                sums[k] = _mm256_add_epi32(sums[k], look_up::<ONE_BLOCK>(table, bit));
            }
        }
        start = row.end;
    }
    let (vectors, _) = counts.as_chunks_mut::<LANES>();
    store_i32(&mut vectors[first / LANES], sums[0]);
    store_i32(&mut vectors[first / LANES + 1], sums[1]);
}

/// Bit `bit` of a point's table, as 0 or 1, for each of eight hypotheses.
#[inline]
#[target_feature(enable = "avx2")]
fn look_up<const ONE_BLOCK: bool>(table: &[[u32; LANES]], bit: __m256i) -> __m256i {
    let index = _mm256_srli_epi32::<5>(bit);
    let mut word = _mm256_permutevar8x32_epi32(load_u32(&table[0]), index);
    if !ONE_BLOCK {
        let block_of = _mm256_srli_epi32::<3>(index);
        for (block, words) in (1..).zip(&table[1..]) {
            let here = _mm256_cmpeq_epi32(block_of, _mm256_set1_epi32(block));
            word = _mm256_blendv_epi8(word, _mm256_permutevar8x32_epi32(load_u32(words), index), here);
        }
    }
    let place = _mm256_and_si256(bit, _mm256_set1_epi32(31));
    _mm256_and_si256(_mm256_srlv_epi32(word, place), _mm256_set1_epi32(1))
}

/// See [`super::scalar::count_general`].
#[target_feature(enable = "avx2")]
pub(super) fn count_general(
    view: &PlaneView<'_>,
    tolerance: u16,
    points: &PointSet,
    homography: &[f32; 8],
    scratch: &mut Scratch,
) -> i32 {
    let h = homography.map(|x| _mm256_set1_ps(x));
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
            let (halves, _) = hues.as_chunks::<16>();
            let bits = match_bits(pixels, [load_u16(&halves[0]), load_u16(&halves[1])], tolerance);
            count += (bits & points.chunk_mask(start + index * CHUNK)).count_ones();
        }
    }
    count.cast_signed()
}

/// Address of the pixel that each of eight points falls on, 0 outside the image.
#[inline]
#[target_feature(enable = "avx2")]
fn addresses(view: &PlaneView<'_>, h: &[__m256; 8], du: __m256, dv: __m256) -> __m256i {
    let line =
        |a: __m256, b: __m256, c: __m256| _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(a, du), _mm256_mul_ps(b, dv)), c);
    let one = _mm256_set1_ps(1.0);
    let inverse = _mm256_div_ps(one, line(h[6], h[7], one));
    let u = _mm256_cvtps_epi32(_mm256_mul_ps(line(h[0], h[1], h[2]), inverse));
    let v = _mm256_cvtps_epi32(_mm256_mul_ps(line(h[3], h[4], h[5]), inverse));
    // A negative number is a large unsigned one: clamping changes whatever is outside.
    let inside = |x: __m256i, size: i32| _mm256_cmpeq_epi32(_mm256_min_epu32(x, _mm256_set1_epi32(size - 1)), x);
    let row = _mm256_mullo_epi32(v, _mm256_set1_epi32(view.width));
    let address = _mm256_add_epi32(_mm256_add_epi32(row, u), _mm256_set1_epi32(view.base));
    _mm256_and_si256(address, _mm256_and_si256(inside(u, view.width), inside(v, view.height)))
}
