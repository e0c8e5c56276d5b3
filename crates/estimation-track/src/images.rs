//! The required window of one raw image, as a pyramid with fast sub-pixel sampling.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::wide::wide;
use pb3dp_estimation_views::colour_planes::{OPPONENT_FROM_RGB, SATURATED_FROM};
use pb3dp_estimation_views::image_plane::PixelWindow;

/// Levels of the pyramids: 1, 1/2, 1/4 and 1/8 of the resolution. Chosen by hand: in the prototype of ADR 7, planes at 500
/// mm were captured from 80 mm away with four levels, from 50 mm with one.
pub(super) const LEVELS: usize = 4;

/// Y, A, B' (see [`colour_planes`](pb3dp_estimation_views::colour_planes)) and the saturation: the share of saturated pixels, or
/// the colours of [`CLIPPED`] if it was sampled at full resolution.
pub(super) type Texel = [f32; 4];

/// Channels: Y, A, B'.
pub(super) const CHANNELS: usize = 3;

/// Numbers of saturated red, green and blue; those of several colours are added.
pub(super) const CLIPPED: [u8; 3] = [1, 2, 4];

/// One level.
#[derive(Clone, Debug, Default)]
pub(super) struct TexelPlane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) texels: Vec<Texel>,
}

/// The unmodified window: it takes a quarter of the memory of texels, and only few points are sampled.
#[derive(Clone, Debug, Default)]
pub(super) struct RgbPlane {
    width: usize,
    height: usize,
    /// Rows of red, green, blue, followed by [`PADDING`] bytes.
    rgb: Vec<u8>,
}

/// Bytes after the last pixel, so that sixteen bytes can be read from any of the last four.
const PADDING: usize = 16;

/// Pyramid of a window of a raw image.
#[derive(Clone, Debug, Default)]
pub(super) struct CameraImages {
    /// Position of level 0 in the raw image.
    pub(super) window: PixelWindow,
    /// Whether colours are left out, because the other camera has none.
    pub(super) is_grey: bool,
    pub(super) full: RgbPlane,
    /// The levels from 1 on; level 0 stays empty.
    pub(super) levels: [TexelPlane; LEVELS],
    mixed: Vec<f32>,
    line: Vec<Texel>,
}

impl CameraImages {
    /// Loads the part of `window` inside the image; allocates only if no previous window was as large.
    pub(super) fn update(&mut self, image: ImageView<'_>, window: PixelWindow, kernels: Kernels) {
        let window = aligned(window).clipped(image.width(), image.height());
        self.window = window;
        self.full.copy(image, window);
        if self.is_grey {
            self.full.leave_out_colours();
        }
        self.full.halve_into(&mut self.levels[1], &mut self.mixed, kernels);
        for level in 2..LEVELS {
            let (finer, coarser) = self.levels.split_at_mut(level);
            finer[level - 1].halve_into(&mut coarser[0], &mut self.line, kernels);
        }
    }

    /// Columns and rows of a level.
    pub(super) fn size(&self, level: usize) -> (usize, usize) {
        match level {
            0 => (self.full.width, self.full.height),
            _ => (self.levels[level].width, self.levels[level].height),
        }
    }

    /// A pixel of a level.
    pub(super) fn texel(&self, level: usize, x: usize, y: usize) -> Texel {
        match level {
            0 => {
                let at = 3 * (y * self.full.width + x);
                let [r, g, b] = [self.full.rgb[at], self.full.rgb[at + 1], self.full.rgb[at + 2]];
                let saturated = r.max(g).max(b) >= SATURATED_FROM;
                opponent([f32::from(r), f32::from(g), f32::from(b)], f32::from(u8::from(saturated)))
            }
            _ => self.levels[level].texels[y * self.levels[level].width + x],
        }
    }

    /// The texel at a sub-pixel position of a level; `None` if the kernel would extend beyond the border.
    #[inline(always)]
    pub(super) fn sample(&self, level: usize, x: f32, y: f32) -> Option<Texel> {
        if level == 0 { cubic_rgb(&self.full, x, y) } else { cubic(&self.levels[level], x, y) }
    }

    /// Allocates memory for whole images of this size.
    pub(super) fn reserve(&mut self, width: usize, height: usize) {
        for (level, plane) in self.levels.iter_mut().enumerate().skip(1) {
            plane.reserve(width >> level, height >> level);
        }
        self.full.rgb.reserve(3 * width * height + PADDING);
        self.mixed.reserve(3 * (width + 2));
        self.line.reserve(width + 2);
    }

