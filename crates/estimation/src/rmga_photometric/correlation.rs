//! How well the left points find themselves in the right eye: correlation, block by block.
//!
//! The points are shared out over blocks of the region. In every block the three channels (luminance and both chromas) of
//! left and right are freed of their means and compared by one normalised correlation. It counts by its square: a plane that
//! fits most blocks well beats one that fits all of them halfway, so what hides a part of the target costs that part only.
//! Gain, offset and slow shading of either eye do not matter.

use nalgebra::{UnitQuaternion, Vector2, Vector3};

use crate::cpu::Kernels;
use crate::direct::colour_planes::ColourPlanes;
use crate::direct::disparity_plane::{DisparityPlane, RectifiedGeometry};
use crate::direct::image_plane::ImagePlane;
use crate::direct::region_pyramid::{LevelPlane, RegionLevel};
use crate::plane_hypothesis::{PlaneHypothesis, SearchRange};
use crate::search::{PlaneScore, REFUSED};
use crate::wide::{LANES, sum_lanes, wide};

/// Score of a perfect correlation of all blocks.
pub(super) const SCORE_MAX: i32 = 1_000_000;
/// Variance that is taken for noise, squared grey levels per channel.
const NOISE_VARIANCE: f32 = 4.0;
/// A block is compared if this share of its points is seen.
const SEEN_SHARE_MIN: f32 = 0.5;
/// Number of channels.
const CHANNELS: usize = 3;

/// Points of the left eye, block after block; every block is filled up to whole groups of [`LANES`].
#[derive(Clone, Debug, Default)]
pub(super) struct PointBlocks {
    x: Vec<f32>,
    y: Vec<f32>,
    unit: Vec<f32>,
    row_start: Vec<u32>,
    value: [Vec<f32>; CHANNELS],
    blocks: Vec<Block>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Block {
    /// One past the last point.
    end: usize,
    /// Number of points.
    points: f32,
    /// What a perfect correlation scores: the points, less where noise is as strong as texture.
    score_max: f32,
}

/// What a set of points is made of.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointWish {
    /// Wanted number of points.
    pub points: usize,
    /// Blocks along each side of the region.
    pub blocks_per_side: usize,
}

impl PointBlocks {
    /// Takes points on a regular grid over the marked pixels of a level; `left` and `right` are its smoothed channels.
    pub fn take(&mut self, level: &RegionLevel, mask: &[u8], left: &[ImagePlane; 3], wish: &PointWish) {
        let width = level.left.window.width;
        let places = |step: usize| {
            let marked =
                mask.iter().enumerate().filter(|(_, mask)| **mask != 0).map(move |(i, _)| (i % width, i / width));
            marked.filter(move |(x, y)| x % step == 0 && y % step == 0)
        };
        let area = places(1).count();
        let step = ((area as f64 / wish.points.max(1) as f64).sqrt().floor() as usize).max(1);
        let bounds = places(step).fold(None, |bounds: Option<[usize; 4]>, (x, y)| {
            let b = bounds.unwrap_or([x, x, y, y]);
            Some([b[0].min(x), b[1].max(x), b[2].min(y), b[3].max(y)])
        });
        self.clear();
        let Some([x0, x1, y0, y1]) = bounds else { return };
        let side = wish.blocks_per_side.max(1);
        let part = |value: usize, low: usize, high: usize| (value - low) * side / (high - low + 1);
        let row_shift = level.left.window.y - level.right.window.y;
        let (rows, right_width) = (level.right.window.height as i32, level.right.window.width as u32);
        for block in 0..side * side {
            let start = self.x.len();
            for (x, y) in places(step).filter(|&(x, y)| part(y, y0, y1) * side + part(x, x0, x1) == block) {
                let row = y as i32 + row_shift;
                if level.left.flags[y * width + x] == 0 && (0..rows).contains(&row) {
                    self.push((x, y), row as u32 * right_width, left);
                }
            }
            self.close(start);
        }
    }

    /// Share of the points' contrast that stands above noise, 0 to 1.
    pub fn texture_share(&self) -> f64 {
        let (texture, points) = self.blocks.iter().fold((0.0, 0.0), |(t, n), b| (t + b.score_max, n + b.points));
        if points > 0.0 { f64::from(texture / points) } else { 0.0 }
    }

    fn clear(&mut self) {
        for values in [&mut self.x, &mut self.y, &mut self.unit].into_iter().chain(&mut self.value) {
            values.clear();
        }
        self.row_start.clear();
        self.blocks.clear();
    }

