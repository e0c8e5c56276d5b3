//! The part of the source that one cell shows, turned so that its columns and rows run like those of the cell.

use super::super::colour_planes::{OPPONENT_FROM_RGB, Wanted};
use super::super::row_shift::keys;
use super::cells::{CELL, CellPositions, PATCH, ends, extremes_kernel, whole};
use super::source::{RawImage, Value};

/// Most columns or rows by which the distance between source and destination may change along one row of a cell, pixels.
/// Chosen by hand, not varied: a rotation by 12 degrees, or a change of scale by a fifth.
pub(super) const SPREAD_MAX: usize = 4;
/// Pixels of a patch beside those that are shown: their weights are zero.
const BESIDE: usize = SPREAD_MAX;
/// Pixels along a line that the sums of a row of a cell read at most.
const WINDOW: usize = CELL + 3 + SPREAD_MAX;
/// Columns and rows of the memory of a patch.
const STRIDE: usize = PATCH + 4 * BESIDE;

/// The wanted channels of a part of the source.
pub(super) struct Patch {
    planes: [[[f32; STRIDE]; STRIDE]; 3],
    placement: Placement,
    /// Whether all of it is inside the source.
    pub is_inside: bool,
    /// Whether a value may be saturated.
    pub may_be_saturated: bool,
}

/// How a patch lies in the source: pixel `q` along an axis is at `origin + step q`, as `CellPositions::at`.
#[derive(Clone, Copy, Default)]
struct Placement {
    /// Source axis of the columns, and of the rows.
    axes: [usize; 2],
    origin: [f32; 2],
    /// 1 or -1.
    step: [f32; 2],
    size: [usize; 2],
}

impl Default for Patch {
    fn default() -> Self {
        Self {
            planes: [[[0.0; STRIDE]; STRIDE]; 3],
            placement: Placement::default(),
            is_inside: false,
            may_be_saturated: false,
        }
    }
}

impl Placement {
    /// `None` if a pixel of the cell has no source, or if the cell shows too much.
    #[inline(always)]
    fn of(positions: &CellPositions) -> Option<Self> {
        let mut extremes = [(0.0, 0.0); 2];
        extremes_kernel(&positions.at, &mut extremes);
        let at = &positions.at;
        let columns = usize::from((at[1][0][CELL - 1] - at[1][0][0]).abs() > (at[0][0][CELL - 1] - at[0][0][0]).abs());
        let mut out = Self { axes: [columns, 1 - columns], origin: [0.0; 2], step: [1.0; 2], size: [0; 2] };
        for (i, last) in [(0, CELL - 1), (CELL - 1, 0)].into_iter().enumerate() {
            let axis = out.axes[i];
            let (low, high) = extremes[axis];
            if low < 0.0 || high - low > (PATCH - 5) as f32 {
                return None;
            }
            // Positions are not negative: conversion truncates them.
            let (low, high) = (low as u32, high as u32);
            let is_backwards = at[axis][last.0][last.1] < at[axis][0][0];
            (out.origin[i], out.step[i]) =
                if is_backwards { (high as f32 + 2.0, -1.0) } else { (low as f32 - 1.0, 1.0) };
            out.size[i] = (high - low) as usize + 4;
        }
        Some(out)
    }

    /// What row `y` of a cell reads along one axis of the patch: 0 for its columns, 1 for its rows.
    #[inline(always)]
    fn taps(&self, positions: &CellPositions, y: usize, axis: usize) -> Taps {
        let (at, step, origin) = (&positions.at[self.axes[axis]][y], self.step[axis], self.origin[axis]);
        let mut local = [0.0; CELL];
        for i in 0..CELL {
            local[i] = step * (at[i] - origin);
        }
        Taps::of(&local, if axis == 0 { 1.0 } else { 0.0 })
    }

    /// First pixel of the patch along one of its axes, in the source.
    fn first(&self, axis: usize, base: [i32; 2], first: [i32; 2]) -> i64 {
        let axis_of_source = self.axes[axis];
        i64::from(base[axis_of_source]) - i64::from(first[axis_of_source]) + self.origin[axis] as i64
    }
}

