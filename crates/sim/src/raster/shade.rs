//! Colours of surface points: filtered texture times light.
//!
//! A texture is sampled from two neighbouring mip-map levels at once: eight texels whose weights sum to 4096. The three channels
//! of a texel are packed into one integer, so one multiplication weights all of them.

use super::triangle::{Plane, ScreenTriangle};
use crate::targets::texture::{LANE_BITS, Level, Texture};

/// Maximum number of pixels shaded in one run.
pub(crate) const RUN_MAX: usize = 64;

/// Adding this to a number leaves the number, rounded to 1, in the low bits of the sum.
const ROUNDING: f32 = 12_582_912.0;

/// Sum of the weights of all texels.
const WEIGHT_ONE: u32 = 4096;

/// Light of 1 in fixed point.
const LIGHT_ONE: f32 = 4096.0;

/// The texture levels used along a run of pixels.
struct Copies<'a> {
    fine: &'a Level,
    coarse: &'a Level,
    fine_shift: u32,
    /// Weight of the coarse level, of [`WEIGHT_ONE`].
    coarse_weight: u32,
}

/// Working memory of [`shade_run`], reused so that short runs need not clear it.
pub(crate) struct Scratch {
    u: [i32; RUN_MAX],
    v: [i32; RUN_MAX],
    light: [i32; RUN_MAX],
    colours: [u64; RUN_MAX],
    /// Four texels per pixel and their weights.
    index: [[u32; 4]; RUN_MAX],
    weight: [[u32; 4]; RUN_MAX],
}

impl Scratch {
    pub(crate) fn new() -> Self {
        Self {
            u: [0; RUN_MAX],
            v: [0; RUN_MAX],
            light: [0; RUN_MAX],
            colours: [0; RUN_MAX],
            index: [[0; 4]; RUN_MAX],
            weight: [[0; 4]; RUN_MAX],
        }
    }
}

/// Shades at most [`RUN_MAX`] pixels with the given rays, all of which see `triangle`.
///
/// Writes red, green and blue in 256ths of a grey level.
#[inline(always)]
pub(crate) fn shade_run(
    triangle: &ScreenTriangle,
    texture: &Texture,
    pixel_size: [f32; 2],
    rays: (&[f32], &[f32]),
    scratch: &mut Scratch,
    out: &mut [u16],
) {
    let n = rays.0.len().min(RUN_MAX);
    for i in 0..n {
        let (x, y) = (rays.0[i], rays.1[i]);
        let z = 1.0 / triangle.inv_z.at(x, y);
        scratch.u[i] = fixed(triangle.u.at(x, y) * z * 256.0);
        scratch.v[i] = fixed(triangle.v.at(x, y) * z * 256.0);
        scratch.light[i] = fixed((triangle.light.at(x, y) * z * LIGHT_ONE).clamp(0.0, 15.0 * LIGHT_ONE));
    }
    let copies = Copies::choose(triangle, texture, pixel_size, rays.0[n / 2], rays.1[n / 2]);
    scratch.colours[..n].fill(0);
    add_copy(copies.fine, copies.fine_shift, WEIGHT_ONE - copies.coarse_weight, n, scratch);
    if copies.coarse_weight > 0 {
        add_copy(copies.coarse, copies.fine_shift + 1, copies.coarse_weight, n, scratch);
    }
    for ((pixel, &colour), &light) in out.chunks_exact_mut(3).zip(&scratch.colours[..n]).zip(&scratch.light[..n]) {
        for (lane, channel) in (0u32..).zip(pixel) {
            // 255 * 4096 in the lane, halved and quartered to 16 bits, times a light of at most 15.
            let albedo = ((colour >> (lane * LANE_BITS + 4)) & 0xffff) as u32;
            *channel = ((albedo * light as u32) >> 12).min(0xffff) as u16;
        }
    }
    if let Some(shine) = &triangle.shine {
        add_shine(shine, triangle, rays, out);
    }
}

/// Adds the specular reflection of the lamp to every channel.
#[inline(always)]
fn add_shine(shine: &Plane, triangle: &ScreenTriangle, rays: (&[f32], &[f32]), out: &mut [u16]) {
    for ((pixel, &x), &y) in out.chunks_exact_mut(3).zip(rays.0).zip(rays.1) {
        let added = (shine.at(x, y) / triangle.inv_z.at(x, y) * 256.0).clamp(0.0, 65_535.0) as u16;
        for channel in pixel {
            *channel = channel.saturating_add(added);
        }
    }
}

/// Rounds to the nearest whole number; exact between -4 and 4 million.
#[inline(always)]
fn fixed(value: f32) -> i32 {
    (value + ROUNDING).to_bits() as i32 - ROUNDING.to_bits() as i32
}