    fn push(&mut self, (x, y): (usize, usize), row_start: u32, left: &[ImagePlane; 3]) {
        self.x.push(x as f32);
        self.y.push(y as f32);
        self.unit.push(1.0);
        self.row_start.push(row_start);
        for (values, plane) in self.value.iter_mut().zip(left) {
            values.push(plane.row(y)[x]);
        }
    }

    /// Ends a block that began at `start`: means off, filled up, its texture found.
    fn close(&mut self, start: usize) {
        let count = self.x.len() - start;
        if count == 0 {
            return;
        }
        let points = count as f32;
        let mut variance = 0.0;
        for values in &mut self.value {
            let mean = values[start..].iter().sum::<f32>() / points;
            values[start..].iter_mut().for_each(|value| *value -= mean);
            variance += values[start..].iter().map(|value| value * value).sum::<f32>() / points;
        }
        let end = self.x.len().next_multiple_of(LANES);
        for values in [&mut self.x, &mut self.y, &mut self.unit].into_iter().chain(&mut self.value) {
            values.resize(end, 0.0);
        }
        self.row_start.resize(end, 0);
        let score_max = points * variance / (variance + CHANNELS as f32 * NOISE_VARIANCE);
        self.blocks.push(Block { end, points, score_max });
    }

    /// What all blocks score if every one correlates perfectly.
    fn score_sum(&self) -> f32 {
        self.blocks.iter().map(|block| block.score_max).sum::<f32>().max(1e-6)
    }
}

/// From hypotheses about the raw left camera to planes of a level.
#[derive(Clone, Debug)]
pub(super) struct Mapping {
    /// Ray of the region's centroid in `cam_left`, third component 1.
    pub raw_ray: Vector3<f64>,
    /// `cam_left_rect_from_cam_left`, the rotation.
    pub turn: UnitQuaternion<f64>,
    pub geometry: RectifiedGeometry,
    /// Centroid and corners of the region, rectified pixels.
    pub centroid_px: Vector2<f64>,
    pub corners_px: [Vector2<f64>; 4],
    pub range: SearchRange,
}

impl Mapping {
    fn plane(&self, psi: &PlaneHypothesis, level: &RegionLevel) -> Option<LevelPlane> {
        if !self.range.contains(psi) {
            return None;
        }
        let q = self.turn * psi.inverse_depth_plane(&self.raw_ray)?;
        let plane = DisparityPlane::from_inverse_depth_plane(&q, &self.geometry, self.centroid_px);
        let before = |corner: &Vector2<f64>| self.geometry.depth_m(plane.at(corner)).is_some();
        self.corners_px.iter().all(before).then(|| level.level_plane(&plane))
    }
}

/// The score of one frame, of all blocks or of one.
#[derive(Clone, Copy, Debug)]
pub(super) struct CorrelationScore<'a> {
    pub points: &'a PointBlocks,
    pub level: &'a RegionLevel,
    pub right: &'a [ImagePlane; 3],
    pub mapping: &'a Mapping,
    pub kernels: Kernels,
    /// The block that is scored alone.
    pub block: Option<usize>,
}

impl<'a> CorrelationScore<'a> {
    /// Every block by itself.
    pub fn parts(&self) -> impl Iterator<Item = Self> + use<'a> {
        let whole = *self;
        (0..whole.points.blocks.len()).map(move |block| Self { block: Some(block), ..whole })
    }

    /// The highest score that this part can reach.
    pub fn score_max(&self) -> i32 {
        let sum = self.points.score_sum();
        let share = |block: &Block| (SCORE_MAX as f32 * block.score_max / sum) as i32;
        match self.block {
            Some(block) => self.points.blocks.get(block).map_or(0, share),
            None => self.points.blocks.iter().map(share).sum(),
        }
    }

    fn score_one(&self, psi: &PlaneHypothesis) -> i32 {
        let Some(plane) = self.mapping.plane(psi, self.level) else { return REFUSED };
        let unit = SCORE_MAX as f32 / self.points.score_sum();
        let right = [self.right[0].values(), self.right[1].values(), self.right[2].values()];
        let (first, last) = self.block.map_or((0, self.points.blocks.len()), |block| (block, block + 1));
        let look = Look { c: plane.c as f32, a: plane.a as f32, b: plane.b as f32, width: self.right[0].width() };
        (first..last).map(|block| (unit * correlate(self.kernels, self.points, block, &right, &look)) as i32).sum()
    }
}

impl PlaneScore for CorrelationScore<'_> {
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]) {
        for (psi, score) in hypotheses.iter().zip(scores) {
            *score = self.score_one(psi);
        }
    }
}

