//! Edge pixels, sampled sixteen times.

use pb3dp_computing::wide;

use super::shade::{Scratch, shade_run};
use super::triangle::{Plane, ScreenTriangle};
use super::view::View;
use super::visibility::{NOTHING, TRIANGLE_BITS, Visibility, triangle_code, triangle_index};
use super::{EMPTY, ShadingInput};
use crate::wide::kernels;

/// Samples per edge pixel.
const SAMPLES: usize = 16;

/// Positions of the samples within the pixel, in 32nds of a pixel from its centre. Each sixteenth of the width and of the height
/// contains exactly one sample, and the pattern is point-symmetric about the centre, so edges are not shifted.
const SAMPLE_U: [f32; SAMPLES] =
    [-15.0, -13.0, -11.0, -9.0, -7.0, -5.0, -3.0, -1.0, 1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0];
/// Rows of the samples; the bit-reversed order of the columns.
const SAMPLE_V: [f32; SAMPLES] =
    [-15.0, 1.0, -7.0, 9.0, -11.0, 5.0, -3.0, 13.0, -13.0, 3.0, -5.0, 11.0, -9.0, 7.0, -1.0, 15.0];

/// The edge pixels of one image and the surfaces visible at their samples.
#[derive(Clone, Debug, Default)]
pub(crate) struct EdgePixels {
    /// Columns of all edge pixels, row by row.
    columns: Vec<u16>,
    /// Start of each row in `columns`; one more entry than rows.
    row_starts: Vec<usize>,
    samples: Vec<Samples>,
}

#[derive(Clone, Debug)]
struct Samples {
    /// Ray of the pixel centre and its change per pixel (see [`View::ray_slopes`]).
    ray: [f32; 2],
    ray_slopes: [f32; 4],
    inv_z: [f32; SAMPLES],
    visible: [u32; SAMPLES],
}

impl Samples {
    fn unseen(view: &View, column: usize, row: usize) -> Self {
        let at = row * view.width + column;
        Self {
            ray: [view.ray_x[at], view.ray_y[at]],
            ray_slopes: view.ray_slopes(column, row),
            inv_z: [0.0; SAMPLES],
            visible: [NOTHING; SAMPLES],
        }
    }
}

impl EdgePixels {
    /// Finds the edge pixels and the surfaces visible at their samples.
    pub(crate) fn resolve(&mut self, view: &View, visibility: &Visibility, triangles: &[ScreenTriangle]) {
        resolve(kernels(), self, view, visibility, triangles);
    }

    #[inline(always)]
    fn resolve_kernel(&mut self, view: &View, visibility: &Visibility, triangles: &[ScreenTriangle]) {
        self.columns.clear();
        self.row_starts.clear();
        self.samples.clear();
        for row in 0..view.height {
            self.row_starts.push(self.columns.len());
            visibility.find_edges(view, row, &mut self.columns);
            let columns = &self.columns[self.row_starts[row]..];
            self.samples.extend(columns.iter().map(|&column| Samples::unseen(view, usize::from(column), row)));
        }
        self.row_starts.push(self.columns.len());
        for (index, triangle) in triangles.iter().enumerate() {
            self.draw(triangle, triangle_code(triangle.part, index));
        }
    }

    #[inline(always)]
    fn draw(&mut self, triangle: &ScreenTriangle, code: u32) {
        for row in triangle.pixels.y.0..triangle.pixels.y.1 {
            let start = self.row_starts[row];
            let columns = &self.columns[start..self.row_starts[row + 1]];
            let first = columns.partition_point(|&column| usize::from(column) < triangle.pixels.x.0);
            for (offset, &column) in columns.iter().enumerate().skip(first) {
                if usize::from(column) >= triangle.pixels.x.1 {
                    break;
                }
                draw_pixel(triangle, code, &mut self.samples[start + offset]);
            }
        }
    }

