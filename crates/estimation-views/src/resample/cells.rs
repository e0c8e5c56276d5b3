//! Positions of rectified pixels in the raw image, cell by cell.

use std::hint::black_box;
use std::ops::Range;

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::maps::PixelMap;

use super::super::image_plane::PixelWindow;

/// Side of a cell, pixels: one row is a register of 16 values. A corner per 256 pixels costs 0.3 ns per pixel, and the
/// interpolation is off by less than 1e-4 px for lenses with a focal length of 300 px and more (fourth derivatives of the
/// distortion, derived).
pub const CELL: usize = 16;
/// Largest part of the source that a cell may show, pixels. Chosen by hand, not varied: two registers; a cell fits whose 16
/// pixels are less than 1.7 times as far apart in the source.
pub(super) const PATCH: usize = 32;
/// Cells per stripe: the corners of a stripe are on the stack. Chosen by hand, not varied: the corners left and right of a
/// stripe are evaluated twice.
const STRIPE: usize = 64;
/// Corners along a row of a stripe: one more on the left, and two on the right.
const CORNERS: usize = STRIPE + 3;
/// A cell whose centre is off by more than this is evaluated pixel by pixel, pixels. Chosen by hand: the rounding error of
/// a map stored in 1/256 of a pixel.
pub(super) const DEVIATION_MAX_PX: f64 = 1.0 / 512.0;
/// Positions beyond this are not interpolated, pixels: far outside any image.
pub(super) const POSITION_MAX_PX: f64 = 1e6;
/// Position of a pixel without a source.
const NOWHERE: f32 = -1e6;