impl Patch {
    /// Takes the part of the source that a cell shows; returns whether it fits.
    #[inline(always)]
    pub fn take<T: Value>(&mut self, raw: &RawImage<'_, T>, positions: &CellPositions, wanted: Wanted) -> bool {
        let Some(placement) = Placement::of(positions) else { return false };
        self.placement = placement;
        let first = [0, 1].map(|axis| placement.first(axis, positions.base, raw.first));
        let length = [raw.width as i64, raw.height as i64];
        self.is_inside = (0..2).all(|i| {
            let last = first[i] + placement.step[i] as i64 * (placement.size[i] as i64 - 1);
            first[i].min(last) >= 0 && first[i].max(last) < length[placement.axes[i]]
        });
        let is_upright = placement.axes == [0, 1] && placement.step == [1.0; 2];
        // Rows are read to the full width of a patch.
        let end = (first[1] + placement.size[1] as i64 - 1) * raw.stride as i64 + 3 * (first[0] + PATCH as i64);
        self.may_be_saturated = if self.is_inside && is_upright && end <= raw.values.len() as i64 {
            self.take_upright(raw, [first[0] as usize, first[1] as usize], wanted)
        } else {
            self.take_turned(raw, first, wanted)
        };
        true
    }

    #[inline(always)]
    fn take_upright<T: Value>(&mut self, raw: &RawImage<'_, T>, first: [usize; 2], wanted: Wanted) -> bool {
        let mut highest = [T::default(); 3 * PATCH];
        for y in 0..self.placement.size[1].min(PATCH) {
            let start = (first[1] + y) * raw.stride + 3 * first[0];
            let Some(values) = raw.values.get(start..).and_then(|values| values.first_chunk::<{ 3 * PATCH }>()) else {
                continue;
            };
            for (highest, &value) in highest.iter_mut().zip(values) {
                *highest = (*highest).max(value);
            }
            let mut colours = [[0.0_f32; PATCH]; 3];
            let [red, green, blue] = &mut colours;
            for i in 0..PATCH {
                red[i] = raw.share * values[3 * i].grey();
                green[i] = raw.share * values[3 * i + 1].grey();
                blue[i] = raw.share * values[3 * i + 2].grey();
            }
            if wanted != Wanted::Rgb {
                colours = turned(&colours, wanted);
            }
            for (plane, colour) in self.planes.iter_mut().zip(&colours).take(wanted.planes()) {
                plane[BESIDE + y][BESIDE..BESIDE + PATCH].copy_from_slice(colour);
            }
        }
        highest.into_iter().fold(T::default(), T::max).is_saturated()
    }

    /// In any direction, and beyond the border of the source, where the values are zero.
    #[inline(never)]
    fn take_turned<T: Value>(&mut self, raw: &RawImage<'_, T>, first: [i64; 2], wanted: Wanted) -> bool {
        let Placement { axes, step, size, .. } = self.placement;
        let mut highest = T::default();
        for (y, x) in (0..size[1].min(PATCH)).flat_map(|y| (0..size[0].min(PATCH)).map(move |x| (y, x))) {
            let along = [first[0] + step[0] as i64 * x as i64, first[1] + step[1] as i64 * y as i64];
            let [column, row] = [along[axes[0]], along[axes[1]]];
            let colour = raw.pixel(column, row).map_or([0.0; 3], |pixel| {
                highest = pixel.into_iter().fold(highest, T::max);
                pixel.map(|value| value.grey() * raw.share)
            });
            for (c, plane) in self.planes.iter_mut().enumerate().take(wanted.planes()) {
                plane[BESIDE + y][BESIDE + x] = wanted.channel(c, colour);
            }
        }
        highest.is_saturated()
    }

    /// Interpolates a row of a cell.
    #[inline(always)]
    pub fn row(&self, positions: &CellPositions, y: usize, wanted: Wanted, out: &mut [[f32; CELL]; 3]) {
        let (columns, rows) = (self.placement.taps(positions, y, 0), self.placement.taps(positions, y, 1));
        let planes = &self.planes[..wanted.planes()];
        match columns.spread.max(rows.spread) {
            0 => sum::<4>(planes, &columns, &rows, out),
            1 => sum::<5>(planes, &columns, &rows, out),
            2..=SPREAD_MAX => sum::<{ 4 + SPREAD_MAX }>(planes, &columns, &rows, out),
            _ => self.row_singly(positions, y, wanted, out),
        }
    }

