//! Luminance and chroma channels of a window of an image.
//!
//! `Y = (R + G + B) / sqrt 3`, `A = sqrt(2/3) (R - (G + B) / 2)`, `B' = (G - B) / sqrt 2`: an orthonormal rotation of RGB. `A`
//! and `B'` form the saturation-weighted hue vector: linear, with constant noise, never undefined. Equal independent noise of
//! the three channels stays equal and independent.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::wide::{LANES, wide};

use super::image_plane::{ImagePlane, PixelWindow};

/// Rows of the rotation from RGB to (Y, A, B'): (1, 1, 1) / sqrt 3, (2, -1, -1) / sqrt 6 and (0, 1, -1) / sqrt 2.
pub const OPPONENT_FROM_RGB: [[f32; 3]; 3] = [
    [0.577_350_26, 0.577_350_26, 0.577_350_26],
    [0.816_496_6, -0.408_248_3, -0.408_248_3],
    [0.0, std::f32::consts::FRAC_1_SQRT_2, -std::f32::consts::FRAC_1_SQRT_2],
];

/// A pixel with a channel at or above this value may be saturated. Chosen by hand, not varied: one below the end of the
/// range.
pub const SATURATED_FROM: u8 = 254;

/// Selection of the channels to compute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// `Y` only; the other planes stay empty.
    Luminance,
    /// `Y`, `A` and `B'`.
    Colour,
    /// Red, green and blue unchanged, stored in place of `Y`, `A` and `B'`.
    Rgb,
}

impl Wanted {
    /// Number of planes.
    pub fn planes(self) -> usize {
        if self == Self::Luminance { 1 } else { 3 }
    }

    /// One of its planes of a colour.
    #[inline(always)]
    pub(super) fn channel(self, plane: usize, rgb: [f32; 3]) -> f32 {
        if self == Self::Rgb {
            return rgb[plane];
        }
        let turn = OPPONENT_FROM_RGB[plane];
        turn[0] * rgb[0] + turn[1] * rgb[1] + turn[2] * rgb[2]
    }
}

/// The channels of one window of one image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColourPlanes {
    /// Position of the planes in the (rectified) image.
    pub window: PixelWindow,
    /// Luminance Y, then A and B' (empty if only the luminance was requested); or red, green and blue.
    pub planes: [ImagePlane; 3],
    /// Per pixel: 0 if usable, otherwise [`SATURATED`] or [`UNSEEN`].
    pub flags: Vec<u8>,
}

/// Flag of a pixel with a channel at [`SATURATED_FROM`] or above.
pub const SATURATED: u8 = 1;
/// Flag of a pixel that is outside the raw image.
pub const UNSEEN: u8 = 2;

impl ColourPlanes {
    /// The luminance plane.
    #[inline]
    pub fn luminance(&self) -> &ImagePlane {
        &self.planes[0]
    }

    /// Sets the window and the channels; the values are undefined afterwards.
    pub fn resize(&mut self, window: PixelWindow, wanted: Wanted) {
        self.window = window;
        self.planes[0].resize(window.width, window.height);
        let (width, height) = if wanted.planes() == 3 { (window.width, window.height) } else { (0, 0) };
        self.planes[1].resize(width, height);
        self.planes[2].resize(width, height);
        self.flags.resize(window.width * window.height, 0);
    }

    /// Computes the channels of the part of `window` inside the image.
    pub fn update(&mut self, image: ImageView<'_>, window: PixelWindow, wanted: Wanted, kernels: Kernels) {
        let window = window.clipped(image.width(), image.height());
        self.resize(window, wanted);
        let (columns, mut converted) = (window.columns(), Vec::new());
        for (y, row) in window.rows().enumerate() {
            let rgb = image.rgb(columns.clone(), row..row + 1, &mut converted).row(0);
            let flags = &mut self.flags[y * window.width..(y + 1) * window.width];
            let [luminance, a, b] = &mut self.planes;
            match wanted {
                Wanted::Luminance => luminance_row(kernels, rgb, luminance.row_mut(y), flags),
                Wanted::Colour => colour_row(kernels, rgb, luminance.row_mut(y), a.row_mut(y), b.row_mut(y), flags),
                Wanted::Rgb => rgb_row(kernels, rgb, luminance.row_mut(y), a.row_mut(y), b.row_mut(y), flags),
            }
        }
    }
}

impl ColourPlanes {
    /// Computes the luminance of the part of `window` inside the image at half the size: means of 2 x 2 pixels, and their
    /// flags. The window is given in full-size pixels and starts at even ones.
    pub fn update_halved(&mut self, image: ImageView<'_>, window: PixelWindow, kernels: Kernels) {
        let full = window.clipped(image.width(), image.height());
        let window = full.halved();
        self.resize(window, Wanted::Luminance);
        let first = full.x as usize;
        let (columns, mut converted) = (first..first + 2 * window.width, Vec::new());
        for (y, row) in full.rows().step_by(2).take(window.height).enumerate() {
            let rows = image.rgb(columns.clone(), row..row + 2, &mut converted);
            let flags = &mut self.flags[y * window.width..(y + 1) * window.width];
            halved_row(kernels, rows.row(0), rows.row(1), self.planes[0].row_mut(y), flags);
        }
    }
}

