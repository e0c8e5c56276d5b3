//! Selection of the pixels of the left image that take part.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;
use pb3dp_estimation_views::image_plane::{ImagePlane, PixelWindow};
use pb3dp_estimation_views::region_pyramid::{RegionLevel, is_visible};

use super::super::search::ends_of;
use super::kernel::{PointSet, SHARING, TOUCHED, UNUSABLE};
use super::prepare::CameraChannels;

/// Side of the blocks in which points are ordered, pixels of the level. As in the prototype of ADR 7, not varied: the
/// covariance sums scores over the same blocks.
pub(super) const BLOCK: usize = 8;
/// Number of pixels from which the gradient limit is determined. Chosen by hand, not varied: the share of points above a
/// quantile of 1024 values is accurate to 1.6 % (sqrt(0.25 / 1024)).
const SAMPLE: usize = 1024;

/// How many of the marked pixels become points.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointLimits {
    /// Number of marked pixels.
    pub marked: usize,
    /// Largest number of points.
    pub points_max: usize,
}

/// Usable pixels and their order as points; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Selection {
    /// Per pixel of the level's left window: 0 if excluded, 2 if well inside the region, otherwise 1.
    pub mask: Vec<u8>,
    inner: Vec<u8>,
    scratch: Vec<u8>,
    /// Columns and rows of the points in the left part.
    places: Vec<[u16; 2]>,
    /// Squared gradients along rows of the left part, summed over the channels.
    energy: ImagePlane,
    sample: Vec<f32>,
    /// One past the last point of every block.
    pub block_ends: Vec<usize>,
    /// Block column and row of every block.
    pub block_places: Vec<(u32, u32)>,
}

/// Relation between the rows of the left part and the right planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct RightRows {
    /// Row of the right planes minus row of the left level window.
    pub shift: i32,
    pub width: usize,
    pub height: usize,
}

/// Distances of the points from the region's outline, pixels: for all points, and for those well inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rims {
    pub outer: usize,
    pub inner: usize,
}

impl Selection {
    /// Marks the supported pixels of a level: 2 inside the inner rim, 1 between the rims. Returns the smallest window around
    /// them (pixels of the level's window) and their number.
    pub fn mark(&mut self, level: &RegionLevel, rims: Rims) -> Option<(PixelWindow, usize)> {
        let (width, height) = (level.left.window.width, level.left.window.height);
        self.mask.clone_from(&level.region);
        for _ in 0..rims.outer {
            erode(&mut self.mask, &mut self.scratch, width, height);
        }
        self.inner.clone_from(&self.mask);
        for _ in rims.outer..rims.inner {
            erode(&mut self.inner, &mut self.scratch, width, height);
        }
        let pixels = self.mask.iter_mut().zip(&self.inner).zip(level.support.iter().zip(&level.left.flags));
        for ((mask, inner), (support, flag)) in pixels {
            *mask = (*mask + inner) * (support & u8::from(is_visible(*flag)));
        }
        bounds(&self.mask, width)
    }

    /// Orders the marked pixels into points: all of them, or those with the strongest gradients along rows.
    pub fn collect(
        &mut self,
        level: &RegionLevel,
        left: &CameraChannels,
        channels: usize,
        PointLimits { marked, points_max }: PointLimits,
        rows: &RightRows,
        kernels: Kernels,
    ) {
        let stride = level.left.window.width;
        let limit = if marked > points_max {
            self.measure_energy(left, channels, kernels);
            Some(self.energy_limit(stride, left, marked, points_max))
        } else {
            None
        };
        self.order(stride, left, limit, rows);
    }

    /// Number of points.
    pub fn count(&self) -> usize {
        self.places.len()
    }

    fn measure_energy(&mut self, left: &CameraChannels, channels: usize, kernels: Kernels) {
        let (width, height) = (left.part.width, left.part.height);
        self.energy.resize(width, height);
        for y in 0..height {
            let out = self.energy.row_mut(y);
            out.fill(0.0);
            for plane in &left.planes[..channels] {
                add_energy(kernels, plane.row(y), out);
            }
        }
    }

    /// The marks of a row of the left part.
    fn marks(&self, stride: usize, left: &CameraChannels, y: usize) -> &[u8] {
        &self.mask[(left.part.y as usize + y) * stride + left.part.x as usize..][..left.part.width]
    }

