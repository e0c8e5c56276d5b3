//! Hue of the HSV hexagon, with an explicit gate for pixels without a hue.
//!
//! A hue is a 16-bit angle, 65536 steps per turn, so subtraction wraps automatically: 359 degrees and 1 degree are neighbours.
//! The lowest bit indicates whether the pixel has a hue, which leaves steps of 0.011 degrees.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::ranges;

/// Number of padding elements before and after the pixels, so that kernels may read a whole vector at either end.
pub(crate) const PAD: usize = 64;

/// Steps of [`Hue`] in a full turn.
const STEPS_PER_TURN: f64 = 65536.0;

/// Conditions under which a pixel has a hue. The paper does not define them; with small values hue is noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HueConfig {
    /// Smallest saturation `(max - min) / max`, 0 to 1; applied in steps of 1/256. Default 0.08: above grey cards and lamps
    /// (0.04), and low enough for the faint colours of real scenes. There a gate of 0.15 loses every tenth target and makes the
    /// others worse (exhaustive optimum on 104 planar real cases: 87 instead of 79 usable, median depth error 2.0 % instead of
    /// 2.8 %).
    pub saturation_min: f64,
    /// Smallest value `max / 255`, 0 to 1; applied in steps of 1/255. Default 0.10.
    pub value_min: f64,
}

impl Default for HueConfig {
    fn default() -> Self {
        Self { saturation_min: 0.08, value_min: 0.10 }
    }
}

impl HueConfig {
    ranges! {
        pub fn validate "hue ";
        saturation_min, SATURATION_MIN: f64 = 0.0..=1.0;
        value_min, VALUE_MIN: f64 = 0.0..=1.0;
    }

    /// The gates as integers for the kernels; values out of range are clamped.
    fn gate(&self) -> Gate {
        Gate {
            saturation_min: (self.saturation_min * 256.0).round().clamp(0.0, 256.0) as u16,
            value_min: (self.value_min * 255.0).round().clamp(0.0, 255.0) as u16,
        }
    }
}

/// [`HueConfig`] in integer form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Gate {
    /// A pixel passes if `256 * (max - min) >= saturation_min * max`.
    saturation_min: u16,
    /// A pixel passes if `max >= value_min`.
    value_min: u16,
}

/// The hue of a pixel that has one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Hue(u16);

impl Hue {
    /// The hue nearest to an angle in degrees.
    pub fn from_degrees(angle_deg: f64) -> Self {
        let half_steps = (angle_deg / 360.0 * (STEPS_PER_TURN / 2.0)).round();
        Self(((half_steps.rem_euclid(STEPS_PER_TURN / 2.0) as u16) << 1) | 1)
    }

    /// Angle in degrees, 0 to 360.
    pub fn degrees(self) -> f64 {
        f64::from(self.0 & !1) * (360.0 / STEPS_PER_TURN)
    }

    /// Distance to another hue around the circle, degrees, 0 to 180.
    pub fn distance_deg(self, other: Self) -> f64 {
        f64::from(self.0.wrapping_sub(other.0).cast_signed().unsigned_abs()) * (360.0 / STEPS_PER_TURN)
    }

    /// The stored bits: angle with the validity bit set.
    pub(crate) fn bits(self) -> u16 {
        self.0
    }
}

/// Hue of every pixel of one image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HuePlane {
    width: usize,
    height: usize,
    /// `PAD` zeros, the pixels row by row, `PAD` zeros.
    data: Vec<u16>,
}

