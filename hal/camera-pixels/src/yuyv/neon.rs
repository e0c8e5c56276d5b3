//! 128-bit vectors of AArch64: 16 pixels per step.

use std::arch::aarch64::*;

use super::{Coefficients, Equations, FRACTION_BITS, scalar};

/// Pixels per step.
const STEP: usize = 16;

/// Same as [`scalar::convert_row`].
#[target_feature(enable = "neon")]
pub(super) fn convert_row(source: &[u8], target: &mut [u8], equations: &Equations) {
    let (sources, source_rest) = source.as_chunks::<{ 2 * STEP }>();
    let (targets, _) = target.as_chunks_mut::<{ 3 * STEP }>();
    let steps = sources.len().min(targets.len());
    for (source, target) in sources.iter().zip(targets) {
        convert_step(source, target, &equations.coefficients);
    }
    let source_rest = if steps < sources.len() { &source[2 * STEP * steps..] } else { source_rest };
    scalar::convert_row(source_rest, &mut target[3 * STEP * steps..], &equations.tables);
}

#[inline]
#[target_feature(enable = "neon")]
fn convert_step(source: &[u8; 2 * STEP], target: &mut [u8; 3 * STEP], c: &Coefficients) {
    // SAFETY: `source` has 32 bytes. Even pixels, U, odd pixels and V, eight of each.
    let uint8x8x4_t(even, u, odd, v) = unsafe { vld4_u8(source.as_ptr()) };
    let of_colour = |colour: uint8x8_t| {
        let moved = vsub_u8(colour, vdup_n_u8(128));
        vreinterpretq_s16_u16(vshll_n_u8_high_byte(moved))
    };
    let (u, v) = (of_colour(u), of_colour(v));
    let colours = [
        vqrdmulhq_n_s16(v, c.red_of_v),
        vaddq_s16(vqrdmulhq_n_s16(u, c.green_of_u), vqrdmulhq_n_s16(v, c.green_of_v)),
        vqrdmulhq_n_s16(u, c.blue_of_u),
    ];
    let channels = colours.map(|colour| {
        let [even, odd] = [even, odd].map(|luma| {
            let luma = vreinterpretq_s16_u16(vshll_n_u8::<7>(luma));
            let luma = vqrdmulhq_n_s16(vsubq_s16(luma, vdupq_n_s16(c.black)), c.luma);
            // Rounds, shifts and limits to 0..=255.
            vqrshrun_n_s16::<FRACTION_BITS>(vaddq_s16(luma, colour))
        });
        let uint8x8x2_t(first, second) = vzip_u8(even, odd);
        vcombine_u8(first, second)
    });
    // SAFETY: `target` has 48 bytes.
    unsafe { vst3q_u8(target.as_mut_ptr(), uint8x16x3_t(channels[0], channels[1], channels[2])) };
}

/// Each byte times 256.
#[inline]
#[target_feature(enable = "neon")]
fn vshll_n_u8_high_byte(bytes: uint8x8_t) -> uint16x8_t {
    vshlq_n_u16::<8>(vmovl_u8(bytes))
}
