//! Sensor model, from light to image: lens blur, exposure, gain, noise, quantisation.
//!
//! Grey levels are proportional to light (no gamma): a surface of texture colour 200 under light 1 gives grey level 200.

use std::ops::RangeInclusive;

use pb3dp_computing::wide;

use crate::noise;
use crate::wide::kernels;

/// Parameters of the two sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorConfig {
    /// Standard deviation of the lens blur in pixels, 0 to 0.7.
    pub lens_blur_px: f64,
    /// Standard deviation of the noise in the dark, grey levels.
    pub read_noise_grey: f64,
    /// Variance of the noise added per grey level of light, grey levels.
    pub shot_noise_grey: f64,
    /// Response of the left camera.
    pub left: CameraResponse,
    /// Response of the right camera.
    pub right: CameraResponse,
}

impl Default for SensorConfig {
    /// A good machine-vision pair without photometric calibration: noise of 2 grey levels in mid-grey, and a right camera that is
    /// slightly brighter and warmer.
    fn default() -> Self {
        Self {
            lens_blur_px: 0.5,
            read_noise_grey: 1.2,
            shot_noise_grey: 0.02,
            left: CameraResponse::NEUTRAL,
            right: CameraResponse { exposure: 1.02, gain: [1.02, 1.0, 0.98], offset_grey: [1.0, 0.0, -1.0] },
        }
    }
}

/// Allowed numbers of rendered moments of an exposure: 1 renders sharp images.
pub const BLUR_MOMENTS: RangeInclusive<u32> = 1..=64;

impl SensorConfig {
    /// A perfect sensor: no blur, no noise, equal responses; only quantisation remains.
    pub const IDEAL: Self = Self {
        lens_blur_px: 0.0,
        read_noise_grey: 0.0,
        shot_noise_grey: 0.0,
        left: CameraResponse::NEUTRAL,
        right: CameraResponse::NEUTRAL,
    };

    /// Allowed values of `lens_blur_px`.
    pub const LENS_BLUR_PX: RangeInclusive<f64> = 0.0..=0.7;
    /// Allowed values of `read_noise_grey`.
    pub const READ_NOISE_GREY: RangeInclusive<f64> = 0.0..=50.0;
    /// Allowed values of `shot_noise_grey`.
    pub const SHOT_NOISE_GREY: RangeInclusive<f64> = 0.0..=10.0;

    /// Checks every number.
    ///
    /// # Errors
    /// The first number out of its range.
    pub fn validate(&self) -> Result<(), SensorError> {
        let mut checks = vec![
            ("lens_blur_px", self.lens_blur_px, Self::LENS_BLUR_PX),
            ("read_noise_grey", self.read_noise_grey, Self::READ_NOISE_GREY),
            ("shot_noise_grey", self.shot_noise_grey, Self::SHOT_NOISE_GREY),
        ];
        for side in [&self.left, &self.right] {
            checks.push(("exposure", side.exposure, CameraResponse::EXPOSURE));
            checks.extend(side.gain.map(|gain| ("gain", gain, CameraResponse::GAIN)));
            checks.extend(side.offset_grey.map(|offset| ("offset_grey", offset, CameraResponse::OFFSET_GREY)));
        }
        match checks.into_iter().find(|(_, value, allowed)| !allowed.contains(value)) {
            Some((name, value, allowed)) => {
                Err(SensorError { name, value, min: *allowed.start(), max: *allowed.end() })
            }
            None => Ok(()),
        }
    }
}

/// Response of one camera: grey = exposure * gain * light + offset, per channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraResponse {
    /// Factor for all channels.
    pub exposure: f64,
    /// Factors of red, green, blue.
    pub gain: [f64; 3],
    /// Offsets of red, green, blue in grey levels.
    pub offset_grey: [f64; 3],
}

impl CameraResponse {
    /// Allowed values of `exposure`.
    pub const EXPOSURE: RangeInclusive<f64> = 0.01..=16.0;
    /// Allowed values of each `gain`.
    pub const GAIN: RangeInclusive<f64> = 0.01..=16.0;
    /// Allowed values of each `offset_grey`.
    pub const OFFSET_GREY: RangeInclusive<f64> = -128.0..=128.0;

