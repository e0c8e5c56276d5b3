//! Which pixels of the left eye take part.

use super::super::image_plane::PixelWindow;
use super::super::region_pyramid::{RegionLevel, is_seen};
use super::kernel::{PointSet, SHARING, TOUCHED, UNUSABLE};
use super::prepare::EyeChannels;

/// Side of the blocks in which points are ordered, pixels of the level.
pub(super) const BLOCK: usize = 8;
/// Number of pixels from which the limit of the gradient is taken.
const SAMPLE: usize = 1024;

/// Pixels to use, and how they are ordered into points; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Selection {
    /// Per pixel of the level's left window: 0 if it must not be used, 2 if it is well inside the region, else 1.
    pub mask: Vec<u8>,
    inner: Vec<u8>,
    scratch: Vec<u8>,
    candidates: Vec<Candidate>,
    sample: Vec<f32>,
    /// One past the last point of every block.
    pub block_ends: Vec<usize>,
    /// Block column and row of every block.
    pub block_places: Vec<(u32, u32)>,
}

#[derive(Clone, Copy, Debug)]
struct Candidate {
    x: u16,
    y: u16,
    inner: bool,
    energy: f32,
}

/// How the rows of the left part and the right planes go together.
#[derive(Clone, Copy, Debug)]
pub(super) struct RightRows {
    /// Row of the right planes minus row of the left level window.
    pub shift: i32,
    pub width: usize,
    pub height: usize,
}

impl Selection {
    /// Marks the supported pixels of a level that are at least `rim.0` pixels inside the region's outline: with 2 where they
    /// are at least `rim.1` pixels inside, else with 1. Returns the smallest window around them (pixels of the level's
    /// window) and their number.
    pub fn mark(&mut self, level: &RegionLevel, rim: (usize, usize)) -> Option<(PixelWindow, usize)> {
        let (width, height) = (level.left.window.width, level.left.window.height);
        self.mask.clone_from(&level.region);
        for _ in 0..rim.0 {
            erode(&mut self.mask, &mut self.scratch, width, height);
        }
        self.inner.clone_from(&self.mask);
        for _ in rim.0..rim.1 {
            erode(&mut self.inner, &mut self.scratch, width, height);
        }
        let pixels = self.mask.iter_mut().zip(&self.inner).zip(level.support.iter().zip(&level.left.flags));
        for ((mask, inner), (support, flag)) in pixels {
            *mask = (*mask + inner) * (support & u8::from(is_seen(*flag)));
        }
        bounds(&self.mask, width)
    }

    /// Orders the marked pixels into points: all of them, or the `points_max` with the strongest gradients along rows.
    /// Returns the number of points.
    pub fn collect(
        &mut self,
        level: &RegionLevel,
        left: &EyeChannels,
        channels: usize,
        points_max: usize,
        rows: &RightRows,
        out: &mut PointSet,
    ) -> usize {
        let part = left.part;
        self.find_candidates(level.left.window.width, left, channels);
        let limit = self.energy_limit(points_max);
        self.block_ends.clear();
        self.block_places.clear();
        let inside = |row: i32| row >= 0 && row < rows.height as i32;
        let row_of = |at: &Candidate| i32::from(at.y) + part.y + rows.shift;
        self.candidates.retain(|at| at.energy >= limit && inside(row_of(at)));
        let mut place = (u32::MAX, 0);
        for (i, at) in self.candidates.iter().enumerate() {
            let here = (u32::from(at.x) / BLOCK as u32, u32::from(at.y) / BLOCK as u32);
            if here != place {
                if i > 0 {
                    self.block_ends.push(i);
                }
                self.block_places.push(here);
                place = here;
            }
        }
        let count = self.candidates.len();
        if count > 0 {
            self.block_ends.push(count);
        }
        out.take(&self.candidates, left, channels);
        out.row_start.clear();
        out.row_start.extend(self.candidates.iter().map(|at| row_of(at) as u32 * rows.width as u32));
        out.fill_up(channels);
        count
    }

    fn find_candidates(&mut self, stride: usize, left: &EyeChannels, channels: usize) {
        let part = left.part;
        self.candidates.clear();
        for (first_y, first_x) in blocks(part.height).flat_map(|y| blocks(part.width).map(move |x| (y, x))) {
            for y in first_y.max(1)..(first_y + BLOCK).min(part.height - 1) {
                let mask = &self.mask[(part.y as usize + y) * stride + part.x as usize..][..part.width];
                for x in first_x.max(1)..(first_x + BLOCK).min(part.width - 1) {
                    if mask[x] != 0 {
                        let energy = left.planes[..channels].iter().map(|plane| {
                            let row = plane.row(y);
                            let usable = row[x - 1].max(row[x]).max(row[x + 1]) < TOUCHED;
                            if usable { (row[x + 1] - row[x - 1]).powi(2) } else { 0.0 }
                        });
                        self.candidates.push(Candidate {
                            x: x as u16,
                            y: y as u16,
                            inner: mask[x] == 2,
                            energy: energy.sum(),
                        });
                    }
                }
            }
        }
    }

