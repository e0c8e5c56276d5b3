//! Moves the rows of an image by a fraction of a pixel.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::{LANES, wide};

use super::colour_planes::{ColourPlanes, UNSEEN, Wanted};
use super::image_plane::ImagePlane;
use pb3dp_estimation_core::row_offset::RowOffset;

/// Number of columns moved by the same offset.
pub const BLOCK: usize = 2 * LANES;

/// Writes `source` into `out` so that row `v` shows `source` at row `v + offset`. The rows are interpolated with a cubic
/// kernel, and pixels without a source row are flagged as unseen.
pub fn shift_rows(source: &ColourPlanes, rows: &RowOffset, kernels: Kernels, out: &mut ColourPlanes) {
    let window = source.window;
    let wanted = if source.planes[1].width() > 0 { Wanted::Colour } else { Wanted::Luminance };
    out.resize(window, wanted);
    let flagged = source.flags.iter().fold(0, |all, flag| all | flag) != 0;
    let last = window.height as f64 - 1.0;
    let step = rows.slope.x * BLOCK as f64;
    for y in 0..window.height {
        // Offset of the first block, at the centre of its columns; each further block adds a step.
        let centre = Vector2::new(f64::from(window.x) + (BLOCK - 1) as f64 / 2.0, f64::from(window.y) + y as f64);
        let first = y as f64 + rows.at(&centre);
        let sources = source.planes.each_ref().map(ImagePlane::values);
        let out_rows = out.planes.each_mut().map(|plane| if plane.width() > 0 { plane.row_mut(y) } else { &mut [] });
        shift_row(kernels, sources, window.width, window.height, first, step, out_rows);
        let blocks = window.width.div_ceil(BLOCK);
        let ends = [first, first + step * blocks.saturating_sub(1) as f64].map(f64::round);
        let flags = &mut out.flags[y * window.width..][..window.width];
        if !flagged && ends.iter().all(|row| (0.0..=last).contains(row)) {
            flags.fill(0);
            continue;
        }
        for (block, flags) in flags.chunks_mut(BLOCK).enumerate() {
            let row = (first + step * block as f64).round();
            match (0.0..=last).contains(&row) {
                true => {
                    let from = row as usize * window.width + block * BLOCK;
                    flags.copy_from_slice(&source.flags[from..][..flags.len()]);
                }
                false => flags.fill(UNSEEN),
            }
        }
    }
}

wide! {
    /// One row of all planes, whose blocks are at the fractional rows `first`, `first + step`, ...; rows beyond the border
    /// replicate the border.
    fn shift_row(sources: [&[f32]; 3], width: usize, height: usize, first: f64, step: f64, out: [&mut [f32]; 3]) = shift_row_kernel;
}

#[inline(always)]
fn shift_row_kernel(
    sources: [&[f32]; 3],
    width: usize,
    height: usize,
    first: f64,
    step: f64,
    mut out: [&mut [f32]; 3],
) {
    let last = height as i64 - 1;
    for block in 0..width.div_ceil(BLOCK) {
        let at = (first + step * block as f64).clamp(0.0, last as f64);
        let floor = at as i64;
        let weights = keys((at - floor as f64) as f32);
        let (start, count) = (block * BLOCK, BLOCK.min(width - block * BLOCK));
        let rows = [-1, 0, 1, 2].map(|i| (floor + i).clamp(0, last) as usize * width + start);
        for (source, out) in sources.iter().zip(&mut out) {
            if out.is_empty() {
                continue;
            }
            let [a, b, c, d] = rows.map(|row| &source[row..row + count]);
            let out = &mut out[start..start + count];
            match (a.first_chunk::<BLOCK>(), b.first_chunk(), c.first_chunk(), d.first_chunk(), out.first_chunk_mut()) {
                (Some(a), Some(b), Some(c), Some(d), Some(out)) => mix([a, b, c, d], weights, out),
                _ => {
                    for (i, out) in out.iter_mut().enumerate() {
                        mix([&[a[i]], &[b[i]], &[c[i]], &[d[i]]], weights, std::array::from_mut(out));
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn mix<const N: usize>([a, b, c, d]: [&[f32; N]; 4], weights: [f32; 4], out: &mut [f32; N]) {
    for i in 0..N {
        out[i] = (weights[0] * a[i] + weights[1] * b[i]) + (weights[2] * c[i] + weights[3] * d[i]);
    }
}

/// Weights of the four rows at -1, 0, 1, 2 for a position `t` in 0..1 (Keys 1981, a = -1/2).
#[inline(always)]
pub fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (2.0 * t2 - t - t3), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (4.0 * t2 + t - 3.0 * t3), 0.5 * (t3 - t2)]
}
