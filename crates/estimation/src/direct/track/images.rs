//! The window of one raw image that a frame looks at, as a pyramid that is quick to sample between pixels.

use image::RgbImage;

use super::super::colour_planes::{OPPONENT_FROM_RGB, SATURATED_FROM};
use super::super::image_plane::PixelWindow;
use crate::cpu::Kernels;
use crate::wide::wide;

/// Levels of the pyramids: 1, 1/2, 1/4 and 1/8 of the resolution.
pub(super) const LEVELS: usize = 4;

/// Y, A, B' (see [`colour_planes`](super::super::colour_planes)) and the share of saturated pixels.
pub(super) type Texel = [f32; 4];

/// One level.
#[derive(Clone, Debug, Default)]
pub(super) struct TexelPlane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) texels: Vec<Texel>,
}

/// A window of a raw image and its halves.
#[derive(Clone, Debug, Default)]
pub(super) struct EyeImages {
    /// Where level 0 lies in the raw image.
    pub(super) window: PixelWindow,
    pub(super) levels: [TexelPlane; LEVELS],
    line: Vec<Texel>,
}

impl EyeImages {
    /// Takes the part of `window` inside the image; allocates only if no window was ever as large.
    pub(super) fn update(&mut self, image: &RgbImage, window: PixelWindow, kernels: Kernels) {
        let window = aligned(window).clipped(image.width(), image.height());
        self.window = window;
        self.levels[0].resize(window.width, window.height);
        let stride = image.width() as usize * 3;
        for y in 0..window.height {
            let start = (window.y as usize + y) * stride + window.x as usize * 3;
            let rgb = &image.as_raw()[start..start + window.width * 3];
            convert_row(kernels, rgb, &mut self.levels[0].texels[y * window.width..(y + 1) * window.width]);
        }
        for level in 1..LEVELS {
            let (finer, coarser) = self.levels.split_at_mut(level);
            finer[level - 1].halve_into(&mut coarser[0], &mut self.line, kernels);
        }
    }

    /// Makes room for whole images of this size.
    pub(super) fn reserve(&mut self, width: usize, height: usize) {
        for (level, plane) in self.levels.iter_mut().enumerate() {
            plane.reserve(width >> level, height >> level);
        }
        self.line.reserve(width + 2);
    }

    /// Origin of the window in raw pixels.
    pub(super) fn origin_px(&self) -> [f32; 2] {
        [self.window.x as f32, self.window.y as f32]
    }
}

/// The window grown to whole pixels of the coarsest level, so that the same target is sampled in the same phase.
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

    /// Makes room for a plane of this size.
    pub(super) fn reserve(&mut self, width: usize, height: usize) {
        self.texels.reserve((width * height).saturating_sub(self.texels.len()));
    }

    /// The plane at half the size: weights 1 3 3 1 along columns and rows, which keep the places of pixels and leave little
    /// that a grid of half the density would fold back. At the border the outermost pixels are repeated.
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

wide! {
    fn convert_row(rgb: &[u8], out: &mut [Texel]) = convert_row_kernel;
}

wide! {
    fn mix_rows(a: &[Texel], b: &[Texel], c: &[Texel], d: &[Texel], out: &mut [Texel]) = mix_rows_kernel;
}

wide! {
    fn halve_row(line: &[Texel], out: &mut [Texel]) = halve_row_kernel;
}

#[inline(always)]
fn convert_row_kernel(rgb: &[u8], out: &mut [Texel]) {
    for (rgb, out) in rgb.chunks_exact(3).zip(out) {
        *out = texel_of(rgb[0], rgb[1], rgb[2]);
    }
}

#[inline(always)]
fn texel_of(r: u8, g: u8, b: u8) -> Texel {
    let saturated = f32::from(u8::from(r.max(g).max(b) >= SATURATED_FROM));
    let (r, g, b) = (f32::from(r), f32::from(g), f32::from(b));
    let turn = |row: &[f32; 3]| row[0] * r + row[1] * g + row[2] * b;
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

/// The texel at a place between pixel centres with a cubic kernel (Keys 1981, a = -1/2); `None` where the kernel would
/// reach over the border.
#[inline(always)]
pub(super) fn cubic(plane: &TexelPlane, x: f32, y: f32) -> Option<Texel> {
    let (column, row) = (x.floor(), y.floor());
    if !(column >= 1.0 && row >= 1.0 && column <= plane.width as f32 - 3.0 && row <= plane.height as f32 - 3.0) {
        return None;
    }
    let (columns, rows) = (keys(x - column), keys(y - row));
    let start = (row as usize - 1) * plane.width + column as usize - 1;
    let mut sum = [0.0; 4];
    for (j, weight) in rows.iter().enumerate() {
        let line = &plane.texels[start + j * plane.width..][..4];
        for c in 0..4 {
            let value = (columns[0] * line[0][c] + columns[1] * line[1][c])
                + (columns[2] * line[2][c] + columns[3] * line[3][c]);
            sum[c] += weight * value;
        }
    }
    Some(sum)
}

#[inline(always)]
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (2.0 * t2 - t - t3), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (4.0 * t2 + t - 3.0 * t3), 0.5 * (t3 - t2)]
}