    /// Origin of the window in raw pixels.
    pub(super) fn origin_px(&self) -> [f32; 2] {
        [self.window.x as f32, self.window.y as f32]
    }
}

/// Whether an image has no colours: red, green and blue of its pixels are equal.
pub(super) fn is_grey(image: ImageView<'_>) -> bool {
    /// Every so many rows are compared. Chosen by hand: a coloured scene has colours on some of them.
    const STEP: usize = 4;
    let mut row = vec![0; 3 * image.width() as usize];
    (0..image.height() as usize).step_by(STEP).all(|y| {
        image.copy_row(0, y, &mut row);
        row.as_chunks::<3>().0.iter().all(|[r, g, b]| r == g && g == b)
    })
}

/// The window extended to whole pixels of the coarsest level, so that the same target is always sampled in the same phase.
fn aligned(window: PixelWindow) -> PixelWindow {
    let step = 1_i32 << (LEVELS - 1);
    let (x, y) = (window.x.div_euclid(step) * step, window.y.div_euclid(step) * step);
    let grow = |length: usize, shift: i32| (length + shift as usize).div_ceil(step as usize) * step as usize;
    PixelWindow { x, y, width: grow(window.width, window.x - x), height: grow(window.height, window.y - y) }
}

impl TexelPlane {
    pub(super) fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        if self.texels.len() < width * height {
            self.texels.resize(width * height, [0.0; 4]);
        }
    }

    /// Allocates memory for a plane of this size.
    pub(super) fn reserve(&mut self, width: usize, height: usize) {
        self.texels.reserve((width * height).saturating_sub(self.texels.len()));
    }

    /// Writes the plane at half the size. The weights 1 3 3 1 along columns and rows preserve the positions of pixels and leave
    /// little aliasing at half the density. At the border the outermost pixels are replicated.
    fn halve_into(&self, out: &mut Self, line: &mut Vec<Texel>, kernels: Kernels) {
        out.resize(self.width / 2, self.height / 2);
        if line.len() < self.width + 2 {
            line.resize(self.width + 2, [0.0; 4]);
        }
        let width = out.width;
        if width == 0 {
            return;
        }
        for y in 0..out.height {
            let row = |y: usize| &self.texels[y * self.width..(y + 1) * self.width];
            let rows =
                [row((2 * y).saturating_sub(1)), row(2 * y), row(2 * y + 1), row((2 * y + 2).min(self.height - 1))];
            mix_rows(kernels, rows[0], rows[1], rows[2], rows[3], &mut line[1..=self.width]);
            (line[0], line[self.width + 1]) = (line[1], line[self.width]);
            halve_row(kernels, &line[..self.width + 2], &mut out.texels[y * width..(y + 1) * width]);
        }
    }
}

impl RgbPlane {
    fn copy(&mut self, image: ImageView<'_>, window: PixelWindow) {
        (self.width, self.height) = (window.width, window.height);
        let (row, bytes) = (3 * window.width, 3 * window.width * window.height + PADDING);
        if self.rgb.len() < bytes {
            self.rgb.resize(bytes, 0);
        }
        for (y, out) in window.rows().zip(self.rgb.chunks_exact_mut(row.max(1))) {
            image.copy_row(window.x as usize, y, out);
        }
    }

    fn leave_out_colours(&mut self) {
        let pixels = 3 * self.width * self.height;
        for pixel in self.rgb[..pixels].as_chunks_mut::<3>().0 {
            let sum: u16 = pixel.iter().map(|value| u16::from(*value)).sum();
            // The mean, rounded. Saturated colours stay saturated.
            let grey = ((sum + 1) / 3) as u8;
            let is_clipped = pixel.iter().any(|value| *value >= SATURATED_FROM);
            *pixel = [if is_clipped { u8::MAX } else { grey }; 3];
        }
    }