/// Cubic Lagrange weights of the corners at -1, 0, 1 and 2 cells for each pixel of a cell.
const WEIGHTS: [[f32; CELL]; 4] = {
    let mut weights = [[0.0; CELL]; 4];
    let mut i = 0;
    while i < CELL {
        let t = i as f32 / CELL as f32;
        weights[0][i] = -t * (t - 1.0) * (t - 2.0) / 6.0;
        weights[1][i] = (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0;
        weights[2][i] = -(t + 1.0) * t * (t - 2.0) / 2.0;
        weights[3][i] = (t + 1.0) * t * (t - 1.0) / 6.0;
        i += 1;
    }
    weights
};
/// The same weights, row by row.
const WEIGHTS_OF_ROWS: [[f32; 4]; CELL] = {
    let mut weights = [[0.0; 4]; CELL];
    let mut i = 0;
    while i < 4 * CELL {
        weights[i / 4][i % 4] = WEIGHTS[i % 4][i / 4];
        i += 1;
    }
    weights
};
/// The same weights at the centre of a cell.
const CENTRE_WEIGHTS: [f64; 4] = [-1.0 / 16.0, 9.0 / 16.0, 9.0 / 16.0, -1.0 / 16.0];

/// Source positions of the pixels of one cell: `base + at`, columns and rows. `at` is not negative where there is a source.
#[derive(Clone, Debug)]
pub struct CellPositions {
    pub(super) base: [i32; 2],
    pub(super) at: [[[f32; CELL]; CELL]; 2],
}

impl CellPositions {
    fn nowhere() -> Self {
        Self { base: [0; 2], at: [[[NOWHERE; CELL]; CELL]; 2] }
    }

    /// A box that contains the source pixels nearest to all positions: first and last column, first and last row.
    pub fn nearest_box(&self, kernels: Kernels) -> [(i32, i32); 2] {
        let mut ends = [(0.0, 0.0); 2];
        extremes(kernels, &self.at, &mut ends);
        let round = |axis: usize, at: f32| self.base[axis] + (f64::from(at) + 0.5).floor() as i32;
        [0, 1].map(|axis| (round(axis, ends[axis].0), round(axis, ends[axis].1)))
    }

    /// The columns and rows of a source of this size that the cubic kernel reads at all positions.
    pub fn taps_box(&self, size: [u32; 2]) -> [Range<usize>; 2] {
        [0, 1].map(|axis| {
            // Pixels without a source are negative.
            let valid = self.at[axis].as_flattened().iter().copied().filter(|at| *at >= 0.0);
            let (low, high) = valid.fold((f32::MAX, 0.0_f32), |(low, high), at| (low.min(at), high.max(at)));
            let pixel = |at: f32, beside: i64| {
                let whole = i64::from(self.base[axis]) + beside;
                whole.saturating_add(at as i64).clamp(0, i64::from(size[axis])) as usize
            };
            let first = pixel(low, -1);
            first..pixel(high, 3).max(first)
        })
    }

    /// The source pixels nearest to the positions of a row: columns and rows, which may be outside the image.
    pub fn nearest(&self, y: usize, kernels: Kernels) -> [[i32; CELL]; 2] {
        let mut out = [[0; CELL]; 2];
        nearest(kernels, self.base, [&self.at[0][y], &self.at[1][y]], &mut out);
        out
    }
}

wide! {
    /// Lowest and highest position along both axes.
    fn extremes(at: &[[[f32; CELL]; CELL]; 2], out: &mut [(f32, f32); 2]) = extremes_kernel;
}

#[inline(always)]
pub(super) fn extremes_kernel(at: &[[[f32; CELL]; CELL]; 2], out: &mut [(f32, f32); 2]) {
    for (at, out) in at.iter().zip(out) {
        let (mut low, mut high) = (at[0], at[0]);
        for row in &at[1..] {
            for i in 0..CELL {
                low[i] = if row[i] < low[i] { row[i] } else { low[i] };
                high[i] = if row[i] > high[i] { row[i] } else { high[i] };
            }
        }
        *out = (ends(&low).0, ends(&high).1);
    }
}

/// Lowest and highest of the values.
#[inline(always)]
pub(super) fn ends(values: &[f32; CELL]) -> (f32, f32) {
    let (mut low, mut high) = (*values, *values);
    let mut half = CELL / 2;
    while half > 0 {
        for i in 0..half {
            low[i] = if low[i + half] < low[i] { low[i + half] } else { low[i] };
            high[i] = if high[i + half] > high[i] { high[i + half] } else { high[i] };
        }
        half /= 2;
    }
    (low[0], high[0])
}

wide! {
    fn nearest(base: [i32; 2], at: [&[f32; CELL]; 2], out: &mut [[i32; CELL]; 2]) = nearest_kernel;
}

#[inline(always)]
fn nearest_kernel(base: [i32; 2], at: [&[f32; CELL]; 2], out: &mut [[i32; CELL]; 2]) {
    for axis in 0..2 {
        for i in 0..CELL {
            (out[axis][i], _) = whole(base[axis], at[axis][i] + 0.5);
        }
    }
}

/// One corner: its source position; not a number if the lens does not image it.
type Corner = Vector2<f64>;

/// A corner without a source.
const UNKNOWN: Corner = Vector2::new(f64::NAN, f64::NAN);

/// Calls `visit` with every cell of a window, its origin in the window and the source positions of its pixels; cells without
/// any source are passed as `None`. Cells at the right and lower border reach beyond the window.
pub fn for_each_cell(
    map: &PixelMap,
    window: &PixelWindow,
    kernels: Kernels,
    mut visit: impl FnMut((usize, usize), Option<&CellPositions>),
) {
    let mut positions = CellPositions::nowhere();
    let cells = (window.width.div_ceil(CELL), window.height.div_ceil(CELL));
    let at = |column: i64, row: i64| {
        let place = |first: i32, cell: i64| (i64::from(first) + cell * CELL as i64) as f64;
        Vector2::new(place(window.x, column), place(window.y, row))
    };
    for stripe in (0..cells.0).step_by(STRIPE) {
        let count = STRIPE.min(cells.0 - stripe);
        let corners_of = |row: i64, out: &mut [Corner; CORNERS]| {
            for (i, corner) in out.iter_mut().enumerate().take(count + 3) {
                let source = map.source(&at((stripe + i) as i64 - 1, row));
                *corner = source.filter(|px| px.amax() < POSITION_MAX_PX).unwrap_or(UNKNOWN);
            }
        };
        // The rows of corners are used in turn: row `i` is at `(i + 1) % 4`.
        let mut rows: [[Corner; CORNERS]; 4] = [[UNKNOWN; CORNERS]; 4];
        for (i, row) in rows.iter_mut().enumerate().take(3) {
            corners_of(i as i64 - 1, row);
        }
        for row in 0..cells.1 {
            corners_of(row as i64 + 2, &mut rows[(row + 3) % 4]);
            for column in 0..count {
                let mut corners = [[UNKNOWN; 4]; 4];
                for (j, corners) in corners.iter_mut().enumerate() {
                    corners.copy_from_slice(&rows[(row + j) % 4][column..column + 4]);
                }
                let origin = at((stripe + column) as i64, row as i64);
                let is_visible = fill(map, &corners, &origin, kernels, &mut positions);
                visit(((stripe + column) * CELL, row * CELL), is_visible.then_some(&positions));
            }
        }
    }
}

/// Fills the positions of the cell with its first pixel at `origin`; returns whether it may have a source.
fn fill(
    map: &PixelMap,
    corners: &[[Corner; 4]; 4],
    origin: &Vector2<f64>,
    kernels: Kernels,
    out: &mut CellPositions,
) -> bool {
    let known = corners.as_flattened().iter().filter(|px| px.x.is_finite()).count();
    if known == 0 {
        return false;
    }
    if known == 16 {
        let mut centre = Vector2::zeros();
        for (j, row) in corners.iter().enumerate() {
            for (i, px) in row.iter().enumerate() {
                centre += px * (CENTRE_WEIGHTS[i] * CENTRE_WEIGHTS[j]);
            }
        }
        let true_centre = map.source(&origin.add_scalar(CELL as f64 / 2.0));
        if true_centre.is_some_and(|px| (px - centre).amax() <= DEVIATION_MAX_PX) {
            for axis in 0..2 {
                out.base[axis] = interpolate_axis(corners, axis, kernels, &mut out.at[axis]);
            }
            return true;
        }
    }
    out.base = [0; 2];
    for (y, x) in (0..CELL).flat_map(|y| (0..CELL).map(move |x| (y, x))) {
        let source = map.source(&(origin + Vector2::new(x as f64, y as f64)));
        let source = source.filter(|px| px.min() >= 0.0 && px.max() < POSITION_MAX_PX);
        let at = source.map_or([NOWHERE; 2], |px| [px.x as f32, px.y as f32]);
        (out.at[0][y][x], out.at[1][y][x]) = (at[0], at[1]);
    }
    true
}

/// Fills the positions along one axis, and returns what they are relative to.
fn interpolate_axis(corners: &[[Corner; 4]; 4], axis: usize, kernels: Kernels, out: &mut [[f32; CELL]; CELL]) -> i32 {
    let mut values = [0.0; 16];
    for (value, corner) in values.iter_mut().zip(corners.as_flattened()) {
        *value = corner[axis];
    }
    let (mut low, mut high) = (values[0], values[0]);
    for value in values {
        (low, high) = (low.min(value), high.max(value));
    }
    // Interpolated positions are at least this, as the negative weights of a cell sum to more than -0.3.
    let base = (low - 0.3 * (high - low)).floor() - 1.0;
    let mut local = [[0.0_f32; 4]; 4];
    for (local, value) in local.as_flattened_mut().iter_mut().zip(values) {
        *local = (value - base) as f32;
    }
    interpolate(kernels, &local, out);
    base as i32
}

wide! {
    /// Positions of all pixels of a cell from those of 4 x 4 corners.
    fn interpolate(corners: &[[f32; 4]; 4], out: &mut [[f32; CELL]]) = interpolate_kernel;
}

#[inline(always)]
fn interpolate_kernel(corners: &[[f32; 4]; 4], out: &mut [[f32; CELL]]) {
    let mut rows = [[0.0; CELL]; 4];
    // All rows of a column in one loop: of several short loops the compiler makes a shuffle of single values.
    for i in 0..CELL {
        for j in 0..4 {
            let first = WEIGHTS[0][i] * corners[j][0] + WEIGHTS[1][i] * corners[j][1];
            rows[j][i] = first + (WEIGHTS[2][i] * corners[j][2] + WEIGHTS[3][i] * corners[j][3]);
        }
    }
    for (y, out) in out.iter_mut().enumerate() {
        // Row by row: otherwise the compiler fills columns, and scatters their values.
        let weights = WEIGHTS_OF_ROWS[black_box(y) % CELL];
        for i in 0..CELL {
            let first = weights[0] * rows[0][i] + weights[1] * rows[1][i];
            out[i] = first + (weights[2] * rows[2][i] + weights[3] * rows[3][i]);
        }
    }
}

const TWO_TO_23: f32 = 8_388_608.0;

/// `base` plus the whole part of a number that is not negative, and the whole part.
///
/// Adding 2^23 rounds a number below 2^22 to a whole one, whose bits then count from those of 2^23: a conversion that every
/// instruction set has. A negative number, which has no source, becomes a far smaller one.
#[inline(always)]
pub(super) fn whole(base: i32, at: f32) -> (i32, f32) {
    let shifted = at + TWO_TO_23;
    let is_above = shifted - TWO_TO_23 > at;
    let number = shifted.to_bits() as i32 - TWO_TO_23.to_bits() as i32 - i32::from(is_above);
    (base + number, shifted - TWO_TO_23 - if is_above { 1.0 } else { 0.0 })
}