    fn energy_limit(&mut self, stride: usize, left: &CameraChannels, marked: usize, points_max: usize) -> f32 {
        let mut sample = std::mem::take(&mut self.sample);
        sample.clear();
        // A step without a common factor with the region's width spreads the samples over its columns.
        let (step, mut skip) = ((marked / SAMPLE).max(1), 0);
        for y in 1..left.part.height.saturating_sub(1) {
            let energies = self.energy.row(y).iter().zip(self.marks(stride, left, y));
            for (energy, _) in energies.filter(|(_, mark)| **mark != 0) {
                if skip == 0 {
                    sample.push(*energy);
                    skip = step;
                }
                skip -= 1;
            }
        }
        let dropped = (sample.len() as f64 * (1.0 - points_max as f64 / marked as f64)) as usize;
        let last = sample.len().saturating_sub(1);
        let limit =
            if sample.is_empty() { 0.0 } else { *sample.select_nth_unstable_by(dropped.min(last), f32::total_cmp).1 };
        self.sample = sample;
        limit
    }

    /// Orders the marked pixels with an energy of at least `limit` by blocks.
    fn order(&mut self, stride: usize, left: &CameraChannels, limit: Option<f32>, rows: &RightRows) {
        let part = left.part;
        let mut places = std::mem::take(&mut self.places);
        places.clear();
        self.block_ends.clear();
        self.block_places.clear();
        // Rows that exist in the right planes.
        let shown = |y: usize| (0..rows.height as i32).contains(&(y as i32 + part.y + rows.shift));
        for (first_y, first_x) in blocks(part.height).flat_map(|y| blocks(part.width).map(move |x| (y, x))) {
            let before = places.len();
            let columns = first_x.max(1)..(first_x + BLOCK).min(part.width - 1);
            for y in (first_y.max(1)..(first_y + BLOCK).min(part.height - 1)).filter(|&y| shown(y)) {
                let marks = &self.marks(stride, left, y)[columns.clone()];
                if let Some(limit) = limit {
                    let energies = &self.energy.row(y)[columns.clone()];
                    push_places(
                        columns.start,
                        y,
                        marks.iter().zip(energies).map(|(&m, &e)| m != 0 && e >= limit),
                        &mut places,
                    );
                } else {
                    push_places(columns.start, y, marks.iter().map(|&m| m != 0), &mut places);
                }
            }
            if places.len() > before {
                self.block_ends.push(places.len());
                self.block_places.push(((first_x / BLOCK) as u32, (first_y / BLOCK) as u32));
            }
        }
        self.places = places;
    }
}

/// Adds the selected positions of a part of a row.
#[inline(always)]
fn push_places(first_x: usize, y: usize, wanted: impl Iterator<Item = bool>, out: &mut Vec<[u16; 2]>) {
    let mut found = [[0_u16; 2]; BLOCK];
    let mut count = 0;
    for (i, wanted) in wanted.enumerate().take(BLOCK) {
        // Overwritten by the next one if not selected.
        found[count.min(BLOCK - 1)] = [(first_x + i) as u16, y as u16];
        count += usize::from(wanted);
    }
    out.extend_from_slice(&found[..count]);
}

impl PointSet {
    /// Stores the positions of the selected pixels; the last one, without weight, pads the last group.
    pub fn place(&mut self, selection: &Selection, level: &RegionLevel, part: &PixelWindow, rows: &RightRows) {
        let places = &selection.places;
        let (count, length) = (places.len(), places.len().next_multiple_of(SHARING));
        let centre = ((part.width as f32 - 1.0) / 2.0, (part.height as f32 - 1.0) / 2.0);
        for values in [&mut self.x, &mut self.y, &mut self.unit, &mut self.inner] {
            values.resize(length, 0.0);
        }
        self.row_start.resize(length, 0);
        self.at.resize(length, 0);
        let marks = &selection.mask[part.y as usize * level.left.window.width + part.x as usize..];
        for i in 0..length {
            let [x, y] = places[i.min(count - 1)];
            self.x[i] = f32::from(x) - centre.0;
            self.y[i] = f32::from(y) - centre.1;
            self.unit[i] = if i < count { 1.0 } else { 0.0 };
            let inner = marks[usize::from(y) * level.left.window.width + usize::from(x)] == 2;
            self.inner[i] = if inner { self.unit[i] } else { 0.0 };
            self.row_start[i] = (i32::from(y) + part.y + rows.shift) as u32 * rows.width as u32;
            self.at[i] = u32::from(y) * part.width as u32 + u32::from(x);
        }
    }

    /// Stores the values and gradients of the points.
    pub fn take(&mut self, left: &CameraChannels, channels: usize, kernels: Kernels) {
        for c in 0..channels {
            let out = [&mut self.value[c], &mut self.gradient_x[c], &mut self.gradient_y[c], &mut self.curvature[c]];
            let out = out.map(|values| {
                values.resize(self.at.len(), 0.0);
                values.as_mut_slice()
            });
            take_channel(kernels, left.planes[c].values(), left.part.width, &self.at, out);
        }
    }
}