    fn energy_limit(&mut self, points_max: usize) -> f32 {
        let count = self.candidates.len();
        if count <= points_max {
            return 0.0;
        }
        self.sample.clear();
        let step = (count / SAMPLE).max(1);
        self.sample.extend(self.candidates.iter().step_by(step).map(|at| at.energy));
        let dropped = (self.sample.len() as f64 * (1.0 - points_max as f64 / count as f64)) as usize;
        let last = self.sample.len() - 1;
        *self.sample.select_nth_unstable_by(dropped.min(last), f32::total_cmp).1
    }
}

impl PointSet {
    /// Takes places, values and gradients of candidates.
    fn take(&mut self, candidates: &[Candidate], left: &EyeChannels, channels: usize) {
        let (width, height) = (left.part.width, left.part.height);
        let centre = ((width as f32 - 1.0) / 2.0, (height as f32 - 1.0) / 2.0);
        refill(&mut self.x, candidates.iter().map(|at| f32::from(at.x) - centre.0));
        refill(&mut self.y, candidates.iter().map(|at| f32::from(at.y) - centre.1));
        refill(&mut self.unit, candidates.iter().map(|_| 1.0));
        refill(&mut self.inner, candidates.iter().map(|at| f32::from(u8::from(at.inner))));
        for (c, plane) in left.planes.iter().enumerate().take(channels) {
            let values = plane.values();
            let index = |at: &Candidate| usize::from(at.y) * width + usize::from(at.x);
            let smooth = |i: usize| (values[i - 1] + 4.0 * values[i] + values[i + 1]) * (1.0 / 6.0);
            let derivatives = |at: &Candidate| {
                let i = index(at);
                let (above, below) = (smooth(i - width), smooth(i + width));
                let worst = values[i - 1].max(values[i]).max(values[i + 1]).max(above).max(below);
                match worst < TOUCHED {
                    true => [
                        smooth(i),
                        0.5 * (values[i + 1] - values[i - 1]),
                        0.5 * (below - above),
                        values[i - 1] - 2.0 * values[i] + values[i + 1],
                    ],
                    false => [UNUSABLE, 0.0, 0.0, 0.0],
                }
            };
            let lists = [&mut self.value[c], &mut self.gradient_x[c], &mut self.gradient_y[c], &mut self.curvature[c]];
            let [value, gradient_x, gradient_y, curvature] = lists;
            for list in [&mut *value, &mut *gradient_x, &mut *gradient_y, &mut *curvature] {
                list.clear();
                list.reserve(candidates.len());
            }
            for at in candidates {
                let [v, x, y, xx] = derivatives(at);
                value.push(v);
                gradient_x.push(x);
                gradient_y.push(y);
                curvature.push(xx);
            }
        }
    }

    fn fill_up(&mut self, channels: usize) {
        let length = self.x.len().next_multiple_of(SHARING);
        for values in [&mut self.x, &mut self.y, &mut self.unit, &mut self.inner] {
            values.resize(length, 0.0);
        }
        self.row_start.resize(length, 0);
        for c in 0..channels {
            for values in [&mut self.value[c], &mut self.gradient_x[c], &mut self.gradient_y[c], &mut self.curvature[c]]
            {
                values.resize(length, 0.0);
            }
        }
    }
}

fn refill(values: &mut Vec<f32>, with: impl Iterator<Item = f32>) {
    values.clear();
    values.extend(with);
}

fn blocks(length: usize) -> impl Iterator<Item = usize> {
    (0..length).step_by(BLOCK)
}

/// Takes the outermost pixels off a mask; what the window cuts off has its outline there.
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
        let inside = row.iter().map(|&m| usize::from(m != 0)).sum::<usize>();
        if inside == 0 {
            continue;
        }
        count += inside;
        let left = row.iter().position(|&m| m != 0).unwrap_or(0);
        let right = row.iter().rposition(|&m| m != 0).unwrap_or(0);
        first = (first.0.min(left), first.1.min(y));
        last = (last.0.max(right), y);
    }
    (count > 0).then(|| {
        let (width, height) = (last.0 - first.0 + 1, last.1 - first.1 + 1);
        (PixelWindow { x: first.0 as i32, y: first.1 as i32, width, height }, count)
    })
}
