//! Hue conversion in 256-bit vectors: 32 pixels per step.

use std::arch::x86_64::*;

use super::Gate;
use super::scalar::{self, STEPS_PER_SECTOR};

/// Pixels per step.
const STEP: usize = 32;

/// Same as [`scalar::convert`].
#[target_feature(enable = "avx2")]
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
#[target_feature(enable = "avx2")]
fn convert_step(source: &[u8; 3 * STEP], gate: Gate, target: &mut [u16; STEP]) {
    let [r, g, b] = split_channels(source);
    let zero = _mm256_setzero_si256();
    // Unpacking stays within 128-bit lanes: `low` holds pixels 0..8 and 16..24, `high` 8..16 and 24..32.
    let low = hues([_mm256_unpacklo_epi8(r, zero), _mm256_unpacklo_epi8(g, zero), _mm256_unpacklo_epi8(b, zero)], gate);
    let high =
        hues([_mm256_unpackhi_epi8(r, zero), _mm256_unpackhi_epi8(g, zero), _mm256_unpackhi_epi8(b, zero)], gate);
    let pointer = target.as_mut_ptr().cast::<__m256i>();
    // SAFETY: `target` holds two vectors of 16 elements; unaligned stores.
    unsafe {
        _mm256_storeu_si256(pointer, _mm256_permute2x128_si256::<0x20>(low, high));
        _mm256_storeu_si256(pointer.add(1), _mm256_permute2x128_si256::<0x31>(low, high));
    }
}

/// Red, green and blue of 32 pixels: pixel 16 l + k in byte k of lane l.
#[inline]
#[target_feature(enable = "avx2")]
fn split_channels(source: &[u8; 3 * STEP]) -> [__m256i; 3] {
    let load = |offset: usize| {
        let pointer = source.as_ptr();
        debug_assert!(offset + 48 + 16 <= source.len());
        // SAFETY: `offset` is 0, 16 or 32, so both 16-byte loads end within the 96 bytes; unaligned loads.
        unsafe {
            let low = _mm_loadu_si128(pointer.add(offset).cast());
            let high = _mm_loadu_si128(pointer.add(offset + 48).cast());
            _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(low), high)
        }
    };
    let thirds = [load(0), load(16), load(32)];
    std::array::from_fn(|channel| {
        let [a, b, c] = CHANNEL_SHUFFLES[channel];
        // SAFETY: each table row has 16 bytes; unaligned loads.
        let [a, b, c] =
            unsafe { [a, b, c].map(|row: [i8; 16]| _mm256_broadcastsi128_si256(_mm_loadu_si128(row.as_ptr().cast()))) };
        _mm256_or_si256(
            _mm256_or_si256(_mm256_shuffle_epi8(thirds[0], a), _mm256_shuffle_epi8(thirds[1], b)),
            _mm256_shuffle_epi8(thirds[2], c),
        )
    })
}

/// For each channel and each third of 48 interleaved bytes: the byte that goes to each of the 16 places, -1 for none.
pub(super) const CHANNEL_SHUFFLES: [[[i8; 16]; 3]; 3] = channel_shuffles();

const fn channel_shuffles() -> [[[i8; 16]; 3]; 3] {
    let mut table = [[[-1; 16]; 3]; 3];
    let mut channel = 0;
    while channel < 3 {
        let mut pixel = 0;
        while pixel < 16 {
            let byte = 3 * pixel + channel;
            table[channel][byte / 16][pixel] = (byte % 16) as i8;
            pixel += 1;
        }
        channel += 1;
    }
    table
}

/// Stored hues of 16 pixels, channels in 16-bit elements.
#[inline]
#[target_feature(enable = "avx2")]
fn hues([r, g, b]: [__m256i; 3], gate: Gate) -> __m256i {
    let max = _mm256_max_epi16(_mm256_max_epi16(r, g), b);
    let delta = _mm256_sub_epi16(max, _mm256_min_epi16(_mm256_min_epi16(r, g), b));
    let twice = _mm256_slli_epi16::<1>(delta);
    let in_red = _mm256_sub_epi16(g, b);
    let in_green = _mm256_add_epi16(_mm256_sub_epi16(b, r), twice);
    let in_blue = _mm256_add_epi16(_mm256_sub_epi16(r, g), _mm256_slli_epi16::<2>(delta));
    let green_or_blue = _mm256_blendv_epi8(in_blue, in_green, _mm256_cmpeq_epi16(max, g));
    let sixths = _mm256_blendv_epi8(green_or_blue, in_red, _mm256_cmpeq_epi16(max, r));
    let steps = steps_from_sixths(sixths, delta);
    let stored = _mm256_or_si256(_mm256_slli_epi16::<1>(steps), _mm256_set1_epi16(1));
    _mm256_and_si256(stored, passes(max, delta, gate))
}

/// `sixths / delta` sixths of a turn in steps of 1/32768 turn.
#[inline]
#[target_feature(enable = "avx2")]
fn steps_from_sixths(sixths: __m256i, delta: __m256i) -> __m256i {
    let delta = _mm256_max_epi16(delta, _mm256_set1_epi16(1));
    let quotient = |numerator: __m256i, denominator: __m256i| {
        let ratio = _mm256_div_ps(_mm256_cvtepi32_ps(numerator), _mm256_cvtepi32_ps(denominator));
        _mm256_cvtps_epi32(_mm256_mul_ps(ratio, _mm256_set1_ps(STEPS_PER_SECTOR)))
    };
    let zero = _mm256_setzero_si256();
    let low =
        quotient(_mm256_srai_epi32::<16>(_mm256_unpacklo_epi16(zero, sixths)), _mm256_unpacklo_epi16(delta, zero));
    let high =
        quotient(_mm256_srai_epi32::<16>(_mm256_unpackhi_epi16(zero, sixths)), _mm256_unpackhi_epi16(delta, zero));
    _mm256_packs_epi32(low, high)
}

/// All ones where a pixel has a hue.
#[inline]
#[target_feature(enable = "avx2")]
fn passes(max: __m256i, delta: __m256i, gate: Gate) -> __m256i {
    let chroma = _mm256_slli_epi16::<8>(delta);
    let needed = _mm256_mullo_epi16(max, _mm256_set1_epi16(gate.saturation_min.cast_signed()));
    let saturated = _mm256_cmpeq_epi16(_mm256_max_epu16(chroma, needed), chroma);
    let bright = _mm256_cmpgt_epi16(max, _mm256_set1_epi16(gate.value_min.cast_signed() - 1));
    let coloured = _mm256_cmpgt_epi16(delta, _mm256_setzero_si256());
    _mm256_and_si256(_mm256_and_si256(saturated, bright), coloured)
}