impl<'a> Copies<'a> {
    /// The levels whose texels have about the size of a pixel at the ray `(x, y)`.
    fn choose(triangle: &ScreenTriangle, texture: &'a Texture, pixel_size: [f32; 2], x: f32, y: f32) -> Self {
        let z = 1.0 / triangle.inv_z.at(x, y);
        let (u, v) = (triangle.u.at(x, y) * z, triangle.v.at(x, y) * z);
        let texels_per_pixel = [
            (triangle.u.a - u * triangle.inv_z.a) * z * pixel_size[0],
            (triangle.u.b - u * triangle.inv_z.b) * z * pixel_size[1],
            (triangle.v.a - v * triangle.inv_z.a) * z * pixel_size[0],
            (triangle.v.b - v * triangle.inv_z.b) * z * pixel_size[1],
        ];
        let square = texels_per_pixel.iter().map(|d| d * d).sum::<f32>() * 0.5;
        let levels = texture.levels();
        let last = levels.len() as i32 - 1;
        // Half a level finer than one texel per pixel: the pixel area and the lens blur add to it.
        let level = ((log2_in_256ths(square) - 256) / 2).clamp(0, last * 256);
        let fine = level >> 8;
        Self {
            fine: &levels[fine as usize],
            coarse: &levels[(fine + 1).min(last) as usize],
            fine_shift: fine as u32,
            coarse_weight: (level & 0xff) as u32 * (WEIGHT_ONE / 256),
        }
    }
}

/// Adds the bilinear mixture of one copy's texels, times `weight`, to the first `n` colours.
#[inline(always)]
fn add_copy(level: &Level, shift: u32, weight: u32, n: usize, scratch: &mut Scratch) {
    let (mask_u, mask_v) = ((1u32 << level.width_log2) - 1, (1u32 << level.height_log2) - 1);
    for i in 0..n {
        // Texel centres lie at halves, so half a texel is subtracted.
        let (u, v) = (shift_rounded(scratch.u[i], shift) - 128, shift_rounded(scratch.v[i], shift) - 128);
        let (fu, fv) = ((u & 0xff) as u32, (v & 0xff) as u32);
        let (u0, v0) = ((u >> 8) as u32, (v >> 8) as u32);
        let (left, right) = (u0 & mask_u, u0.wrapping_add(1) & mask_u);
        let (up, down) = ((v0 & mask_v) << level.width_log2, (v0.wrapping_add(1) & mask_v) << level.width_log2);
        scratch.index[i] = [up | left, up | right, down | left, down | right];
        let (right, down) = ((fu * weight + 128) >> 8, (fv * weight + 128) >> 8);
        let both = (fu * down + 128) >> 8;
        scratch.weight[i] = [weight + both - right - down, right - both, down - both, both];
    }
    let texels = level.texels.as_slice();
    let taps = scratch.index[..n].iter().zip(&scratch.weight[..n]);
    for (colour, (index, weight)) in scratch.colours.iter_mut().zip(taps) {
        for (&index, &weight) in index.iter().zip(weight) {
            *colour += texels[index as usize] * u64::from(weight);
        }
    }
}

#[inline(always)]
fn shift_rounded(value: i32, shift: u32) -> i32 {
    (value + ((1 << shift) >> 1)) >> shift
}

/// Logarithm to base 2 in 256ths, linear between powers of two; -32768 for zero.
fn log2_in_256ths(value: f32) -> i32 {
    if value <= 0.0 {
        return -32768;
    }
    (value.to_bits() >> 15) as i32 - (127 << 8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_is_exact_at_powers_of_two_and_rises_between() {
        assert_eq!(log2_in_256ths(1.0), 0);
        assert_eq!(log2_in_256ths(8.0), 768);
        assert_eq!(log2_in_256ths(0.25), -512);
        assert_eq!(log2_in_256ths(3.0), 256 + 128);
    }

    #[test]
    fn rounding_by_addition_equals_round() {
        for value in [-3000.7f32, -0.4, 0.0, 0.3, 1.6, 262_143.4] {
            assert_eq!(fixed(value), value.round() as i32);
        }
    }

    fn read(level: &Level, shift: u32, weight: u32, u: f64, v: f64) -> [f64; 3] {
        let mut scratch = Scratch::new();
        (scratch.u[0], scratch.v[0]) = ((u * 256.0).round() as i32, (v * 256.0).round() as i32);
        add_copy(level, shift, weight, 1, &mut scratch);
        [0, 1, 2].map(|lane| ((scratch.colours[0] >> (lane * LANE_BITS)) & 0x1f_ffff) as f64 / 4096.0)
    }

    #[test]
    fn ramps_are_reproduced_from_every_copy() {
        let texture = Texture::from_fn(6, 6, |u, v| [255.0 * u, 255.0 * v, 100.0]);
        for (shift, level) in (0..).zip(texture.levels()).take(3) {
            for (u, v) in [(20.0, 31.3), (33.37, 12.9), (40.5, 40.5)] {
                let [red, green, blue] = read(level, shift, WEIGHT_ONE, u, v);
                assert!((red - 255.0 * u / 64.0).abs() < 0.6, "copy {shift}: {red} at {u}");
                assert!((green - 255.0 * v / 64.0).abs() < 0.6, "copy {shift}: {green} at {v}");
                assert_eq!(blue, 100.0);
            }
        }
    }

    #[test]
    fn weights_sum_exactly_for_every_place_and_share() {
        let texture = Texture::from_fn(3, 2, |_, _| [255.0, 17.0, 99.0]);
        let level = &texture.levels()[0];
        for (weight, u, v) in [(4096, 0.0, 0.0), (16, 0.99, 2.7), (4080, -3.3, 900.5), (1234, 7.498, -0.002)] {
            let share = f64::from(weight) / 4096.0;
            assert_eq!(read(level, 0, weight, u, v), [255.0, 17.0, 99.0].map(|channel| channel * share));
        }
    }
}