    /// As [`Self::row`], pixel by pixel: for rows that are turned or bent more than [`SPREAD_MAX`] permits.
    #[inline(never)]
    fn row_singly(&self, positions: &CellPositions, y: usize, wanted: Wanted, out: &mut [[f32; CELL]; 3]) {
        let Placement { axes, origin, step, .. } = self.placement;
        for i in 0..CELL {
            let [(column, columns), (row, rows)] = [0, 1].map(|axis| {
                let local = step[axis] * (positions.at[axes[axis]][y][i] - origin[axis]);
                let (number, floor) = whole(BESIDE as i32 - 1, local);
                (number as usize, keys(local - floor))
            });
            for (plane, out) in self.planes.iter().zip(out.iter_mut()).take(wanted.planes()) {
                let mut sums = [0.0_f32; 4];
                for (line, weight) in plane[row..].iter().zip(rows) {
                    for (sum, value) in sums.iter_mut().zip(&line[column..]) {
                        *sum += weight * value;
                    }
                }
                out[i] = sums.iter().zip(columns).map(|(sum, weight)| weight * sum).sum();
            }
        }
    }
}

/// The pixels of a patch that a row of a cell reads along one axis.
struct Taps {
    /// Position of the first one in the memory of the patch: of the first pixel along columns, of all pixels along rows.
    first: usize,
    /// By how much the last first tap is beyond the first one, relative to the pixels of the cell.
    spread: usize,
    /// The whole position of each pixel, relative to the pixels of the cell, and the lowest of them.
    shift: [f32; CELL],
    low: f32,
    /// Weights of the pixels at -1, 0, 1 and 2.
    weights: [[f32; CELL]; 4],
}

impl Taps {
    /// Of positions that advance by `step` from pixel to pixel: 1 along columns, 0 along rows.
    #[inline(always)]
    fn of(local: &[f32; CELL], step: f32) -> Self {
        let (mut shift, mut weights) = ([0.0; CELL], [[0.0; CELL]; 4]);
        for i in 0..CELL {
            let (_, floor) = whole(0, local[i]);
            shift[i] = floor - step * i as f32;
            let [a, b, c, d] = keys(local[i] - floor);
            (weights[0][i], weights[1][i], weights[2][i], weights[3][i]) = (a, b, c, d);
        }
        let (low, high) = ends(&shift);
        // Whole numbers: conversion by `whole` is exact, and faster than one that checks its range.
        let (first, _) = whole(BESIDE as i32 - CELL as i32 - 1, low + CELL as f32);
        let (spread, _) = whole(0, high - low);
        Self { first: first as usize, spread: spread as usize, low, shift, weights }
    }

    /// Weights of `N` pixels from the first one on.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "several arrays are walked in step")]
    fn weights_over<const N: usize>(&self) -> [[f32; CELL]; N] {
        let mut out = [[0.0; CELL]; N];
        if N == self.weights.len() {
            out.copy_from_slice(&self.weights);
            return out;
        }
        // All taps of a pixel in one loop: of several short loops the compiler makes a shuffle of single values.
        for i in 0..CELL {
            let mut weights = [0.0; N];
            for shift in 0..N - 3 {
                let is_here = self.shift[i] == self.low + shift as f32;
                for j in 0..4 {
                    weights[shift + j] += if is_here { self.weights[j][i] } else { 0.0 };
                }
            }
            for tap in 0..N {
                out[tap][i] = weights[tap];
            }
        }
        out
    }
}

/// The channels of a row of red, green and blue.
#[inline(always)]
fn turned(colours: &[[f32; PATCH]; 3], wanted: Wanted) -> [[f32; PATCH]; 3] {
    let mut out = [[0.0; PATCH]; 3];
    for (out, turn) in out.iter_mut().zip(OPPONENT_FROM_RGB).take(wanted.planes()) {
        for i in 0..PATCH {
            out[i] = turn[0] * colours[0][i] + turn[1] * colours[1][i] + turn[2] * colours[2][i];
        }
    }
    out
}

/// Sums over `N` x `N` pixels of a patch.
#[inline(always)]
fn sum<const N: usize>(planes: &[[[f32; STRIDE]; STRIDE]], columns: &Taps, rows: &Taps, out: &mut [[f32; CELL]; 3]) {
    let (along, across): ([[f32; CELL]; N], [[f32; CELL]; N]) = (columns.weights_over(), rows.weights_over());
    for (plane, out) in planes.iter().zip(out) {
        let Some(lines) = plane.get(rows.first..rows.first + N) else { continue };
        let mut sums = [0.0_f32; CELL];
        for (line, across) in lines.iter().zip(&across) {
            let Some(line) = line.get(columns.first..).and_then(|line| line.first_chunk::<WINDOW>()) else { continue };
            let mut values = [0.0_f32; CELL];
            for tap in 0..N {
                for i in 0..CELL {
                    values[i] += along[tap][i] * line[tap + i];
                }
            }
            for i in 0..CELL {
                sums[i] += across[i] * values[i];
            }
        }
        *out = sums;
    }
}