    /// Grey level equals light.
    pub const NEUTRAL: Self = Self { exposure: 1.0, gain: [1.0; 3], offset_grey: [0.0; 3] };
}

/// A sensor parameter is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("sensor parameter {name} is {value}; set it between {min} and {max}")]
pub struct SensorError {
    /// Name of the parameter.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest allowed.
    pub min: f64,
    /// Largest allowed.
    pub max: f64,
}

/// Selects the noise of an image: every combination has different noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NoiseKey {
    pub(crate) seed: u32,
    pub(crate) frame_index: u64,
    pub(crate) side: u32,
}

/// Sum of four random bytes: mean, and 1 / standard deviation (variance 4 (256^2 - 1) / 12).
const BYTES_MEAN: f32 = 510.0;
const BYTES_INVERSE_SIGMA: f32 = 0.006_765_875;

/// Adding this to a number below 2^22 leaves the number, rounded, in the low bits of the sum.
const ROUNDING: f32 = 8_388_608.0;

/// Converts light to images, one row at a time.
#[derive(Clone, Debug)]
pub(crate) struct Developer {
    scale: [f32; 3],
    offset: [f32; 3],
    read_variance: f32,
    shot_variance: f32,
    /// Weight of each neighbour in the blur, in 1/65536.
    blur_weight: u32,
    /// One row, blurred along the columns, with one additional pixel on either side.
    row: Vec<u16>,
    blurred: Vec<u16>,
}

impl Developer {
    pub(crate) fn new(config: &SensorConfig, response: &CameraResponse, width: usize) -> Self {
        let (scale, offset) = scale_and_offset(response);
        Self {
            scale,
            offset,
            read_variance: (config.read_noise_grey * config.read_noise_grey) as f32,
            shot_variance: config.shot_noise_grey as f32,
            blur_weight: (config.lens_blur_px * config.lens_blur_px * 0.5 * 65536.0).round() as u32,
            row: vec![0; 3 * (width + 2)],
            blurred: vec![0; 3 * width],
        }
    }

    /// Changes the response.
    pub(crate) fn set_response(&mut self, response: &CameraResponse) {
        (self.scale, self.offset) = scale_and_offset(response);
    }

    /// Defocuses the light of a whole image: standard deviation `sigma_px`, in addition to the blur of the sensor's lens. `light`
    /// as in [`Self::develop`].
    pub(crate) fn defocus(&mut self, light: &mut [u16], sigma_px: f64) {
        spread(light, self.blurred.len(), sigma_px);
    }

    /// Disables the lens blur, for light that is already blurred.
    pub(crate) fn leave_blur_out(&mut self) {
        self.blur_weight = 0;
    }

    /// The image without noise, quantisation and clipping, grey levels; `light` as in [`Self::develop`].
    pub(crate) fn develop_ideal(&mut self, light: &[u16], image: &mut Vec<f32>) {
        let stride = self.blurred.len();
        let rows = light.len() / stride;
        image.clear();
        image.reserve(light.len());
        for row in 0..rows {
            let line = |r: usize| &light[r * stride..(r + 1) * stride];
            let neighbours = [line(row.saturating_sub(1)), line(row), line((row + 1).min(rows - 1))];
            blur_row(neighbours, self.blur_weight, &mut self.row, &mut self.blurred);
            let exposed = self.blurred.iter().enumerate();
            image.extend(exposed.map(|(i, &value)| f32::from(value) * self.scale[i % 3] + self.offset[i % 3]));
        }
    }

    /// Converts a whole image: `light` in 256ths of a grey level, red, green, blue, row-major.
    pub(crate) fn develop(&mut self, light: &[u16], key: &NoiseKey, image: &mut [u8]) {
        develop(kernels(), self, light, key, image);
    }