    /// As [`TexelPlane::halve_into`].
    fn halve_into(&self, out: &mut TexelPlane, line: &mut Vec<f32>, kernels: Kernels) {
        out.resize(self.width / 2, self.height / 2);
        let (length, width) = (3 * self.width, out.width);
        if line.len() < length + 6 {
            line.resize(length + 6, 0.0);
        }
        if width == 0 {
            return;
        }
        for y in 0..out.height {
            let row = |y: usize| &self.rgb[y * length..(y + 1) * length];
            let rows =
                [row((2 * y).saturating_sub(1)), row(2 * y), row(2 * y + 1), row((2 * y + 2).min(self.height - 1))];
            mix_rgb_rows(kernels, rows[0], rows[1], rows[2], rows[3], &mut line[3..length + 3]);
            for c in 0..3 {
                (line[c], line[length + 3 + c]) = (line[3 + c], line[length + c]);
            }
            halve_rgb_row(kernels, &line[..length + 6], &mut out.texels[y * width..(y + 1) * width]);
        }
    }
}

wide! {
    fn mix_rgb_rows(a: &[u8], b: &[u8], c: &[u8], d: &[u8], out: &mut [f32]) = mix_rgb_rows_kernel;
}

wide! {
    fn halve_rgb_row(line: &[f32], out: &mut [Texel]) = halve_rgb_row_kernel;
}

wide! {
    fn mix_rows(a: &[Texel], b: &[Texel], c: &[Texel], d: &[Texel], out: &mut [Texel]) = mix_rows_kernel;
}

wide! {
    fn halve_row(line: &[Texel], out: &mut [Texel]) = halve_row_kernel;
}

#[inline(always)]
fn mix_rgb_rows_kernel(a: &[u8], b: &[u8], c: &[u8], d: &[u8], out: &mut [f32]) {
    for ((((a, b), c), d), out) in a.iter().zip(b).zip(c).zip(d).zip(out) {
        let (outer, inner) = (i32::from(*a) + i32::from(*d), i32::from(*b) + i32::from(*c));
        *out = (outer + 3 * inner) as f32;
    }
}

/// `line` begins one pixel before the row.
#[inline(always)]
fn halve_rgb_row_kernel(line: &[f32], out: &mut [Texel]) {
    for (x, out) in out.iter_mut().enumerate() {
        let four = &line[6 * x..6 * x + 12];
        let rgb: [f32; 3] =
            std::array::from_fn(|c| ((four[c] + four[9 + c]) + 3.0 * (four[3 + c] + four[6 + c])) * (1.0 / 64.0));
        let saturated = rgb[0] >= SATURATED_MEAN || rgb[1] >= SATURATED_MEAN || rgb[2] >= SATURATED_MEAN;
        *out = opponent(rgb, f32::from(u8::from(saturated)));
    }
}

/// A pixel mean of at least this brightness contains saturated pixels, or nearly saturated ones. Chosen by hand, not
/// varied: with more, clipped values count; with less, bright pixels are lost.
const SATURATED_MEAN: f32 = 250.0;

#[inline(always)]
fn opponent(rgb: [f32; 3], saturated: f32) -> Texel {
    let turn = |row: &[f32; 3]| row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2];
    [turn(&OPPONENT_FROM_RGB[0]), turn(&OPPONENT_FROM_RGB[1]), turn(&OPPONENT_FROM_RGB[2]), saturated]
}

#[inline(always)]
fn mix_rows_kernel(a: &[Texel], b: &[Texel], c: &[Texel], d: &[Texel], out: &mut [Texel]) {
    for ((((a, b), c), d), out) in a.iter().zip(b).zip(c).zip(d).zip(out) {
        for i in 0..4 {
            out[i] = 0.125 * (a[i] + d[i]) + 0.375 * (b[i] + c[i]);
        }
    }
}

/// `line` begins one pixel before the row.
#[inline(always)]
fn halve_row_kernel(line: &[Texel], out: &mut [Texel]) {
    for (x, out) in out.iter_mut().enumerate() {
        let four = &line[2 * x..2 * x + 4];
        for i in 0..4 {
            out[i] = 0.125 * (four[0][i] + four[3][i]) + 0.375 * (four[1][i] + four[2][i]);
        }
    }
}

/// The texel at a raw pixel of a level, for storing views.
pub(super) fn texel_at(images: &CameraImages, level: usize, pixel: [f32; 2]) -> Option<Texel> {
    let origin_px = images.origin_px();
    let factor = 1.0 / (1_u32 << level) as f32;
    let [x, y] = std::array::from_fn(|i| (pixel[i] - origin_px[i] + 0.5) * factor - 0.5);
    images.sample(level, x, y)
}

