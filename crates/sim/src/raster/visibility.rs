//! The triangle visible at each pixel centre, and the edge pixels.

use pb3dp_computing::wide;

use super::triangle::ScreenTriangle;
use super::view::{BLOCK, View};
use crate::wide::kernels;

/// No triangle.
pub(crate) const NOTHING: u32 = u32::MAX;

/// Bits of a [`Visibility::visible`] entry below the part index.
pub(crate) const TRIANGLE_BITS: u32 = 20;

/// Neighbouring pixels of one surface whose inverse depths differ by more than this share are an edge.
const DEPTH_STEP: f32 = 0.005;

/// The visible surface at every pixel centre.
#[derive(Clone, Debug)]
pub(crate) struct Visibility {
    /// 1 / depth, 0 where no surface is visible.
    pub(crate) inv_z: Vec<f32>,
    /// Part index and triangle index (see [`TRIANGLE_BITS`]), or [`NOTHING`].
    pub(crate) visible: Vec<u32>,
}

impl Visibility {
    pub(crate) fn new(pixels: usize) -> Self {
        Self { inv_z: vec![0.0; pixels], visible: vec![NOTHING; pixels] }
    }

    /// Finds the nearest triangle of every pixel centre.
    pub(crate) fn draw(&mut self, view: &View, triangles: &[ScreenTriangle]) {
        self.inv_z.fill(0.0);
        self.visible.fill(NOTHING);
        draw_triangles(kernels(), self, view, triangles);
    }

    /// Whether a pixel and one of its eight neighbours see different surfaces.
    fn is_edge(&self, view: &View, column: usize, row: usize) -> bool {
        let here = row * view.width + column;
        let (part, depth) = (self.visible[here] >> TRIANGLE_BITS, self.inv_z[here]);
        let columns = column.saturating_sub(1)..(column + 2).min(view.width);
        (row.saturating_sub(1)..(row + 2).min(view.height)).any(|r| {
            columns.clone().any(|c| {
                let there = r * view.width + c;
                self.visible[there] >> TRIANGLE_BITS != part || (self.inv_z[there] - depth).abs() > DEPTH_STEP * depth
            })
        })
    }

    /// Lists the columns of a row's edge pixels, in order.
    #[inline(always)]
    pub(crate) fn find_edges(&self, view: &View, row: usize, columns: &mut Vec<u16>) {
        for first in (0..view.width).step_by(BLOCK) {
            let end = (first + BLOCK).min(view.width);
            if !self.is_plain(view, row, first, end) {
                columns.extend((first..end).filter(|&column| self.is_edge(view, column, row)).map(|c| c as u16));
            }
        }
    }

    /// Whether a block of a row and its surroundings see one triangle only (whose parts cannot occlude each other).
    #[inline(always)]
    fn is_plain(&self, view: &View, row: usize, first: usize, end: usize) -> bool {
        let reference = self.visible[row * view.width + first];
        let (from, to) = (first.saturating_sub(1), (end + 1).min(view.width));
        (row.saturating_sub(1)..(row + 2).min(view.height)).all(|r| {
            let block = &self.visible[r * view.width + from..r * view.width + to];
            block.iter().fold(0, |different, &visible| different | (visible ^ reference)) == 0
        })
    }
}

wide! {
    fn draw_triangles(out: &mut Visibility, view: &View, triangles: &[ScreenTriangle]) = draw_triangles_kernel;
}

#[inline(always)]
fn draw_triangles_kernel(out: &mut Visibility, view: &View, triangles: &[ScreenTriangle]) {
    for (index, triangle) in triangles.iter().enumerate() {
        let code = triangle_code(triangle.part, index);
        let (first, end) = triangle.pixels.x;
        for row in triangle.pixels.y.0..triangle.pixels.y.1 {
            let mut column = first;
            while column < end {
                let block_end = if end - first <= BLOCK { end } else { ((column / BLOCK + 1) * BLOCK).min(end) };
                let cover = if end - first <= BLOCK { Cover::Part } else { cover(triangle, view, column, row) };
                let span = row * view.width + column..row * view.width + block_end;
                let rays = (&view.ray_x[span.clone()], &view.ray_y[span.clone()]);
                let out = (&mut out.inv_z[span.clone()], &mut out.visible[span]);
                match cover {
                    Cover::None => {}
                    Cover::Part => draw_span::<false>(triangle, code, rays, out),
                    Cover::Whole => draw_span::<true>(triangle, code, rays, out),
                }
                column = block_end;
            }
        }
    }
}

/// Possible coverage of a block by a triangle.
enum Cover {
    None,
    Part,
    Whole,
}

#[inline(always)]
fn cover(triangle: &ScreenTriangle, view: &View, column: usize, row: usize) -> Cover {
    let rays = view.block(column, row);
    let [(low0, high0), (low1, high1), (low2, high2)] = triangle.edges.each_ref().map(|edge| edge.bounds(rays));
    if (high0 < 0.0) | (high1 < 0.0) | (high2 < 0.0) {
        Cover::None
    } else if (low0 >= 0.0) & (low1 >= 0.0) & (low2 >= 0.0) {
        Cover::Whole
    } else {
        Cover::Part
    }
}

/// Entry of [`Visibility::visible`].
pub(crate) fn triangle_code(part: u16, triangle_index: usize) -> u32 {
    (u32::from(part) << TRIANGLE_BITS) | (triangle_index as u32 & ((1 << TRIANGLE_BITS) - 1))
}

/// Index into the triangles of an entry of [`Visibility::visible`].
pub(crate) fn triangle_index(code: u32) -> usize {
    (code & ((1 << TRIANGLE_BITS) - 1)) as usize
}

/// Draws a triangle into neighbouring pixels; `WHOLE` states that it covers all of them.
#[inline(always)]
fn draw_span<const WHOLE: bool>(
    triangle: &ScreenTriangle,
    code: u32,
    rays: (&[f32], &[f32]),
    out: (&mut [f32], &mut [u32]),
) {
    let [e0, e1, e2] = &triangle.edges;
    for (((&x, &y), inv_z), visible) in rays.0.iter().zip(rays.1).zip(out.0).zip(out.1) {
        let nearness = triangle.inv_z.at(x, y);
        let inside = WHOLE | ((e0.at(x, y) >= 0.0) & (e1.at(x, y) >= 0.0) & (e2.at(x, y) >= 0.0));
        let hit = inside & (nearness > *inv_z);
        // Selected by bit masks, because a conditional store would not be vectorised.
        let mask = u32::from(hit).wrapping_neg();
        *inv_z = f32::from_bits((nearness.to_bits() & mask) | (inv_z.to_bits() & !mask));
        *visible = (code & mask) | (*visible & !mask);
    }
}