wide! {
    /// Adds the squared gradients of a row, 0 for unusable values.
    fn add_energy(row: &[f32], out: &mut [f32]) = add_energy_kernel;
}

#[inline(always)]
fn add_energy_kernel(row: &[f32], out: &mut [f32]) {
    let width = row.len().min(out.len());
    if width < 3 {
        return;
    }
    let neighbours = row.iter().zip(&row[1..]).zip(&row[2..]);
    for (out, ((before, here), after)) in out[1..width - 1].iter_mut().zip(neighbours) {
        let step = after - before;
        let usable = *before < TOUCHED && *here < TOUCHED && *after < TOUCHED;
        *out += if usable { step * step } else { 0.0 };
    }
}

wide! {
    /// Value, gradients along columns and rows, and second derivative along columns at the positions `at` of a plane.
    fn take_channel(plane: &[f32], width: usize, at: &[u32], out: [&mut [f32]; 4]) = take_channel_kernel;
}

#[inline(always)]
fn take_channel_kernel(plane: &[f32], width: usize, at: &[u32], out: [&mut [f32]; 4]) {
    let [value, gradient_x, gradient_y, curvature] = out;
    let mut near = [[[0.0_f32; 4]; SHARING]; 3];
    let groups =
        at.chunks_exact(SHARING).zip(value.chunks_exact_mut(SHARING)).zip(gradient_x.chunks_exact_mut(SHARING));
    let others = gradient_y.chunks_exact_mut(SHARING).zip(curvature.chunks_exact_mut(SHARING));
    for (((at, value), gradient_x), (gradient_y, curvature)) in groups.zip(others) {
        for (j, near) in near.iter_mut().enumerate() {
            for (near, at) in near.iter_mut().zip(at) {
                let first = *at as usize + j * width - width - 1;
                match plane.get(first..first + 4) {
                    Some(four) => near.copy_from_slice(four),
                    // The last position of the plane has no fourth value, which is not needed.
                    None => near[..3].copy_from_slice(&plane[first..first + 3]),
                }
            }
        }
        for i in 0..SHARING {
            let [[a, b, c, _], [p, q, r, _], [u, v, w, _]] = [near[0][i], near[1][i], near[2][i]];
            let (above, below) = ((a + 4.0 * b + c) * (1.0 / 6.0), (u + 4.0 * v + w) * (1.0 / 6.0));
            let usable = p < TOUCHED && q < TOUCHED && r < TOUCHED && above < TOUCHED && below < TOUCHED;
            let keep = |value: f32, otherwise: f32| if usable { value } else { otherwise };
            value[i] = keep((p + 4.0 * q + r) * (1.0 / 6.0), UNUSABLE);
            gradient_x[i] = keep(0.5 * (r - p), 0.0);
            gradient_y[i] = keep(0.5 * (below - above), 0.0);
            curvature[i] = keep(p - 2.0 * q + r, 0.0);
        }
    }
}

fn blocks(length: usize) -> impl Iterator<Item = usize> {
    (0..length).step_by(BLOCK)
}

/// Removes the outermost pixels of a mask; parts cut off by the window have their outline there.
fn erode(mask: &mut [u8], scratch: &mut Vec<u8>, width: usize, height: usize) {
    scratch.clear();
    scratch.resize(mask.len(), 0);
    for (row, out) in mask.chunks_exact(width).zip(scratch.chunks_exact_mut(width)) {
        for ((out, before), (here, after)) in out[1..].iter_mut().zip(row).zip(row[1..].iter().zip(&row[2..])) {
            *out = before & here & after;
        }
    }
    mask.fill(0);
    for y in 1..height.saturating_sub(1) {
        let rows = scratch[(y - 1) * width..].iter().zip(&scratch[y * width..]).zip(&scratch[(y + 1) * width..]);
        for (out, ((above, here), below)) in mask[y * width..(y + 1) * width].iter_mut().zip(rows) {
            *out = above & here & below;
        }
    }
}

fn bounds(mask: &[u8], width: usize) -> Option<(PixelWindow, usize)> {
    let (mut first, mut last, mut count) = ((usize::MAX, usize::MAX), (0, 0), 0);
    for (y, row) in mask.chunks_exact(width.max(1)).enumerate() {
        let Some((left, right)) = ends_of(row) else { continue };
        count += row.iter().map(|&mark| usize::from(mark != 0)).sum::<usize>();
        first = (first.0.min(left), first.1.min(y));
        last = (last.0.max(right), y);
    }
    (count > 0).then(|| {
        let (width, height) = (last.0 - first.0 + 1, last.1 - first.1 + 1);
        (PixelWindow { x: first.0 as i32, y: first.1 as i32, width, height }, count)
    })
}