/// The texel at a sub-pixel position, smoothed by a cubic B-spline (standard deviation 0.58 px in each direction, independent
/// of the sub-pixel position); `None` if the kernel would extend beyond the border.
///
/// There are far fewer points than pixels. An interpolating kernel would give each point the noise of one pixel, which would
/// vary with the sub-pixel position.
#[inline(always)]
fn cubic(plane: &TexelPlane, x: f32, y: f32) -> Option<Texel> {
    let (column, row) = (x.floor(), y.floor());
    if !(column >= 1.0 && row >= 1.0 && column <= plane.width as f32 - 3.0 && row <= plane.height as f32 - 3.0) {
        return None;
    }
    let (columns, rows) = (b_spline(x - column), b_spline(y - row));
    let start = (row as usize - 1) * plane.width + column as usize - 1;
    // Four texels of four channels are sixteen lanes: the rows are combined first, then the columns.
    let mut mixed = [0.0_f32; 16];
    for (j, weight) in rows.iter().enumerate() {
        let line = plane.texels[start + j * plane.width..].first_chunk::<4>()?.as_flattened();
        for (mixed, value) in mixed.iter_mut().zip(line) {
            *mixed += weight * value;
        }
    }
    let weighted: [f32; 16] = std::array::from_fn(|i| mixed[i] * columns[i / 4]);
    Some(std::array::from_fn(|c| (weighted[c] + weighted[4 + c]) + (weighted[8 + c] + weighted[12 + c])))
}

/// As [`cubic`], from bytes.
#[inline(always)]
fn cubic_rgb(plane: &RgbPlane, x: f32, y: f32) -> Option<Texel> {
    let (column, row) = (x.floor(), y.floor());
    if !(column >= 1.0 && row >= 1.0 && column <= plane.width as f32 - 3.0 && row <= plane.height as f32 - 3.0) {
        return None;
    }
    let (columns, rows) = (b_spline(x - column), b_spline(y - row));
    let start = 3 * ((row as usize - 1) * plane.width + column as usize - 1);
    // Four pixels of three bytes are twelve of sixteen lanes: the rows are combined first, then the columns.
    let (mut mixed, mut brightest) = ([0.0_f32; 16], [0_u8; 16]);
    for (j, weight) in rows.iter().enumerate() {
        let line = plane.rgb[start + 3 * j * plane.width..].first_chunk::<16>()?;
        for i in 0..16 {
            mixed[i] += weight * f32::from(line[i]);
            brightest[i] = brightest[i].max(line[i]);
        }
    }
    let mut saturated = 0;
    for (i, brightest) in brightest.iter().enumerate() {
        saturated |= CLIPPED[i % 3] * u8::from(i < 12 && *brightest >= SATURATED_FROM);
    }
    let rgb = std::array::from_fn(|c| {
        (mixed[c] * columns[0] + mixed[3 + c] * columns[1]) + (mixed[6 + c] * columns[2] + mixed[9 + c] * columns[3])
    });
    Some(opponent(rgb, f32::from(saturated)))
}

/// Weights of the cubic B-spline over four pixels; `t` is the position between the inner two, 0 to 1.
#[inline(always)]
fn b_spline(t: f32) -> [f32; 4] {
    let (s, t2, t3) = (1.0 - t, t * t, t * t * t);
    let inner = 3.0 * (t - t3);
    [s * s * s, 4.0 + 3.0 * (t3 - 2.0 * t2), 1.0 + inner + 3.0 * t2, t3].map(|w| w * (1.0 / 6.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_read_from_around_it_and_just_as_smooth_wherever_it_is() {
        for step in 0..=20_u8 {
            let t = f32::from(step) / 20.0;
            let moment = |power: i32| {
                let places = [-1.0, 0.0, 1.0, 2.0].map(|x: f32| (x - t).powi(power));
                b_spline(t).iter().zip(places).map(|(w, x)| w * x).sum::<f32>()
            };
            assert!((moment(0) - 1.0).abs() < 1e-6 && moment(1).abs() < 1e-6, "{t}: weights and mean");
            assert!((moment(2) - 1.0 / 3.0).abs() < 1e-6, "{t}: variance {}", moment(2));
        }
    }

    #[test]
    fn a_point_has_a_fraction_of_the_noise_of_a_pixel_everywhere() {
        for step in 0..=20_u8 {
            let noise: f32 = b_spline(f32::from(step) / 20.0).iter().map(|w| w * w).sum();
            assert!(noise * noise < 0.26, "{step}: {}", noise * noise);
        }
    }
}