    /// Writes the colours of all edge pixels: the mean of the samples, with each surface shaded at the centre of its samples.
    pub(crate) fn shade(&self, visible: &ShadingInput<'_>, out: &mut [u16]) {
        let mut scratch = Scratch::new();
        for row in 0..visible.view.height {
            for index in self.row_starts[row]..self.row_starts[row + 1] {
                let at = 3 * (row * visible.view.width + usize::from(self.columns[index]));
                out[at..at + 3].copy_from_slice(&mean_colour(&self.samples[index], visible, &mut scratch));
            }
        }
    }
}

wide! {
    fn resolve(edges: &mut EdgePixels, view: &View, visibility: &Visibility, triangles: &[ScreenTriangle])
        = EdgePixels::resolve_kernel;
}

#[inline(always)]
fn draw_pixel(triangle: &ScreenTriangle, code: u32, samples: &mut Samples) {
    let ([x, y], slopes) = (samples.ray, samples.ray_slopes.map(|slope| slope / 32.0));
    let along = |plane: &Plane| {
        (plane.at(x, y), plane.a * slopes[0] + plane.b * slopes[2], plane.a * slopes[1] + plane.b * slopes[3])
    };
    let edges = triangle.edges.each_ref().map(along);
    if edges.iter().any(|(centre, du, dv)| centre + 15.0 * (du.abs() + dv.abs()) < 0.0) {
        return;
    }
    let (depth, depth_du, depth_dv) = along(&triangle.inv_z);
    for i in 0..SAMPLES {
        let (u, v) = (SAMPLE_U[i], SAMPLE_V[i]);
        let [e0, e1, e2] = edges.map(|(centre, du, dv)| centre + du * u + dv * v);
        let nearness = depth + depth_du * u + depth_dv * v;
        let hit = (e0 >= 0.0) & (e1 >= 0.0) & (e2 >= 0.0) & (nearness > samples.inv_z[i]);
        let mask = u32::from(hit).wrapping_neg();
        samples.inv_z[i] = f32::from_bits((nearness.to_bits() & mask) | (samples.inv_z[i].to_bits() & !mask));
        samples.visible[i] = (code & mask) | (samples.visible[i] & !mask);
    }
}

fn mean_colour(samples: &Samples, visible: &ShadingInput<'_>, scratch: &mut Scratch) -> [u16; 3] {
    let ([x, y], slopes) = (samples.ray, samples.ray_slopes);
    let (mut sum, mut todo) = ([0u32; 3], (1u32 << SAMPLES) - 1);
    while todo != 0 {
        let code = samples.visible[todo.trailing_zeros() as usize];
        let (mut count, mut u, mut v) = (0u32, 0.0f32, 0.0f32);
        for i in (0..SAMPLES).filter(|&i| samples.visible[i] >> TRIANGLE_BITS == code >> TRIANGLE_BITS) {
            todo &= !(1 << i);
            count += 1;
            u += SAMPLE_U[i];
            v += SAMPLE_V[i];
        }
        let mut colour = EMPTY;
        if code != NOTHING {
            let (u, v) = (u / (32 * count) as f32, v / (32 * count) as f32);
            let ray = (x + slopes[0] * u + slopes[1] * v, y + slopes[2] * u + slopes[3] * v);
            let triangle = &visible.triangles[triangle_index(code)];
            let texture = &visible.parts[usize::from(triangle.part)].texture;
            shade_run(triangle, texture, visible.view.pixel_size, (&[ray.0], &[ray.1]), scratch, &mut colour);
        }
        for (sum, channel) in sum.iter_mut().zip(colour) {
            *sum += count * u32::from(channel);
        }
    }
    sum.map(|channel| (channel / SAMPLES as u32) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_every_row_and_column_once_and_mirror() {
        let mut rows = SAMPLE_V.to_vec();
        rows.sort_by(f32::total_cmp);
        assert_eq!(rows, SAMPLE_U.to_vec());
        for i in 0..SAMPLES {
            assert_eq!(SAMPLE_U[i], -SAMPLE_U[SAMPLES - 1 - i]);
            assert_eq!(SAMPLE_V[i], -SAMPLE_V[SAMPLES - 1 - i]);
        }
    }
}