impl ColourPlanes {
    /// Writes the luminance of a window inside these planes, which are red, green and blue, into `out`.
    pub(super) fn luminance_into(&self, window: PixelWindow, kernels: Kernels, out: &mut Self) {
        out.resize(window, Wanted::Luminance);
        let (x, y) = ((window.x - self.window.x) as usize, (window.y - self.window.y) as usize);
        for row in 0..window.height {
            let [red, green, blue] = self.planes.each_ref().map(|plane| &plane.row(y + row)[x..x + window.width]);
            luminance_of_colours(kernels, red, green, blue, out.planes[0].row_mut(row));
            let flags = &self.flags[(y + row) * self.window.width + x..][..window.width];
            out.flags[row * window.width..][..window.width].copy_from_slice(flags);
        }
    }
}

wide! {
    fn luminance_of_colours(red: &[f32], green: &[f32], blue: &[f32], out: &mut [f32]) = luminance_of_colours_kernel;
}

#[inline(always)]
fn luminance_of_colours_kernel(red: &[f32], green: &[f32], blue: &[f32], out: &mut [f32]) {
    let [r, g, b] = OPPONENT_FROM_RGB[0];
    for ((out, red), (green, blue)) in out.iter_mut().zip(red).zip(green.iter().zip(blue)) {
        *out = r * red + g * green + b * blue;
    }
}

/// Number of halved pixels processed at a time.
const HALVED: usize = 64;

wide! {
    fn halved_row(upper: &[u8], lower: &[u8], luminance: &mut [f32], flags: &mut [u8]) = halved_row_kernel;
}

#[inline(always)]
fn halved_row_kernel(upper: &[u8], lower: &[u8], luminance: &mut [f32], flags: &mut [u8]) {
    let (mut sums, mut threes) = ([0_u16; 6 * HALVED + 5], [0_u16; 6 * HALVED + 2]);
    let parts = upper.chunks(6 * HALVED).zip(lower.chunks(6 * HALVED));
    let outs = luminance.chunks_mut(HALVED).zip(flags.chunks_mut(HALVED));
    for ((upper, lower), (luminance, flags)) in parts.zip(outs) {
        let mut highest = 0;
        for ((sum, upper), lower) in sums.iter_mut().zip(upper).zip(lower) {
            *sum = u16::from(*upper) + u16::from(*lower);
            highest = highest.max((*upper).max(*lower));
        }
        // Sums of three adjacent bytes of both rows, for every start; only every sixth pair is used.
        for (i, three) in threes.iter_mut().enumerate() {
            *three = sums[i] + sums[i + 1] + sums[i + 2];
        }
        for (i, luminance) in luminance.iter_mut().enumerate() {
            *luminance = f32::from(threes[6 * i] + threes[6 * i + 3]) * (0.25 * OPPONENT_FROM_RGB[0][0]);
        }
        flags.fill(0);
        if highest >= SATURATED_FROM {
            for (flag, (upper, lower)) in flags.iter_mut().zip(upper.chunks_exact(6).zip(lower.chunks_exact(6))) {
                let highest = upper.iter().chain(lower).fold(0, |a, &b| a.max(b));
                *flag = u8::from(highest >= SATURATED_FROM) * SATURATED;
            }
        }
    }
}

wide! {
    fn luminance_row(rgb: &[u8], luminance: &mut [f32], flags: &mut [u8]) = luminance_row_kernel;
}

wide! {
    fn colour_row(rgb: &[u8], luminance: &mut [f32], a: &mut [f32], b: &mut [f32], flags: &mut [u8]) = colour_row_kernel;
}

wide! {
    fn rgb_row(rgb: &[u8], red: &mut [f32], green: &mut [f32], blue: &mut [f32], flags: &mut [u8]) = rgb_row_kernel;
}