    #[inline(always)]
    fn develop_kernel(&mut self, light: &[u16], key: &NoiseKey, image: &mut [u8]) {
        let stride = self.blurred.len();
        let rows = light.len() / stride;
        let keys = [0u32, 1].map(|word| {
            noise::hash(&[key.seed, key.frame_index as u32, (key.frame_index >> 32) as u32, key.side, word])
        });
        for (row, out) in image.chunks_exact_mut(stride).enumerate() {
            let line = |r: usize| &light[r * stride..(r + 1) * stride];
            let neighbours = [line(row.saturating_sub(1)), line(row), line((row + 1).min(rows - 1))];
            let source = if self.blur_weight > 0 {
                blur_row(neighbours, self.blur_weight, &mut self.row, &mut self.blurred);
                self.blurred.as_slice()
            } else {
                neighbours[1]
            };
            self.expose_row(source, keys, (row * stride) as u32, out);
        }
    }

    #[inline(always)]
    fn expose_row(&self, light: &[u16], keys: [u32; 2], first_index: u32, out: &mut [u8]) {
        // Values of eight whole pixels: a pattern of gains suitable for vector units of any width.
        const PERIOD: usize = 24;
        let scale: [f32; PERIOD] = std::array::from_fn(|i| self.scale[i % 3]);
        let offset: [f32; PERIOD] = std::array::from_fn(|i| self.offset[i % 3]);
        let expose = |i: usize, light: u16, index: u32| {
            let signal = f32::from(light) * scale[i];
            let sigma = (self.read_variance + self.shot_variance * signal).sqrt();
            let grey = signal + offset[i] + sigma * standard_noise(index, keys);
            (grey.clamp(0.0, 255.0) + ROUNDING).to_bits() as u8
        };
        let (mut pieces, mut lights) = (out.chunks_exact_mut(PERIOD), light.chunks_exact(PERIOD));
        let mut index = first_index;
        for (piece, light) in pieces.by_ref().zip(lights.by_ref()) {
            for i in 0..PERIOD {
                piece[i] = expose(i, light[i], index.wrapping_add(i as u32));
            }
            index = index.wrapping_add(PERIOD as u32);
        }
        for (i, (out, &light)) in pieces.into_remainder().iter_mut().zip(lights.remainder()).enumerate() {
            *out = expose(i, light, index.wrapping_add(i as u32));
        }
    }
}

wide! {
    fn develop(developer: &mut Developer, light: &[u16], key: &NoiseKey, image: &mut [u8]) = Developer::develop_kernel;
}

/// Factors on light in 256ths of a grey level, and offsets.
fn scale_and_offset(response: &CameraResponse) -> ([f32; 3], [f32; 3]) {
    let scale = response.gain.map(|gain| (gain * response.exposure / 256.0) as f32);
    (scale, response.offset_grey.map(|offset| offset as f32))
}

/// Blurs an image whose rows have `stride` values with a standard deviation `sigma_px`.
pub(crate) fn spread(light: &mut [u16], stride: usize, sigma_px: f64) {
    // Passes of a kernel (w, 1 - 2w, w) add their variances, 2w each; up to 0.49 the kernel has no side lobes.
    let variance = sigma_px * sigma_px;
    let passes = (variance / 0.49).ceil() as u32;
    let weight = (variance / f64::from(passes.max(1)) * 0.5 * 65536.0).round() as u32;
    let (mut padded, mut blurred) = (vec![0; stride + 6], vec![0; stride]);
    let (mut above, mut here) = (vec![0; stride], vec![0; stride]);
    for _ in 0..passes {
        above.copy_from_slice(&light[..stride]);
        for start in (0..light.len()).step_by(stride) {
            here.copy_from_slice(&light[start..start + stride]);
            let next = if start + stride < light.len() { start + stride } else { start };
            blur_line(kernels(), [&above, &here, &light[next..next + stride]], weight, &mut padded, &mut blurred);
            light[start..start + stride].copy_from_slice(&blurred);
            std::mem::swap(&mut above, &mut here);
        }
    }
}

wide! {
    fn blur_line(lines: [&[u16]; 3], weight: u32, padded: &mut [u16], out: &mut [u16]) = blur_row;
}

