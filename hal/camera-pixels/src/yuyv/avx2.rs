//! 256-bit vectors: 32 pixels per step.

use std::arch::x86_64::*;

use super::{Coefficients, Equations, FRACTION_BITS, scalar};

/// Pixels per step.
const STEP: usize = 32;

/// Same as [`scalar::convert_row`].
#[target_feature(enable = "avx2")]
pub(super) fn convert_row(source: &[u8], target: &mut [u8], equations: &Equations) {
    let factors = Factors::of(&equations.coefficients);
    let (sources, source_rest) = source.as_chunks::<{ 2 * STEP }>();
    let (targets, _) = target.as_chunks_mut::<{ 3 * STEP }>();
    let steps = sources.len().min(targets.len());
    for (source, target) in sources.iter().zip(targets) {
        convert_step(source, target, &factors);
    }
    let source_rest = if steps < sources.len() { &source[2 * STEP * steps..] } else { source_rest };
    scalar::convert_row(source_rest, &mut target[3 * STEP * steps..], &equations.tables);
}

/// The coefficients in all elements; those of chroma for U in even elements and for V in odd ones.
struct Factors {
    black: __m256i,
    luma: __m256i,
    /// Blue of U, red of V.
    blue_red: __m256i,
    green: __m256i,
}

impl Factors {
    #[target_feature(enable = "avx2")]
    fn of(c: &Coefficients) -> Self {
        let pair = |even: i16, odd: i16| _mm256_set1_epi32(i32::from(odd) << 16 | i32::from(even as u16));
        Self {
            black: _mm256_set1_epi16(c.black),
            luma: _mm256_set1_epi16(c.luma),
            blue_red: pair(c.blue_of_u, c.red_of_v),
            green: pair(c.green_of_u, c.green_of_v),
        }
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn convert_step(source: &[u8; 2 * STEP], target: &mut [u8; 3 * STEP], factors: &Factors) {
    let pointer = source.as_ptr().cast::<__m256i>();
    // SAFETY: `source` holds two vectors of 32 bytes; unaligned loads.
    let (first, second) = unsafe { (_mm256_loadu_si256(pointer), _mm256_loadu_si256(pointer.add(1))) };
    // Packing works in each half of 128 bits: `low` holds pixels 0..8 and 16..24, `high` 8..16 and 24..32.
    let low = sums(_mm256_permute2x128_si256::<0x20>(first, second), factors);
    let high = sums(_mm256_permute2x128_si256::<0x31>(first, second), factors);
    let channels: [__m256i; 3] = std::array::from_fn(|k| _mm256_packus_epi16(low[k], high[k]));
    let pointer = target.as_mut_ptr();
    for (third, masks) in CHANNEL_SHUFFLES.iter().enumerate() {
        let [r, g, b]: [__m256i; 3] = std::array::from_fn(|k| {
            // SAFETY: each row of the table has 16 bytes; unaligned load.
            let mask = unsafe { _mm_loadu_si128(masks[k].as_ptr().cast()) };
            _mm256_shuffle_epi8(channels[k], _mm256_broadcastsi128_si256(mask))
        });
        let bytes = _mm256_or_si256(_mm256_or_si256(r, g), b);
        // SAFETY: `third` is 0, 1 or 2, so both stores of 16 bytes end within the 96 bytes; unaligned stores.
        unsafe {
            _mm_storeu_si128(pointer.add(16 * third).cast(), _mm256_castsi256_si128(bytes));
            _mm_storeu_si128(pointer.add(48 + 16 * third).cast(), _mm256_extracti128_si256::<1>(bytes));
        }
    }
}

/// Red, green and blue of 16 pixels, rounded but not yet limited to 0..=255.
#[inline]
#[target_feature(enable = "avx2")]
fn sums(yuyv: __m256i, factors: &Factors) -> [__m256i; 3] {
    let luma = _mm256_srli_epi16::<1>(_mm256_slli_epi16::<8>(yuyv));
    let luma = _mm256_mulhrs_epi16(_mm256_sub_epi16(luma, factors.black), factors.luma);
    let luma = _mm256_add_epi16(luma, _mm256_set1_epi16(1 << (FRACTION_BITS - 1)));
    // The upper bytes, alternately U and V, minus 128.
    let colour = _mm256_and_si256(yuyv, _mm256_set1_epi16(0xFF00_u16 as i16));
    let colour = _mm256_xor_si256(colour, _mm256_set1_epi16(0x8000_u16 as i16));
    let blue_red = _mm256_mulhrs_epi16(colour, factors.blue_red);
    let green = _mm256_mulhrs_epi16(colour, factors.green);
    let even = _mm256_set1_epi32(0xFFFF);
    let blue = _mm256_and_si256(blue_red, even);
    let blue = _mm256_or_si256(blue, _mm256_slli_epi32::<16>(blue));
    let red = _mm256_andnot_si256(even, blue_red);
    let red = _mm256_or_si256(red, _mm256_srli_epi32::<16>(red));
    let swapped = _mm256_or_si256(_mm256_slli_epi32::<16>(green), _mm256_srli_epi32::<16>(green));
    let green = _mm256_add_epi16(green, swapped);
    [red, green, blue].map(|colour| _mm256_srai_epi16::<FRACTION_BITS>(_mm256_add_epi16(luma, colour)))
}

/// Shuffle masks for each third of 48 interleaved bytes and each channel: index of one of its 16 pixels for each position, -1 for
/// none.
const CHANNEL_SHUFFLES: [[[i8; 16]; 3]; 3] = channel_shuffles();

const fn channel_shuffles() -> [[[i8; 16]; 3]; 3] {
    let mut table = [[[-1; 16]; 3]; 3];
    let mut byte = 0;
    while byte < 48 {
        table[byte / 16][byte % 3][byte % 16] = (byte / 3) as i8;
        byte += 1;
    }
    table
}
