//! Cost volume: matching cost of every region pixel with the pixels of its row in the right image.
//!
//! The neighbourhood of a pixel becomes an integer vector of mean zero and norm `DESCRIPTOR_LENGTH`. The product of two such
//! vectors is their zero-mean normalised cross-correlation. The normalisation contains a term for the camera noise, so that a
//! neighbourhood without texture matches nothing instead of random positions.

use std::ops::{Range, RangeInclusive};

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::{LANES, wide};
use pb3dp_estimation_views::colour_planes::ColourPlanes;
use pb3dp_estimation_views::region_pyramid::{RegionLevel, is_visible};

/// Pixels of a neighbourhood: 3 x 3. Chosen by hand: other sizes gave no improvement in the prototype of ADR 7 on 256 real
/// regions.
const DESCRIPTOR: usize = 9;
/// Norm of a descriptor: twice its square must fit into 16 bits with sign (2 * 127^2 = 32258).
const DESCRIPTOR_LENGTH: f32 = 127.0;
/// Number of disparities processed as a group.
pub(super) const GROUP: usize = 32;
/// Cost of perfect agreement is 0, of no agreement [`COST_NEUTRAL`], of inverted agreement twice that. That is seven bits.
pub const COST_NEUTRAL: u8 = 63;
/// Cost of an impossible disparity.
pub(super) const COST_IMPOSSIBLE: u8 = 255;

/// Part of the left window of a level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LevelBox {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Costs of all pixels of a box for all integer disparities of a range.
#[derive(Clone, Debug, Default)]
pub struct CostVolume {
    /// The box in the left window.
    pub area: LevelBox,
    /// Lowest disparity, pixels of the level's grid.
    pub first: i32,
    /// Number of disparities.
    pub count: usize,
    /// Number of disparities stored per pixel: `count` and some impossible ones.
    pub stride: usize,
    /// Pixel by pixel, row-major, [`Self::stride`] costs each.
    pub costs: Vec<u8>,
    /// Descriptors of a row: left, right, and right mirrored.
    left: Vec<i16>,
    described: Vec<i16>,
    right: Vec<i16>,
}

impl CostVolume {
    /// Computes the costs of `area` for the disparities `range` (pixels of the level's grid, both ends included).
    pub fn compute(
        &mut self,
        level: &RegionLevel,
        area: LevelBox,
        range: RangeInclusive<i32>,
        noise: f32,
        kernels: Kernels,
    ) {
        self.area = area;
        self.first = *range.start();
        self.count = (range.end() - range.start() + 1).max(1) as usize;
        self.stride = self.count.div_ceil(GROUP) * GROUP;
        self.costs.resize(area.width * area.height * self.stride, 0);
        let right_width = level.right.window.width;
        // Mirrored, so that increasing disparities are increasing addresses, with padding for positions beyond both borders.
        let padding = area.width + self.stride + GROUP + level.left.window.width;
        let row_length = right_width + 2 * padding;
        self.left.resize(area.width * DESCRIPTOR, 0);
        self.right.clear();
        self.right.resize(row_length * DESCRIPTOR, 0);
        self.described.resize(right_width * DESCRIPTOR, 0);
        let row_shift = level.left.window.y - level.right.window.y;
        for y in 0..area.height {
            let y_left = area.y + y;
            describe(&level.left, y_left as i64, noise, area.x..area.x + area.width, kernels, &mut self.left);
            let y_right = y_left as i64 + i64::from(row_shift);
            describe(&level.right, y_right, noise, 0..right_width, kernels, &mut self.described);
            for k in 0..DESCRIPTOR {
                let mirrored = &mut self.right[k * row_length + padding..][..right_width];
                let described = &self.described[k * right_width..(k + 1) * right_width];
                for (to, from) in mirrored.iter_mut().rev().zip(described) {
                    *to = *from;
                }
            }
            // Left column x at disparity d corresponds to the right column x - d + shift, mirrored width - 1 - that.
            let first_mirrored = padding as i64 + right_width as i64 - 1 - area.x as i64 + i64::from(self.first)
                - i64::from(level.column_shift());
            let costs = &mut self.costs[y * area.width * self.stride..][..area.width * self.stride];
            cost_row(kernels, &self.left, &self.right, row_length, first_mirrored, self.stride, costs);
        }
        if self.stride > self.count {
            for pixel in self.costs.chunks_exact_mut(self.stride) {
                pixel[self.count..].fill(COST_IMPOSSIBLE);
            }
        }
    }
}