impl HuePlane {
    /// Computes the hues of an image with the fastest kernels of this processor.
    pub fn from_rgb<'a>(rgb: impl Into<ImageView<'a>>, config: &HueConfig) -> Self {
        let mut plane = Self::default();
        plane.update_from_rgb(rgb, config, Kernels::best());
        plane
    }

    /// Recomputes the plane; allocates only if the image has grown.
    pub fn update_from_rgb<'a>(&mut self, rgb: impl Into<ImageView<'a>>, config: &HueConfig, kernels: Kernels) {
        let rgb = rgb.into();
        (self.width, self.height) = (rgb.width() as usize, rgb.height() as usize);
        let pixels = self.width * self.height;
        if self.data.len() != pixels + 2 * PAD {
            self.data.clear();
            self.data.resize(pixels + 2 * PAD, 0);
        }
        let (gate, mut converted) = (config.gate(), Vec::new());
        for (y, hues) in self.data[PAD..PAD + pixels].chunks_exact_mut(self.width.max(1)).enumerate() {
            convert(kernels, rgb.row(y as u32, &mut converted), gate, hues);
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Hue of a pixel; `None` outside the image or if the pixel has no hue.
    pub fn at(&self, column: i32, row: i32) -> Option<Hue> {
        let (u, v) = (usize::try_from(column).ok()?, usize::try_from(row).ok()?);
        if u >= self.width || v >= self.height {
            return None;
        }
        let bits = self.data[PAD + v * self.width + u];
        (bits & 1 == 1).then_some(Hue(bits))
    }

    /// The pixels with their padding: pixel (u, v) is at `PAD + v * width + u`, padding has no hue.
    pub(crate) fn padded(&self) -> &[u16] {
        &self.data
    }
}

/// Steps of 1/32768 turn in a sixth of a turn.
const STEPS_PER_SECTOR: f32 = 32768.0 / 6.0;

/// 3 * 2^22: at this value adjacent floats differ by one, so adding it rounds to an integer, stored in the lowest bits.
const ROUNDER: f32 = 12_582_912.0;

wide! {
    /// Converts `rgb` (three bytes per pixel) to stored hues, one per element of `out`.
    fn convert(rgb: &[u8], gate: Gate, out: &mut [u16]) = convert_kernel;
}

/// Number of pixels converted together: each step is a separate loop over them, which compiles to a few vector instructions.
const BLOCK: usize = 64;

#[inline(always)]
fn convert_kernel(rgb: &[u8], gate: Gate, out: &mut [u16]) {
    let (blocks, rest) = rgb.as_chunks::<{ 3 * BLOCK }>();
    let (hues, last_hues) = out.as_chunks_mut::<BLOCK>();
    for (block, hues) in blocks.iter().zip(hues) {
        convert_block(block, gate, hues);
    }
    if rest.is_empty() {
        return;
    }
    let mut last = [0; 3 * BLOCK];
    last[..rest.len()].copy_from_slice(rest);
    let mut hues = [0; BLOCK];
    convert_block(&last, gate, &mut hues);
    last_hues.copy_from_slice(&hues[..last_hues.len()]);
}

/// Angles in the upper 15 bits and the validity bit, or 0 for a pixel without hue.
///
/// The sector is that of the largest channel; of equal channels, red before green before blue. One IEEE division and one
/// multiplication in single precision, rounded to the nearest even integer, so that all kernels give bit-identical results.
#[inline(always)]
fn convert_block(rgb: &[u8; 3 * BLOCK], gate: Gate, hues: &mut [u16; BLOCK]) {
    let [mut red, mut green, mut blue] = [[0i16; BLOCK]; 3];
    for i in 0..BLOCK {
        red[i] = i16::from(rgb[3 * i]);
        green[i] = i16::from(rgb[3 * i + 1]);
        blue[i] = i16::from(rgb[3 * i + 2]);
    }
    let (mut sixths, mut deltas, mut passes) = ([0i16; BLOCK], [0i16; BLOCK], [0u16; BLOCK]);
    for i in 0..BLOCK {
        let (r, g, b) = (red[i], green[i], blue[i]);
        let max = r.max(g).max(b);
        let delta = max - r.min(g).min(b);
        let in_green_or_blue = if max == g { b - r + 2 * delta } else { r - g + 4 * delta };
        sixths[i] = if max == r { g - b } else { in_green_or_blue };
        deltas[i] = delta.max(1);
        let max = max.cast_unsigned();
        let saturated = delta.cast_unsigned() << 8 >= gate.saturation_min * max;
        passes[i] = if saturated & (delta > 0) & (max >= gate.value_min) { u16::MAX } else { 0 };
    }
    for i in 0..BLOCK {
        // At most 27307 in magnitude.
        let steps = f32::from(sixths[i]) / f32::from(deltas[i]) * STEPS_PER_SECTOR + ROUNDER;
        hues[i] = ((steps.to_bits() as u16) << 1 | 1) & passes[i];
    }
}

#[cfg(test)]
mod tests;
