//! Reduced luminance images, and normalised windows of them.

use image::RgbImage;

/// Columns and rows of a window.
pub const WINDOW: usize = 8;
/// Pixels of a window.
const AREA: usize = WINDOW * WINDOW;
/// Scale of the luminance: it is stored in eighths of a grey level, so that means of blocks keep their fraction.
pub const SCALE: f64 = 8.0;
/// Vector norm of a normalised window; the products of its elements with those of a plane stay within 31 bits.
const LENGTH: f64 = 4096.0;
/// Windows with a smaller standard deviation match nothing, grey levels.
const DEVIATION_MIN: f64 = 2.0;

/// Luminance of an image; each sample is the mean of a square block of pixels.
pub struct Plane {
    pub width: usize,
    pub height: usize,
    samples: Vec<i16>,
}

impl Plane {
    /// The luminance in blocks of `factor` by `factor` pixels; an incomplete last column or row is dropped.
    pub fn of(image: &RgbImage, factor: usize) -> Self {
        let (full_width, full_height) = (image.width() as usize, image.height() as usize);
        let (width, height) = (full_width / factor, full_height / factor);
        let mut sums = vec![0_u32; width * height];
        let rows = image.as_raw().chunks_exact(3 * full_width.max(1));
        for (v, row) in rows.take(height * factor).enumerate() {
            let line = &mut sums[v / factor * width..][..width];
            for (sum, block) in line.iter_mut().zip(row.chunks_exact(3 * factor)) {
                *sum += block.chunks_exact(3).map(luminance_256).sum::<u32>();
            }
        }
        let scale = SCALE / (256.0 * (factor * factor) as f64);
        let samples = sums.iter().map(|&sum| (f64::from(sum) * scale).round() as i16).collect();
        Self { width, height, samples }
    }

    /// Whether a window with this upper left corner is inside the plane.
    pub fn holds(&self, x: isize, y: isize) -> bool {
        x >= 0 && y >= 0 && x as usize + WINDOW <= self.width && y as usize + WINDOW <= self.height
    }

    pub fn at(&self, x: usize, y: usize) -> i32 {
        i32::from(self.samples[y * self.width + x])
    }

    fn row(&self, x: usize, y: usize) -> &[i16] {
        &self.samples[y * self.width + x..][..WINDOW]
    }

    /// The window at a corner, normalised; `None` if its contrast is too low.
    pub fn window(&self, x: usize, y: usize) -> Option<Window> {
        let moments = self.moments(x, y);
        if moments.inverse_length <= 0.0 {
            return None;
        }
        let mean = f64::from(moments.sum) / AREA as f64;
        let scale = LENGTH * f64::from(moments.inverse_length);
        let samples: [i16; AREA] = std::array::from_fn(|k| {
            ((f64::from(self.at(x + k % WINDOW, y + k / WINDOW)) - mean) * scale).round() as i16
        });
        Some(Window { samples, sum: samples.iter().map(|&sample| i32::from(sample)).sum() })
    }

    fn moments(&self, x: usize, y: usize) -> Moments {
        let (mut sum, mut squares) = (0_i32, 0_i32);
        for dy in 0..WINDOW {
            for &sample in self.row(x, y + dy) {
                sum += i32::from(sample);
                squares += i32::from(sample) * i32::from(sample);
            }
        }
        let variance = f64::from(squares) - f64::from(sum) * f64::from(sum) / AREA as f64;
        let least = (SCALE * DEVIATION_MIN).powi(2) * AREA as f64;
        let inverse_length = if variance < least { 0.0 } else { (1.0 / variance.sqrt()) as f32 };
        Moments { sum, inverse_length }
    }

    /// The moments of all windows, by corner; rows have the length of the plane's rows.
    pub fn all_moments(&self) -> Vec<Moments> {
        let mut all = vec![Moments::default(); self.width * self.height];
        for y in 0..(self.height + 1).saturating_sub(WINDOW) {
            for x in 0..(self.width + 1).saturating_sub(WINDOW) {
                all[y * self.width + x] = self.moments(x, y);
            }
        }
        all
    }

    /// Same as [`Self::correlation`], for a window whose moments are not precomputed; -1 outside the plane.
    pub fn correlation_at(&self, window: &Window, x: isize, y: isize) -> f32 {
        if !self.holds(x, y) {
            return -1.0;
        }
        let (x, y) = (x as usize, y as usize);
        self.correlation(window, &self.moments(x, y), x, y)
    }

    /// Correlation of a normalised window with the window at a corner, -1 to 1; 0 if the contrast there is too low.
    pub fn correlation(&self, window: &Window, moments: &Moments, x: usize, y: usize) -> f32 {
        // Pairs of products in four lanes: compilers turn this form into one instruction per row.
        let mut lanes = [0_i32; WINDOW / 2];
        for (dy, line) in window.samples.chunks_exact(WINDOW).enumerate() {
            let row = self.row(x, y + dy);
            for (k, lane) in lanes.iter_mut().enumerate() {
                let product = |k: usize| i32::from(line[k]) * i32::from(row[k]);
                *lane += product(2 * k) + product(2 * k + 1);
            }
        }
        let product: i32 = lanes.iter().sum();
        let without_mean = product - window.sum * moments.sum / AREA as i32;
        without_mean as f32 * moments.inverse_length * (1.0 / LENGTH as f32)
    }
}

/// A window with its mean removed, scaled to a vector norm of 4096.
pub struct Window {
    samples: [i16; AREA],
    /// Remainder of the mean due to rounding, times 64.
    sum: i32,
}

/// Normalisation of a window.
#[derive(Clone, Copy, Default)]
pub struct Moments {
    sum: i32,
    /// 1 / norm of the window with its mean removed; 0 if the contrast is too low.
    inverse_length: f32,
}

/// Luminance times 256, with the weights of Rec. 601.
fn luminance_256(pixel: &[u8]) -> u32 {
    77 * u32::from(pixel[0]) + 150 * u32::from(pixel[1]) + 29 * u32::from(pixel[2])
}
