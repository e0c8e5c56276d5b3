//! Hue conversion in 512-bit vectors: 64 pixels per step.

use std::arch::x86_64::*;

use super::Gate;
use super::avx2::CHANNEL_SHUFFLES;
use super::scalar::{self, STEPS_PER_SECTOR};

/// Pixels per step.
const STEP: usize = 64;

/// Same as [`scalar::convert`].
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn convert(rgb: &[u8], gate: Gate, out: &mut [u16]) {
    let pixels = out.len().min(rgb.len() / 3);
    let whole = pixels / STEP * STEP;
    for start in (0..whole).step_by(STEP) {
        let source: &[u8; 3 * STEP] = match rgb[3 * start..].first_chunk() {
            Some(source) => source,
            None => break,
        };
        let target: &mut [u16; STEP] = match out[start..].first_chunk_mut() {
            Some(target) => target,
            None => break,
        };
        convert_step(source, gate, target);
    }
    scalar::convert(&rgb[3 * whole..3 * pixels], gate, &mut out[whole..pixels]);
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn convert_step(source: &[u8; 3 * STEP], gate: Gate, target: &mut [u16; STEP]) {
    let [r, g, b] = split_channels(source);
    let zero = _mm512_setzero_si512();
    // Unpacking stays within 128-bit lanes: lane l of `low` holds pixels 16 l to 16 l + 7, of `high` the next eight.
    let low = hues([_mm512_unpacklo_epi8(r, zero), _mm512_unpacklo_epi8(g, zero), _mm512_unpacklo_epi8(b, zero)], gate);
    let high =
        hues([_mm512_unpackhi_epi8(r, zero), _mm512_unpackhi_epi8(g, zero), _mm512_unpackhi_epi8(b, zero)], gate);
    let first = _mm512_permutex2var_epi64(low, _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), high);
    let second = _mm512_permutex2var_epi64(low, _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15), high);
    let pointer = target.as_mut_ptr().cast::<__m512i>();
    // SAFETY: `target` holds two vectors of 32 elements; unaligned stores.
    unsafe {
        _mm512_storeu_si512(pointer, first);
        _mm512_storeu_si512(pointer.add(1), second);
    }
}

/// Red, green and blue of 64 pixels: pixel 16 l + k in byte k of lane l.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn split_channels(source: &[u8; 3 * STEP]) -> [__m512i; 3] {
    let load = |offset: usize| {
        let pointer = source.as_ptr();
        debug_assert!(offset + 144 + 16 <= source.len());
        // SAFETY: `offset` is 0, 16 or 32, so the last of the 16-byte loads ends within the 192 bytes; unaligned loads.
        unsafe {
            let lane = |l: usize| _mm_loadu_si128(pointer.add(offset + 48 * l).cast());
            let all = _mm512_castsi128_si512(lane(0));
            let all = _mm512_inserti32x4::<1>(all, lane(1));
            let all = _mm512_inserti32x4::<2>(all, lane(2));
            _mm512_inserti32x4::<3>(all, lane(3))
        }
    };
    let thirds = [load(0), load(16), load(32)];
    std::array::from_fn(|channel| {
        let [a, b, c] = CHANNEL_SHUFFLES[channel];
        // SAFETY: each table row has 16 bytes; unaligned loads.
        let [a, b, c] =
            unsafe { [a, b, c].map(|row: [i8; 16]| _mm512_broadcast_i32x4(_mm_loadu_si128(row.as_ptr().cast()))) };
        _mm512_or_si512(
            _mm512_or_si512(_mm512_shuffle_epi8(thirds[0], a), _mm512_shuffle_epi8(thirds[1], b)),
            _mm512_shuffle_epi8(thirds[2], c),
        )
    })
}

/// Stored hues of 32 pixels, channels in 16-bit elements.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn hues([r, g, b]: [__m512i; 3], gate: Gate) -> __m512i {
    let max = _mm512_max_epi16(_mm512_max_epi16(r, g), b);
    let delta = _mm512_sub_epi16(max, _mm512_min_epi16(_mm512_min_epi16(r, g), b));
    let in_red = _mm512_sub_epi16(g, b);
    let in_green = _mm512_add_epi16(_mm512_sub_epi16(b, r), _mm512_slli_epi16::<1>(delta));
    let in_blue = _mm512_add_epi16(_mm512_sub_epi16(r, g), _mm512_slli_epi16::<2>(delta));
    let green_or_blue = _mm512_mask_blend_epi16(_mm512_cmpeq_epi16_mask(max, g), in_blue, in_green);
    let sixths = _mm512_mask_blend_epi16(_mm512_cmpeq_epi16_mask(max, r), green_or_blue, in_red);
    let steps = steps_from_sixths(sixths, delta);
    let stored = _mm512_or_si512(_mm512_slli_epi16::<1>(steps), _mm512_set1_epi16(1));
    _mm512_maskz_mov_epi16(passes(max, delta, gate), stored)
}

/// `sixths / delta` sixths of a turn in steps of 1/32768 turn.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn steps_from_sixths(sixths: __m512i, delta: __m512i) -> __m512i {
    let delta = _mm512_max_epi16(delta, _mm512_set1_epi16(1));
    let quotient = |numerator: __m512i, denominator: __m512i| {
        let ratio = _mm512_div_ps(_mm512_cvtepi32_ps(numerator), _mm512_cvtepi32_ps(denominator));
        _mm512_cvtps_epi32(_mm512_mul_ps(ratio, _mm512_set1_ps(STEPS_PER_SECTOR)))
    };
    let zero = _mm512_setzero_si512();
    let low =
        quotient(_mm512_srai_epi32::<16>(_mm512_unpacklo_epi16(zero, sixths)), _mm512_unpacklo_epi16(delta, zero));
    let high =
        quotient(_mm512_srai_epi32::<16>(_mm512_unpackhi_epi16(zero, sixths)), _mm512_unpackhi_epi16(delta, zero));
    _mm512_packs_epi32(low, high)
}

/// Which pixels have a hue.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn passes(max: __m512i, delta: __m512i, gate: Gate) -> __mmask32 {
    let needed = _mm512_mullo_epi16(max, _mm512_set1_epi16(gate.saturation_min.cast_signed()));
    let saturated = _mm512_cmpge_epu16_mask(_mm512_slli_epi16::<8>(delta), needed);
    let bright = _mm512_cmpge_epi16_mask(max, _mm512_set1_epi16(gate.value_min.cast_signed()));
    saturated & bright & _mm512_test_epi16_mask(delta, delta)
}