/// Where points are looked up: right column = `x - (c + a x + b y)`.
#[derive(Clone, Copy, Debug)]
struct Look {
    c: f32,
    a: f32,
    b: f32,
    width: usize,
}

/// What a block scores, 0 to its `score_max`.
#[inline(always)]
fn correlate_kernel(points: &PointBlocks, block: usize, right: &[&[f32]; CHANNELS], look: &Look) -> f32 {
    let own = points.blocks[block];
    if look.width < 2 {
        return 0.0;
    }
    let first = block.checked_sub(1).map_or(0, |before| points.blocks[before].end);
    let mut seen = [0.0_f32; LANES];
    let mut sums = [[[0.0_f32; LANES]; 5]; CHANNELS];
    for start in (first / LANES..own.end / LANES).map(|group| group * LANES) {
        let (x, y, unit) = (lanes(&points.x, start), lanes(&points.y, start), lanes(&points.unit, start));
        let rows: &[u32; LANES] = points.row_start[start..].first_chunk().unwrap_or(&[0; LANES]);
        let (mut at, mut t, mut w) = ([0_u32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
        let last = look.width as f32 - 1.0;
        for i in 0..LANES {
            let column = x[i] - (look.c + look.a * x[i] + look.b * y[i]);
            w[i] = if column >= 0.0 && column < last { unit[i] } else { 0.0 };
            let column = column.max(0.0).min(last - 1.0);
            let whole = column as i32;
            t[i] = column - whole as f32;
            at[i] = rows[i].wrapping_add(whole as u32);
            seen[i] += w[i];
        }
        for c in 0..CHANNELS {
            let (mut near, mut far) = ([0.0_f32; LANES], [0.0_f32; LANES]);
            for i in 0..LANES {
                let two: &[f32; 2] = right[c].get(at[i] as usize..).and_then(|r| r.first_chunk()).unwrap_or(&[0.0; 2]);
                (near[i], far[i]) = (two[0], two[1]);
            }
            let value = lanes(&points.value[c], start);
            for i in 0..LANES {
                let (l, r) = (value[i], near[i] + t[i] * (far[i] - near[i]));
                let (wl, wr) = (w[i] * l, w[i] * r);
                sums[c][0][i] += wl;
                sums[c][1][i] += wr;
                sums[c][2][i] += wl * l;
                sums[c][3][i] += wl * r;
                sums[c][4][i] += wr * r;
            }
        }
    }
    let seen = sum_lanes(&seen);
    if seen < SEEN_SHARE_MIN * own.points || seen < 1.0 {
        return 0.0;
    }
    let noise = CHANNELS as f32 * NOISE_VARIANCE * seen;
    let (mut left, mut both, mut other) = (noise, 0.0, noise);
    for sums in &sums {
        let [l, r, ll, lr, rr] = [0, 1, 2, 3, 4].map(|k| sum_lanes(&sums[k]));
        left += (ll - l * l / seen).max(0.0);
        both += lr - l * r / seen;
        other += (rr - r * r / seen).max(0.0);
    }
    // The noise terms keep blank places from correlating; a perfect match of textured ones is scaled back to 1.
    let perfect = (left - noise) / left;
    let found = both.max(0.0) / (left * other).sqrt();
    let correlation = (found / perfect.max(1e-3)).min(1.0);
    own.score_max * correlation * correlation * (seen / own.points)
}

wide! {
    fn correlate(points: &PointBlocks, block: usize, right: &[&[f32]; CHANNELS], look: &Look) -> f32 = correlate_kernel;
}

#[inline(always)]
fn lanes(values: &[f32], start: usize) -> &[f32; LANES] {
    values[start..].first_chunk().unwrap_or(&[0.0; LANES])
}

/// The marked region grown by `margin_px`, as far as the window goes.
pub(super) fn grown(region: &[u8], planes: &ColourPlanes, margin_px: usize) -> Vec<u8> {
    let (width, height) = (planes.window.width, planes.window.height);
    let mut rows = vec![0_u8; region.len()];
    for y in 0..height {
        for x in (0..width).filter(|x| region[y * width + x] != 0) {
            rows[y * width..][x.saturating_sub(margin_px)..(x + margin_px + 1).min(width)].fill(1);
        }
    }
    let mut grown = vec![0_u8; region.len()];
    for y in 0..height {
        for v in y.saturating_sub(margin_px)..(y + margin_px + 1).min(height) {
            for x in 0..width {
                grown[v * width + x] |= rows[y * width + x];
            }
        }
    }
    grown
}
