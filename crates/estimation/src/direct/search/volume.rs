//! How well every pixel of the region agrees with every pixel of its row in the other eye.
//!
//! The neighbourhood of a pixel becomes a vector of mean zero and length [`DESCRIPTOR_LENGTH`] in whole numbers; the product
//! of two such vectors is their zero-mean normalised cross-correlation. A term for the noise of the camera in the
//! normalisation makes a neighbourhood without texture agree with nothing, instead of with anything at random.

use crate::cpu::Kernels;
use crate::direct::colour_planes::ColourPlanes;
use crate::direct::region_pyramid::{RegionLevel, is_seen};
use crate::wide::wide;

/// Pixels of a neighbourhood.
const DESCRIPTOR: usize = 9;
/// Length of a descriptor: its square, twice, must fit into 16 bits with sign.
const DESCRIPTOR_LENGTH: f32 = 127.0;
/// Disparities are worked on in groups of so many.
pub(super) const GROUP: usize = 32;
/// Cost of a perfect agreement is 0, of none [`COST_NEUTRAL`], of the opposite twice that.
pub const COST_NEUTRAL: u8 = 63;
/// Cost of what can not be.
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

/// Costs of all pixels of a box and all whole disparities of a range.
#[derive(Clone, Debug, Default)]
pub struct CostVolume {
    /// Which pixels of the left window.
    pub area: LevelBox,
    /// Lowest disparity, pixels of the level's grid.
    pub first: i32,
    /// Number of disparities.
    pub count: usize,
    /// Disparities stored per pixel: `count` and some impossible ones.
    pub stride: usize,
    /// Pixel by pixel, row-major, [`Self::stride`] costs each.
    pub costs: Vec<u8>,
    left: Vec<i16>,
    right: Vec<i16>,
}

impl CostVolume {
    /// Computes the costs of `area` for the disparities `range` (pixels of the level's grid, both ends included).
    pub fn compute(&mut self, level: &RegionLevel, area: LevelBox, range: (i32, i32), noise: f32, kernels: Kernels) {
        self.area = area;
        self.first = range.0;
        self.count = (range.1 - range.0 + 1).max(1) as usize;
        self.stride = self.count.div_ceil(GROUP) * GROUP;
        self.costs.resize(area.width * area.height * self.stride, 0);
        let right_width = level.right.window.width;
        // Mirrored, so that growing disparities are growing addresses, with room for places beyond both borders.
        let padding = area.width + self.stride + GROUP + level.left.window.width;
        let row_length = right_width + 2 * padding;
        self.left.resize(area.width * DESCRIPTOR, 0);
        let row_shift = level.left.window.y - level.right.window.y;
        for y in 0..area.height {
            let y_left = area.y + y;
            describe(&level.left, y_left as i64, noise, (area.x, area.width), |x, k, value| {
                self.left[(x - area.x) * DESCRIPTOR + k] = value;
            });
            self.right.clear();
            self.right.resize(row_length * DESCRIPTOR, 0);
            let y_right = y_left as i64 + i64::from(row_shift);
            describe(&level.right, y_right, noise, (0, right_width), |x, k, value| {
                self.right[k * row_length + padding + right_width - 1 - x] = value;
            });
            // Left column x at disparity d meets the right column x - d + shift, mirrored width - 1 - that.
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

/// Descriptors of columns `first..first + count` of row `y`; zero where the neighbourhood is not in the window.
fn describe(
    eye: &ColourPlanes,
    y: i64,
    noise: f32,
    (first, count): (usize, usize),
    mut store: impl FnMut(usize, usize, i16),
) {
    let (plane, width) = (eye.luminance(), eye.window.width);
    let floor = DESCRIPTOR as f32 * noise * noise;
    for x in first..first + count {
        let mut v = [0.0_f32; DESCRIPTOR];
        let inside = x >= 1 && x + 1 < width && y >= 1 && y + 1 < eye.window.height as i64;
        if inside && is_seen(eye.flags[y as usize * width + x]) {
            for j in 0..3 {
                v[3 * j..3 * j + 3].copy_from_slice(&plane.row(y as usize + j - 1)[x - 1..x + 2]);
            }
            let mean = v.iter().sum::<f32>() / DESCRIPTOR as f32;
            let energy = v.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>();
            let scale = DESCRIPTOR_LENGTH / (energy + floor).sqrt();
            v = v.map(|v| ((v - mean) * scale).round());
        }
        for (k, v) in v.iter().enumerate() {
            store(x, k, *v as i16);
        }
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
    for (x, (left, costs)) in left.chunks_exact(DESCRIPTOR).zip(costs.chunks_exact_mut(stride)).enumerate() {
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