/// Descriptors of some columns of row `y`, component by component; zero if the neighbourhood is not inside the window.
fn describe(side: &ColourPlanes, y: i64, noise: f32, columns: Range<usize>, kernels: Kernels, out: &mut [i16]) {
    let (plane, width, first, count) = (side.luminance(), side.window.width, columns.start, columns.len());
    // Columns whose neighbours are inside the window.
    let (start, end) = (first.max(1), columns.end.min(width.saturating_sub(1)));
    if y < 1 || y + 1 >= side.window.height as i64 || start >= end {
        out.fill(0);
        return;
    }
    let rows: [&[f32]; 3] = std::array::from_fn(|j| &plane.row(y as usize + j - 1)[start - 1..end + 1]);
    describe_row(kernels, rows, DESCRIPTOR as f32 * noise * noise, count, start - first, out);
    let flags = &side.flags[y as usize * width..(y as usize + 1) * width];
    for x in columns {
        if x < start || x >= end || !is_visible(flags[x]) {
            for k in 0..DESCRIPTOR {
                out[k * count + x - first] = 0;
            }
        }
    }
}

wide! {
    fn describe_row(rows: [&[f32]; 3], floor: f32, stride: usize, first: usize, out: &mut [i16]) = describe_row_kernel;
}

#[inline(always)]
fn describe_row_kernel(rows: [&[f32]; 3], floor: f32, stride: usize, first: usize, out: &mut [i16]) {
    let count = rows[0].len() - 2;
    let wide = count / LANES * LANES;
    let mut at = 0;
    while at < count {
        let lanes = if at < wide { LANES } else { count - at };
        let mut v = [[0.0_f32; LANES]; DESCRIPTOR];
        for (k, v) in v.iter_mut().enumerate() {
            v[..lanes].copy_from_slice(&rows[k / 3][at + k % 3..][..lanes]);
        }
        let (mut sum, mut energy) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        for v in &v {
            for i in 0..LANES {
                sum[i] += v[i];
            }
        }
        for v in &mut v {
            for i in 0..LANES {
                v[i] -= sum[i] * (1.0 / DESCRIPTOR as f32);
                energy[i] += v[i] * v[i];
            }
        }
        let scale: [f32; LANES] = std::array::from_fn(|i| DESCRIPTOR_LENGTH / (energy[i] + floor).sqrt());
        for (k, v) in v.iter().enumerate() {
            let mut rounded = [0_i16; LANES];
            for i in 0..LANES {
                // Adding and subtracting 1.5 * 2^23 rounds to integers.
                let value = v[i] * scale[i] + 12_582_912.0;
                rounded[i] = (value.to_bits() as i32).wrapping_sub(0x4B40_0000) as i16;
            }
            out[k * stride + first + at..][..lanes].copy_from_slice(&rounded[..lanes]);
        }
        at += lanes;
    }
}

wide! {
    fn cost_row(left: &[i16], right: &[i16], row_length: usize, first_mirrored: i64, stride: usize, costs: &mut [u8]) = cost_row_kernel;
}

#[inline(always)]
fn cost_row_kernel(
    left: &[i16],
    right: &[i16],
    row_length: usize,
    first_mirrored: i64,
    stride: usize,
    costs: &mut [u8],
) {
    let perfect = (DESCRIPTOR_LENGTH * DESCRIPTOR_LENGTH) as i16;
    let rows: [&[i16]; DESCRIPTOR] = std::array::from_fn(|k| &right[k * row_length..(k + 1) * row_length]);
    let width = left.len() / DESCRIPTOR;
    for (x, costs) in costs.chunks_exact_mut(stride).enumerate() {
        let left: [i16; DESCRIPTOR] = std::array::from_fn(|k| left[k * width + x]);
        for (group, costs) in costs.chunks_exact_mut(GROUP).enumerate() {
            let start = (first_mirrored - x as i64 + (group * GROUP) as i64).clamp(0, (row_length - GROUP) as i64);
            let mut sum = [0_i16; GROUP];
            for k in 0..DESCRIPTOR {
                let (l, r) = (left[k], &rows[k][start as usize..start as usize + GROUP]);
                for i in 0..GROUP {
                    sum[i] = sum[i].wrapping_add(l.wrapping_mul(r[i]));
                }
            }
            for i in 0..GROUP {
                costs[i] = ((perfect.wrapping_sub(sum[i])).max(0) >> 8) as u8;
            }
        }
    }
}
