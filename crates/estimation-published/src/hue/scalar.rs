//! Portable hue conversion: the definition that the vector kernels reproduce bit for bit.

use super::Gate;

/// Steps of 1/32768 turn in a sixth of a turn.
pub(super) const STEPS_PER_SECTOR: f32 = 32768.0 / 6.0;

/// 3 * 2^22.
const ROUNDER: f32 = 12_582_912.0;

/// Converts pixel by pixel.
pub(super) fn convert(rgb: &[u8], gate: Gate, out: &mut [u16]) {
    for (pixel, hue) in rgb.chunks_exact(3).zip(out) {
        *hue = stored_hue(pixel[0], pixel[1], pixel[2], gate);
    }
}

/// Angle in the upper 15 bits and the validity bit, or 0 for a pixel without hue.
///
/// The sector is that of the largest channel, red before green before blue where they are equal. One IEEE division and one
/// multiplication in single precision, rounded to the nearest even integer, so that every kernel gives the same bits.
#[inline]
fn stored_hue(r: u8, g: u8, b: u8, gate: Gate) -> u16 {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    let max = r.max(g).max(b);
    let delta = max - r.min(g).min(b);
    let saturated = delta << 8 >= i32::from(gate.saturation_min) * max;
    if delta == 0 || !saturated || max < i32::from(gate.value_min) {
        return 0;
    }
    let sixths = if max == r {
        g - b
    } else if max == g {
        b - r + 2 * delta
    } else {
        r - g + 4 * delta
    };
    // At most 27307 in magnitude: adding and subtracting 3 * 2^22, where neighbouring numbers are one apart, rounds it.
    let steps = ((sixths as f32 / delta as f32 * STEPS_PER_SECTOR + ROUNDER) - ROUNDER) as i32;
    ((steps << 1) as u16) | 1
}