#[inline(always)]
fn rgb_row_kernel(rgb: &[u8], red: &mut [f32], green: &mut [f32], blue: &mut [f32], flags: &mut [u8]) {
    let wide = red.len() / LANES * LANES;
    for start in (0..wide).step_by(LANES) {
        let rgb = &rgb[3 * start..3 * (start + LANES)];
        let ends = start..start + LANES;
        let (red, green) = (&mut red[ends.clone()], &mut green[ends.clone()]);
        let (blue, flags) = (&mut blue[ends.clone()], &mut flags[ends]);
        for i in 0..LANES {
            let (r, g, b) = (rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
            (red[i], green[i], blue[i]) = (f32::from(r), f32::from(g), f32::from(b));
            flags[i] = flag_of(r, g, b);
        }
    }
    for i in wide..red.len() {
        let (r, g, b) = (rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
        (red[i], green[i], blue[i]) = (f32::from(r), f32::from(g), f32::from(b));
        flags[i] = flag_of(r, g, b);
    }
}

#[inline(always)]
fn luminance_row_kernel(rgb: &[u8], luminance: &mut [f32], flags: &mut [u8]) {
    let wide = luminance.len() / LANES * LANES;
    let groups = rgb.chunks_exact(3 * LANES).zip(luminance.chunks_exact_mut(LANES)).zip(flags.chunks_exact_mut(LANES));
    for ((rgb, luminance), flags) in groups {
        for i in 0..LANES {
            let (r, g, b) = (rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
            luminance[i] = luminance_of(r, g, b);
            flags[i] = flag_of(r, g, b);
        }
    }
    for i in wide..luminance.len() {
        let (r, g, b) = (rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
        (luminance[i], flags[i]) = (luminance_of(r, g, b), flag_of(r, g, b));
    }
}

#[inline(always)]
fn colour_row_kernel(rgb: &[u8], luminance: &mut [f32], a: &mut [f32], b: &mut [f32], flags: &mut [u8]) {
    luminance_row_kernel(rgb, luminance, flags);
    let wide = a.len() / LANES * LANES;
    for ((rgb, a), b) in rgb.chunks_exact(3 * LANES).zip(a.chunks_exact_mut(LANES)).zip(b.chunks_exact_mut(LANES)) {
        for i in 0..LANES {
            (a[i], b[i]) = chroma_of(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
        }
    }
    for i in wide..a.len() {
        (a[i], b[i]) = chroma_of(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
    }
}

#[inline(always)]
fn luminance_of(r: u8, g: u8, b: u8) -> f32 {
    (i32::from(r) + i32::from(g) + i32::from(b)) as f32 * OPPONENT_FROM_RGB[0][0]
}

#[inline(always)]
fn chroma_of(r: u8, g: u8, b: u8) -> (f32, f32) {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    ((2 * r - g - b) as f32 * (0.5 * OPPONENT_FROM_RGB[1][0]), (g - b) as f32 * OPPONENT_FROM_RGB[2][1])
}

#[inline(always)]
fn flag_of(r: u8, g: u8, b: u8) -> u8 {
    u8::from(r.max(g).max(b) >= SATURATED_FROM) * SATURATED
}

#[cfg(test)]
mod tests {
    use image::RgbImage;

    use super::*;

    fn image() -> RgbImage {
        RgbImage::from_fn(61, 9, |x, y| image::Rgb([(x * 4) as u8, (x * y % 251) as u8, (200 - y * 11) as u8]))
    }

    #[test]
    fn planes_are_the_turn_of_the_pixels_with_every_kernel() {
        let (image, window) = (image(), PixelWindow { x: 3, y: -2, width: 80, height: 8 });
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut planes = ColourPlanes::default();
            planes.update((&image).into(), window, Wanted::Colour, kernels);
            assert_eq!(planes.window, PixelWindow { x: 3, y: 0, width: 58, height: 6 });
            for (x, y) in [(0usize, 0usize), (17, 3), (57, 5)] {
                let rgb = image.get_pixel(x as u32 + 3, y as u32).0.map(f32::from);
                for (plane, row) in planes.planes.iter().zip(OPPONENT_FROM_RGB) {
                    let expected: f32 = row.iter().zip(rgb).map(|(m, c)| m * c).sum();
                    assert!((plane.row(y)[x] - expected).abs() < 1e-3);
                }
            }
            let mut rgb = ColourPlanes::default();
            rgb.update((&image).into(), window, Wanted::Rgb, kernels);
            let pixel = [0, 1, 2].map(|c| rgb.planes[c].row(3)[17]);
            assert_eq!((pixel, &rgb.flags), (image.get_pixel(20, 3).0.map(f32::from), &planes.flags));
            let mut luminance = ColourPlanes::default();
            luminance.update((&image).into(), window, Wanted::Luminance, kernels);
            assert_eq!((luminance.luminance(), &luminance.flags), (planes.luminance(), &planes.flags));
            assert_eq!(luminance.planes[1].width(), 0);
        }
    }

    #[test]
    fn the_turn_is_orthonormal_and_saturation_is_flagged() {
        let m = nalgebra::Matrix3::from_fn(|i, j| OPPONENT_FROM_RGB[i][j]);
        assert!((m * m.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-6);
        let image = RgbImage::from_fn(2, 1, |x, _| image::Rgb([0, if x == 0 { 253 } else { 254 }, 9]));
        let mut planes = ColourPlanes::default();
        let window = PixelWindow { x: 0, y: 0, width: 2, height: 1 };
        planes.update((&image).into(), window, Wanted::Colour, Kernels::best());
        assert_eq!(planes.flags, [0, SATURATED]);
    }
}
