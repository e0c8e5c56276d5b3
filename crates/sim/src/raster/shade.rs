//! Colours of surface points: filtered texture times light.

use super::triangle::ScreenTriangle;
use crate::targets::texture::{Level, Texture};

/// Pixels shaded in one go.
pub(crate) const RUN_MAX: usize = 64;

/// Adding this to a number leaves the number, rounded to 1, in the low bits of the sum.
const ROUNDING: f32 = 12_582_912.0;

/// Every second 16-bit lane of a texel.
const EVEN_LANES: u64 = 0x0000_ffff_0000_ffff;

/// Light of 1 in fixed point.
const LIGHT_ONE: f32 = 4096.0;

/// How a texture is read along a run of pixels: two neighbouring copies and their mixture.
struct Sampler<'a> {
    fine: &'a Level,
    coarse: &'a Level,
    fine_shift: u32,
    /// Share of the coarse copy, in 256ths.
    coarse_share: u32,
}

/// Shades the pixels with the given rays, all of which see `triangle`.
///
/// Writes red, green and blue in 256ths of a grey level.
pub(crate) fn shade_run(
    triangle: &ScreenTriangle,
    texture: &Texture,
    pixel_size: [f32; 2],
    rays: (&[f32], &[f32]),
    out: &mut [u16],
) {
    let n = rays.0.len().min(RUN_MAX);
    let (mut u, mut v, mut light) = ([0i32; RUN_MAX], [0i32; RUN_MAX], [0u32; RUN_MAX]);
    for i in 0..n {
        let (x, y) = (rays.0[i], rays.1[i]);
        let z = 1.0 / triangle.inv_z.at(x, y);
        u[i] = fixed(triangle.u.at(x, y) * z * 256.0);
        v[i] = fixed(triangle.v.at(x, y) * z * 256.0);
        light[i] = fixed((triangle.light.at(x, y) * z * LIGHT_ONE).clamp(0.0, 15.0 * LIGHT_ONE)) as u32;
    }
    let sampler = Sampler::new(triangle, texture, pixel_size, rays.0[n / 2], rays.1[n / 2]);
    for (i, pixel) in out.chunks_exact_mut(3).enumerate().take(n) {
        let texel = sampler.read(u[i], v[i]);
        for (lane, channel) in pixel.iter_mut().enumerate() {
            let albedo = (texel >> (16 * lane)) as u32 & 0xffff;
            *channel = ((albedo * light[i]) >> 12).min(0xffff) as u16;
        }
    }
}

/// Rounds to the nearest whole number; exact between -4 and 4 million.
fn fixed(value: f32) -> i32 {
    (value + ROUNDING).to_bits() as i32 - ROUNDING.to_bits() as i32
}

impl<'a> Sampler<'a> {
    /// Chooses the copies whose texels have the size of a pixel at the ray `(x, y)`.
    fn new(triangle: &ScreenTriangle, texture: &'a Texture, pixel_size: [f32; 2], x: f32, y: f32) -> Self {
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
        // Half a level finer than one texel per pixel: the pixel's own area and the lens blur come on top.
        let level = ((log2_in_256ths(square) - 256) / 2).clamp(0, last * 256);
        let fine = (level >> 8).min(last);
        let coarse = (fine + 1).min(last);
        Self {
            fine: &levels[fine as usize],
            coarse: &levels[coarse as usize],
            fine_shift: fine as u32,
            coarse_share: (level & 0xff) as u32,
        }
    }

    /// The filtered texel, lanes in 256ths of a grey level; `u`, `v` in 256ths of a texel of the finest copy.
    fn read(&self, u: i32, v: i32) -> u64 {
        let fine = bilinear(self.fine, shift_rounded(u, self.fine_shift), shift_rounded(v, self.fine_shift));
        if self.coarse_share == 0 {
            return fine;
        }
        let shift = self.fine_shift + 1;
        let coarse = bilinear(self.coarse, shift_rounded(u, shift), shift_rounded(v, shift));
        let (share, rest) = (u64::from(self.coarse_share), u64::from(256 - self.coarse_share));
        let even = ((fine & EVEN_LANES) * rest + (coarse & EVEN_LANES) * share) >> 8;
        let odd = ((fine >> 16) & EVEN_LANES) * rest + ((coarse >> 16) & EVEN_LANES) * share;
        (even & EVEN_LANES) | ((odd << 8) & !EVEN_LANES)
    }
}

/// Bilinear interpolation between four texel centres; lanes in 256ths of a grey level.
fn bilinear(level: &Level, u: i32, v: i32) -> u64 {
    let (u, v) = (u - 128, v - 128);
    let (fu, fv) = ((u & 0xff) as u32, (v & 0xff) as u32);
    let (mask_u, mask_v) = ((1i32 << level.width_log2) - 1, (1i32 << level.height_log2) - 1);
    let (u0, v0) = ((u >> 8) & mask_u, (v >> 8) & mask_v);
    let (u1, v1) = ((u0 + 1) & mask_u, (v0 + 1) & mask_v);
    let texel = |u: i32, v: i32| level.texels[((v << level.width_log2) | u) as usize];
    // The four weights sum to 256 exactly and so do their halves, so places stay right to 1/256 texel.
    let w11 = (fu * fv + 128) >> 8;
    let (w10, w01) = (fu - w11, fv - w11);
    let w00 = 256 + w11 - fu - fv;
    texel(u0, v0) * u64::from(w00)
        + texel(u1, v0) * u64::from(w10)
        + texel(u0, v1) * u64::from(w01)
        + texel(u1, v1) * u64::from(w11)
}

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

    #[test]
    fn bilinear_reproduces_a_ramp_at_every_copy() {
        let texture = Texture::from_fn(6, 6, |u, v| [255.0 * u, 255.0 * v, 100.0]);
        for (shift, level) in texture.levels().iter().enumerate().take(3) {
            for (u, v) in [(20.0, 31.3), (33.37, 12.9), (40.5, 40.5)] {
                let scaled = |x: f64| shift_rounded((x * 256.0) as i32, shift as u32);
                let texel = bilinear(level, scaled(u), scaled(v));
                let lane = |k: u32| ((texel >> (16 * k)) & 0xffff) as f64 / 256.0;
                assert!((lane(0) - 255.0 * u / 64.0).abs() < 0.6, "copy {shift}: {} at {u}", lane(0));
                assert!((lane(1) - 255.0 * v / 64.0).abs() < 0.6, "copy {shift}: {} at {v}", lane(1));
                assert_eq!(lane(2), 100.0);
            }
        }
    }

    #[test]
    fn mixture_of_copies_keeps_a_constant_colour() {
        let texture = Texture::from_fn(4, 4, |_, _| [255.0, 17.0, 99.0]);
        for coarse_share in [0, 1, 100, 255] {
            let levels = texture.levels();
            let sampler = Sampler { fine: &levels[0], coarse: &levels[1], fine_shift: 0, coarse_share };
            let texel = sampler.read(777, 345);
            assert_eq!([texel & 0xffff, (texel >> 16) & 0xffff, (texel >> 32) & 0xffff].map(|t| t >> 8), [255, 17, 99]);
        }
    }
}
