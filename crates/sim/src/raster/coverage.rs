//! Edge pixels, sampled sixteen times.

use super::shade::shade_run;
use super::triangle::ScreenTriangle;
use super::view::View;
use super::visibility::{NOTHING, TRIANGLE_BITS, Visibility, triangle_code, triangle_index};
use crate::scene::ScenePart;

/// Samples per edge pixel.
const SAMPLES: usize = 16;

/// Places of the samples within the pixel, in 32nds of a pixel from its centre: each sixteenth of the width and of the height
/// holds exactly one, and the pattern is its own mirror image through the centre, so edges are not shifted.
const SAMPLE_U: [f32; SAMPLES] =
    [-15.0, -13.0, -11.0, -9.0, -7.0, -5.0, -3.0, -1.0, 1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0];
/// Rows of the samples; the bit-reversed order of the columns.
const SAMPLE_V: [f32; SAMPLES] =
    [-15.0, 1.0, -7.0, 9.0, -11.0, 5.0, -3.0, 13.0, -13.0, 3.0, -5.0, 11.0, -9.0, 7.0, -1.0, 15.0];

/// The edge pixels of one picture and what their samples see.
#[derive(Clone, Debug, Default)]
pub(crate) struct EdgePixels {
    /// Columns of all edge pixels, row by row.
    columns: Vec<u16>,
    /// Where each row begins in `columns`; one more than there are rows.
    row_starts: Vec<usize>,
    samples: Vec<Samples>,
}

#[derive(Clone, Debug)]
struct Samples {
    inv_z: [f32; SAMPLES],
    seen: [u32; SAMPLES],
}

impl EdgePixels {
    /// Finds the edge pixels and what their samples see.
    pub(crate) fn resolve(&mut self, view: &View, visibility: &Visibility, triangles: &[ScreenTriangle]) {
        self.columns.clear();
        self.row_starts.clear();
        for row in 0..view.height {
            self.row_starts.push(self.columns.len());
            visibility.find_edges(view, row, &mut self.columns);
        }
        self.row_starts.push(self.columns.len());
        self.samples.clear();
        self.samples.resize(self.columns.len(), Samples { inv_z: [0.0; SAMPLES], seen: [NOTHING; SAMPLES] });
        for (index, triangle) in triangles.iter().enumerate() {
            self.draw(view, triangle, triangle_code(triangle.part, index));
        }
    }

    fn draw(&mut self, view: &View, triangle: &ScreenTriangle, code: u32) {
        for row in triangle.pixels.y.0..triangle.pixels.y.1 {
            let start = self.row_starts[row];
            let columns = &self.columns[start..self.row_starts[row + 1]];
            let first = columns.partition_point(|&column| usize::from(column) < triangle.pixels.x.0);
            for (offset, &column) in columns.iter().enumerate().skip(first) {
                if usize::from(column) >= triangle.pixels.x.1 {
                    break;
                }
                draw_pixel(view, triangle, code, (usize::from(column), row), &mut self.samples[start + offset]);
            }
        }
    }

    /// Writes the colours of all edge pixels: the mean of their samples, each surface shaded at the centre of its samples.
    pub(crate) fn shade(
        &self,
        view: &View,
        parts: &[ScenePart],
        triangles: &[ScreenTriangle],
        empty: [u16; 3],
        out: &mut [u16],
    ) {
        for row in 0..view.height {
            for index in self.row_starts[row]..self.row_starts[row + 1] {
                let column = usize::from(self.columns[index]);
                let colour = mean_colour(view, (column, row), &self.samples[index], parts, triangles, empty);
                let at = 3 * (row * view.width + column);
                out[at..at + 3].copy_from_slice(&colour);
            }
        }
    }
}

fn draw_pixel(view: &View, triangle: &ScreenTriangle, code: u32, pixel: (usize, usize), samples: &mut Samples) {
    let (x, y) = centre_ray(view, pixel);
    let slopes = view.ray_slopes(pixel.0, pixel.1).map(|slope| slope / 32.0);
    let along = |plane: &super::triangle::Plane| {
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
        let hit = (e0.min(e1).min(e2) >= 0.0) & (nearness > samples.inv_z[i]);
        samples.inv_z[i] = if hit { nearness } else { samples.inv_z[i] };
        samples.seen[i] = if hit { code } else { samples.seen[i] };
    }
}

fn mean_colour(
    view: &View,
    pixel: (usize, usize),
    samples: &Samples,
    parts: &[ScenePart],
    triangles: &[ScreenTriangle],
    empty: [u16; 3],
) -> [u16; 3] {
    let slopes = view.ray_slopes(pixel.0, pixel.1);
    let (x, y) = centre_ray(view, pixel);
    let (mut sum, mut todo) = ([0u32; 3], (1u32 << SAMPLES) - 1);
    while todo != 0 {
        let code = samples.seen[todo.trailing_zeros() as usize];
        let (mut count, mut u, mut v) = (0u32, 0.0f32, 0.0f32);
        for i in (0..SAMPLES).filter(|i| samples.seen[*i] >> TRIANGLE_BITS == code >> TRIANGLE_BITS) {
            todo &= !(1 << i);
            count += 1;
            u += SAMPLE_U[i];
            v += SAMPLE_V[i];
        }
        let mut colour = empty;
        if code != NOTHING {
            let (u, v) = (u / (32 * count) as f32, v / (32 * count) as f32);
            let ray = (x + slopes[0] * u + slopes[1] * v, y + slopes[2] * u + slopes[3] * v);
            let triangle = &triangles[triangle_index(code)];
            let texture = &parts[usize::from(triangle.part)].texture;
            shade_run(triangle, texture, view.pixel_size, (&[ray.0], &[ray.1]), &mut colour);
        }
        for (sum, channel) in sum.iter_mut().zip(colour) {
            *sum += count * u32::from(channel);
        }
    }
    sum.map(|channel| (channel / SAMPLES as u32) as u16)
}

fn centre_ray(view: &View, pixel: (usize, usize)) -> (f32, f32) {
    let at = pixel.1 * view.width + pixel.0;
    (view.ray_x[at], view.ray_y[at])
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