/// An approximately normal number: the sum of four random bytes, mean 0, variance 1, within 3.46.
#[inline(always)]
fn standard_noise(index: u32, keys: [u32; 2]) -> f32 {
    let mut x = index.wrapping_mul(0x9E37_79B1) ^ keys[0];
    x = (x ^ (x >> 15)).wrapping_mul(0x85EB_CA77).wrapping_add(keys[1]);
    x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE3D);
    x ^= x >> 16;
    let pairs = (x & 0x00ff_00ff) + ((x >> 8) & 0x00ff_00ff);
    let sum = (pairs & 0xffff) + (pairs >> 16);
    (sum as i32 as f32 - BYTES_MEAN) * BYTES_INVERSE_SIGMA
}

/// Blurs with the kernel (w, 1 - 2w, w) along columns, then along rows; border pixels are replicated.
#[inline(always)]
fn blur_row(lines: [&[u16]; 3], weight: u32, padded: &mut [u16], out: &mut [u16]) {
    let centre = 65536 - 2 * weight;
    let mix = |a: u16, b: u16, c: u16| {
        ((weight * (u32::from(a) + u32::from(c)) + centre * u32::from(b) + 32768) >> 16) as u16
    };
    let n = out.len();
    let inner = &mut padded[3..3 + n];
    for (((mixed, &a), &b), &c) in inner.iter_mut().zip(lines[0]).zip(lines[1]).zip(lines[2]) {
        *mixed = mix(a, b, c);
    }
    padded.copy_within(3..6, 0);
    padded.copy_within(n..n + 3, n + 3);
    for (((out, &a), &b), &c) in out.iter_mut().zip(&padded[..n]).zip(&padded[3..n + 3]).zip(&padded[6..]) {
        *out = mix(a, b, c);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: NoiseKey = NoiseKey { seed: 5, frame_index: 9, side: 0 };

    fn noise_image(config: &SensorConfig, key: &NoiseKey, light_grey: u16) -> Vec<f64> {
        let mut image = vec![0; 3 * 160 * 100];
        let light = vec![light_grey * 256; image.len()];
        Developer::new(config, &config.left, 160).develop(&light, key, &mut image);
        image.iter().map(|&p| f64::from(p) - f64::from(light_grey)).collect()
    }

    fn correlation(a: &[f64], b: &[f64]) -> f64 {
        let sum = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        sum(a, b) / (sum(a, a) * sum(b, b)).sqrt()
    }

    #[test]
    fn noise_has_the_configured_variance_and_no_pattern() {
        let config = SensorConfig { read_noise_grey: 3.0, shot_noise_grey: 0.05, ..SensorConfig::IDEAL };
        let a = noise_image(&config, &KEY, 100);
        let n = a.len() as f64;
        let (mean, variance) = (a.iter().sum::<f64>() / n, a.iter().map(|x| x * x).sum::<f64>() / n);
        // 9 + 0.05 * 100, and 1/12 of quantisation.
        assert!(mean.abs() < 0.08, "{mean}");
        assert!((variance - 14.083).abs() < 0.35, "{variance}");
        assert!(correlation(&a[..a.len() - 3], &a[3..]).abs() < 0.02);
        assert!(correlation(&a[..a.len() - 480], &a[480..]).abs() < 0.02);
        for other in [NoiseKey { frame_index: 10, ..KEY }, NoiseKey { side: 1, ..KEY }, NoiseKey { seed: 6, ..KEY }] {
            assert!(correlation(&a, &noise_image(&config, &other, 100)).abs() < 0.02, "{other:?}");
        }
        assert_eq!(a, noise_image(&config, &KEY, 100));
    }

    #[test]
    fn response_is_gain_times_light_plus_offset() {
        let response = CameraResponse { exposure: 0.5, gain: [1.0, 2.0, 3.0], offset_grey: [7.3, 0.0, -4.0] };
        let mut image = [0u8; 15];
        Developer::new(&SensorConfig::IDEAL, &response, 5).develop(&[100 * 256; 15], &KEY, &mut image);
        assert_eq!(image[12..], [57, 100, 146]);
        Developer::new(&SensorConfig::IDEAL, &response, 5).develop(&[255 * 256; 15], &KEY, &mut image);
        assert_eq!(image[..3], [135, 255, 255]);
    }

    #[test]
    fn blur_spreads_a_point_by_its_variance() {
        let config = SensorConfig { lens_blur_px: 0.6, ..SensorConfig::IDEAL };
        let mut light = vec![0u16; 3 * 9 * 7];
        light[3 * (9 * 3 + 4) + 1] = 200 * 256;
        let mut image = vec![0u8; light.len()];
        Developer::new(&config, &config.left, 9).develop(&light, &KEY, &mut image);
        let grey = |column: usize, row: usize| image[3 * (9 * row + column) + 1];
        // Weights 0.18, 0.64, 0.18 in either direction.
        assert_eq!((grey(4, 3), grey(3, 3), grey(4, 4), grey(5, 2)), (82, 23, 23, 6));
        assert_eq!((grey(2, 3), image[3 * (9 * 3 + 4)]), (0, 0));
    }

    #[test]
    fn defocus_spreads_a_point_by_its_variance_and_keeps_its_light() {
        let (width, height) = (31usize, 27usize);
        let mut light = vec![0u16; 3 * width * height];
        light[3 * (width * 12 + 17) + 2] = 65_000;
        let mut developer = Developer::new(&SensorConfig::IDEAL, &CameraResponse::NEUTRAL, width);
        developer.defocus(&mut light, 1.5);
        let mut image = Vec::new();
        developer.develop_ideal(&light, &mut image);
        let (mut sum, mut moments) = (0.0, [0.0f64; 4]);
        for row in 0..height {
            for column in 0..width {
                let (value, dx, dy) =
                    (f64::from(image[3 * (row * width + column) + 2]), column as f64 - 17.0, row as f64 - 12.0);
                sum += value;
                moments[0] += value * dx;
                moments[1] += value * dy;
                moments[2] += value * dx * dx;
                moments[3] += value * dy * dy;
            }
        }
        let [x, y, xx, yy] = moments.map(|moment| moment / sum);
        assert!((sum - 65_000.0 / 256.0).abs() < 1.0, "{sum}");
        assert!(x.abs() < 0.01 && y.abs() < 0.01, "{x} {y}");
        assert!((xx - 2.25).abs() < 0.03 && (yy - 2.25).abs() < 0.03, "{xx} {yy}");
        assert!(image.iter().skip(1).step_by(3).all(|&green| green == 0.0));
    }

    #[test]
    fn the_ideal_image_is_the_mean_of_noisy_ones() {
        let response = CameraResponse { exposure: 0.9, gain: [1.1, 1.0, 0.8], offset_grey: [5.0, -3.0, 0.0] };
        let config = SensorConfig { lens_blur_px: 0.6, read_noise_grey: 2.0, ..SensorConfig::IDEAL };
        let light: Vec<u16> = (0..3 * 8 * 5u32).map(|i| (9000 + (i * 7919) % 23_000) as u16).collect();
        let mut developer = Developer::new(&config, &response, 8);
        let mut ideal = Vec::new();
        developer.develop_ideal(&light, &mut ideal);
        let mut sum = vec![0.0; light.len()];
        let mut image = vec![0; light.len()];
        for frame_index in 0..400 {
            developer.develop(&light, &NoiseKey { frame_index, ..KEY }, &mut image);
            sum.iter_mut().zip(&image).for_each(|(sum, &grey)| *sum += f64::from(grey));
        }
        for (mean, ideal) in sum.iter().map(|sum| sum / 400.0).zip(ideal) {
            assert!((mean - f64::from(ideal)).abs() < 0.45, "{mean} {ideal}");
        }
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        let config = SensorConfig { lens_blur_px: 1.5, ..SensorConfig::IDEAL };
        assert_eq!(
            config.validate().unwrap_err().to_string(),
            "sensor parameter lens_blur_px is 1.5; set it between 0 and 0.7"
        );
        let mut config = SensorConfig::default();
        config.validate().unwrap();
        config.right.gain[2] = f64::NAN;
        assert_eq!(config.validate().unwrap_err().name, "gain");
    }
}
