//! Moves the rows of an image by a fraction of a pixel.

use nalgebra::Vector2;

use super::colour_planes::{ColourPlanes, UNSEEN, Wanted};
use super::image_plane::ImagePlane;
use super::row_offset::RowOffset;
use crate::cpu::Kernels;
use crate::wide::{LANES, wide};

/// Columns that are moved by one and the same offset.
const BLOCK: usize = 2 * LANES;

/// Writes `source` into `out` so that row `v` holds what `source` shows at row `v + offset`: cubic between rows, flagged as
/// unseen where `source` has no such row.
pub(super) fn shift_rows(source: &ColourPlanes, rows: &RowOffset, kernels: Kernels, out: &mut ColourPlanes) {
    let window = source.window;
    let wanted = if source.planes[1].width() > 0 { Wanted::Colour } else { Wanted::Luminance };
    out.resize(window, wanted);
    for y in 0..window.height {
        for first in (0..window.width).step_by(BLOCK) {
            let end = (first + BLOCK).min(window.width);
            let centre =
                Vector2::new(f64::from(window.x) + (first + end - 1) as f64 / 2.0, f64::from(window.y) + y as f64);
            let at = y as f64 + rows.at(&centre);
            for (source, out) in source.planes.iter().zip(&mut out.planes).filter(|(source, _)| source.width() > 0) {
                shift_block(source, at, (first, end), kernels, &mut out.row_mut(y)[first..end]);
            }
            let row = at.round();
            let inside = row >= 0.0 && row < window.height as f64;
            let flags = &mut out.flags[y * window.width..][first..end];
            match inside {
                true => flags.copy_from_slice(&source.flags[row as usize * window.width..][first..end]),
                false => flags.fill(UNSEEN),
            }
        }
    }
}

/// One row's block at the fractional row `at`; rows beyond the border repeat the border.
fn shift_block(source: &ImagePlane, at: f64, (first, end): (usize, usize), kernels: Kernels, out: &mut [f32]) {
    let last = source.height() as f64 - 1.0;
    let at = at.clamp(0.0, last);
    let floor = at.floor();
    let row = |i: f64| &source.row((floor + i).clamp(0.0, last) as usize)[first..end];
    let weights = keys((at - floor) as f32);
    mix_rows(kernels, [row(-1.0), row(0.0), row(1.0), row(2.0)], weights, out);
}

wide! {
    fn mix_rows(rows: [&[f32]; 4], weights: [f32; 4], out: &mut [f32]) = mix_rows_kernel;
}

#[inline(always)]
fn mix_rows_kernel(rows: [&[f32]; 4], weights: [f32; 4], out: &mut [f32]) {
    let [a, b, c, d] = rows;
    for ((((out, a), b), c), d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        *out = (weights[0] * a + weights[1] * b) + (weights[2] * c + weights[3] * d);
    }
}

/// Weights of the four rows at -1, 0, 1, 2 for a place `t` in 0..1 (Keys 1981, a = -1/2).
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (2.0 * t2 - t - t3), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (4.0 * t2 + t - 3.0 * t3), 0.5 * (t3 - t2)]
}
