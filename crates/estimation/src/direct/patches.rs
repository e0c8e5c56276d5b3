//! Slanted patches: how far the right eye is off a plane, around every pixel of the region.
//!
//! The right window is warped by the plane, so that a pixel and its partner stand at the same place. Where the plane is wrong
//! by `e` pixels of disparity, the 15 x 15 neighbourhoods agree best after a shift by `-e / (1 - a)` columns (`a`: the
//! plane's slope along columns). The agreement is the zero-mean normalised cross-correlation of all whole shifts within a
//! reach, from running sums; a parabola gives the fraction.

mod fit;
mod kernels;

use self::fit::{PatchVotes, fit_votes};
use super::colour_planes::ColourPlanes;
use super::region_pyramid::{LevelPlane, RegionLevel, is_seen};
use super::search::volume::LevelBox;
use crate::cpu::Kernels;
use crate::error::{EstimationError, check_range};

/// Pixels from the centre of a patch to its side.
pub const RADIUS: usize = 7;
/// Side of a patch.
pub(super) const SIDE: usize = 2 * RADIUS + 1;
/// Most columns that a patch is shifted by.
pub const REACH_MAX: usize = 3;
/// Number of pixels of a patch.
pub(super) const PATCH_PX: f32 = (SIDE * SIDE) as f32;

/// Bit of [`RegionLevel::support`]: the pixel may be used, as far as its patch can tell.
pub const USABLE: u8 = 1;
/// Bit of [`RegionLevel::support`]: the pixel's patch has texture and agrees with the plane.
pub const SUPPORTS: u8 = 2;

/// Parameters of the patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchConfig {
    /// Columns that a patch is shifted by to both sides, 1 to [`REACH_MAX`].
    pub reach: usize,
    /// Farthest peak of a patch that supports the plane, pixels of the level.
    pub support_px: f64,
    /// Lowest correlation of a patch that supports the plane.
    pub correlation_min: f64,
    /// A patch whose luminance varies by less (standard deviation) says nothing.
    pub texture_min: f64,
    /// A patch with this mean gradient along the row (root mean square, luminance per pixel) has half the weight of a very
    /// sharp one.
    pub gradient_half: f64,
}

impl Default for PatchConfig {
    fn default() -> Self {
        Self { reach: 2, support_px: 0.5, correlation_min: 0.5, texture_min: 2.0, gradient_half: 1.0 }
    }
}

impl PatchConfig {
    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        let reach = (1.0, REACH_MAX as f64);
        check_range("direct patches reach_px", self.reach as f64, reach, "must be between 1 and 3 pixels")?;
        check_range("direct patches support_px", self.support_px, (0.1, 2.0), "must be between 0.1 and 2 pixels")?;
        let correlation = self.correlation_min;
        check_range("direct patches correlation_min", correlation, (0.0, 1.0), "must be between 0 and 1")?;
        check_range("direct patches texture_min", self.texture_min, (0.0, 100.0), "must be between 0 and 100")?;
        check_range("direct patches gradient_half", self.gradient_half, (0.0, 100.0), "must be between 0 and 100")
    }
}

/// What the patches say of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchOutcome {
    /// The plane, corrected by the supporting patches.
    pub plane: LevelPlane,
    /// Share of the region's pixels whose patch could be looked at and has texture.
    pub textured_share: f64,
    /// Share of the textured ones that support the given plane.
    pub support_share: f64,
    /// Mean correlation, at the given plane, of the supporting ones; 0 if there is none.
    pub mean_correlation: f64,
}

/// Evaluates patches; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct SlantedPatches {
    left: Vec<f32>,
    gradient: Vec<f32>,
    warped: Vec<f32>,
    rows: kernels::Rows,
    votes: PatchVotes,
}

impl SlantedPatches {
    /// Looks at all patches around `plane` and fits a better plane. Writes into `level.support` which pixels of the region
    /// agree with `plane` or have nothing to say.
    pub fn run(
        &mut self,
        level: &mut RegionLevel,
        plane: &LevelPlane,
        config: &PatchConfig,
        kernels: Kernels,
    ) -> PatchOutcome {
        let area = patch_box(level);
        let reach = config.reach.clamp(1, REACH_MAX);
        if area.width < SIDE || area.height < SIDE || level.right.window.width < 4 {
            level.reset_support();
            return Tally::default().outcome(level.area_px, *plane);
        }
        self.load(level, &area, plane, reach);
        self.votes.clear();
        level.support.fill(0);
        let window_width = level.left.window.width;
        let mut tally = Tally::default();
        self.rows.start(area.width, reach);
        for y in 0..area.height {
            self.rows.advance(y, area.width, &self.left, &self.gradient, &self.warped, kernels);
            if y + 1 < SIDE {
                continue;
            }
            self.rows.peaks(config, kernels);
            let (row, first) = (area.y + y - RADIUS, area.x + RADIUS);
            let range = row * window_width + first..row * window_width + area.x + area.width - RADIUS;
            let inside = &level.region[range.clone()];
            let support = &mut level.support[range];
            for (i, (inside, support)) in inside.iter().zip(support).enumerate() {
                if *inside != 0 {
                    let peak = self.rows.peak(i);
                    *support = tally.add(&peak, config);
                    if peak.weight > 0.0 && (i + y) % 2 == 0 {
                        self.votes.push((first + i) as f32, row as f32, peak.offset, peak.weight);
                    }
                }
            }
        }
        keep_unseen_pixels(level, &area);
        let correction = fit_votes(&mut self.votes, config.support_px, kernels);
        tally.outcome(level.area_px, corrected(plane, correction))
    }

    /// Copies the left window's part and warps the right window onto it, `reach` columns wider on both sides.
    fn load(&mut self, level: &RegionLevel, area: &LevelBox, plane: &LevelPlane, reach: usize) {
        let (width, wide) = (area.width, area.width + 2 * reach);
        self.left.resize(width * area.height, 0.0);
        self.gradient.resize(width * area.height, 0.0);
        self.warped.resize(wide * area.height, 0.0);
        let source = level.left.luminance();
        let mean = mean_of(&level.left, area);
        for y in 0..area.height {
            let row = &source.row(area.y + y)[area.x..area.x + width];
            let out = &mut self.left[y * width..(y + 1) * width];
            for (out, value) in out.iter_mut().zip(row) {
                *out = value - mean;
            }
            let gradient = &mut self.gradient[y * width..(y + 1) * width];
            gradient[0] = 0.0;
            gradient[width - 1] = 0.0;
            for (out, around) in gradient[1..width - 1].iter_mut().zip(row.windows(3)) {
                *out = 0.5 * (around[2] - around[0]);
            }
            let out = &mut self.warped[y * wide..(y + 1) * wide];
            warp_row(&level.right, area, y, plane, reach, mean, out);
        }
    }
}

/// The plane whose disparity is larger by `correction.0 + correction.1 x + correction.2 y` columns of shift.
fn corrected(plane: &LevelPlane, correction: Option<[f64; 3]>) -> LevelPlane {
    let Some(shift) = correction else { return *plane };
    // A shift by k columns of the warped image is a change of disparity by -k (1 - a).
    let factor = -(1.0 - plane.a);
    LevelPlane {
        a: plane.a + factor * shift[1],
        b: plane.b + factor * shift[2],
        c: plane.c + factor * shift[0],
        row: plane.row,
    }
}

/// Columns of the right image at the places of one row, cubic; the border is repeated.
fn warp_row(
    right: &ColourPlanes,
    area: &LevelBox,
    y: usize,
    plane: &LevelPlane,
    reach: usize,
    mean: f32,
    out: &mut [f32],
) {
    let y_left = (area.y + y) as f64;
    let row = (y_left as i64 + i64::from(plane.row)).clamp(0, right.window.height as i64 - 1) as usize;
    let source = right.luminance().row(row);
    let last = source.len() as f32 - 1.0;
    let first_x = area.x as f64 - reach as f64;
    let start = (first_x - (plane.c + plane.a * first_x + plane.b * y_left)) as f32;
    let step = (1.0 - plane.a) as f32;
    for (i, out) in out.iter_mut().enumerate() {
        let at = (start + step * i as f32).clamp(0.0, last);
        let floor = (at as usize).min(source.len().saturating_sub(2));
        let t = at - floor as f32;
        *out = if floor >= 1 && floor + 2 < source.len() {
            let [a, b, c, d] = [source[floor - 1], source[floor], source[floor + 1], source[floor + 2]];
            let (p, q) = (c - a, 2.0 * a - 5.0 * b + 4.0 * c - d);
            b + 0.5 * t * (p + t * (q + t * (3.0 * (b - c) + d - a))) - mean
        } else {
            source[floor] + t * (source[(floor + 1).min(source.len() - 1)] - source[floor]) - mean
        };
    }
}

/// The region's box, larger by a patch's radius where the window allows it.
fn patch_box(level: &RegionLevel) -> LevelBox {
    super::search::region_box(level, RADIUS)
}

fn mean_of(eye: &ColourPlanes, area: &LevelBox) -> f32 {
    let rows = (area.y..area.y + area.height).step_by(4);
    let (mut sum, mut count) = (0.0, 0);
    for y in rows {
        let row = &eye.luminance().row(y)[area.x..area.x + area.width];
        sum += row.iter().sum::<f32>();
        count += row.len();
    }
    sum / count.max(1) as f32
}

/// Pixels too near to the window's border for a patch keep the right to speak for themselves.
fn keep_unseen_pixels(level: &mut RegionLevel, area: &LevelBox) {
    let width = level.left.window.width;
    let (columns, rows) = (
        area.x + RADIUS..area.x + area.width - RADIUS.min(area.width),
        area.y + RADIUS..area.y + area.height - RADIUS.min(area.height),
    );
    for (i, (support, region)) in level.support.iter_mut().zip(&level.region).enumerate() {
        if *region != 0 && !(columns.contains(&(i % width)) && rows.contains(&(i / width))) {
            *support = USABLE;
        }
        if *support != 0 && !is_seen(level.left.flags[i]) {
            *support = 0;
        }
    }
}

/// What one patch says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Peak {
    /// Columns to the best agreement; beyond the reach if it lies at its end.
    pub offset: f32,
    /// Correlation there.
    pub correlation: f32,
    /// How much it counts; 0 without texture.
    pub weight: f32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    textured: usize,
    supporting: usize,
    correlation: f64,
}

impl Tally {
    /// Counts a pixel and says whether it is to be used.
    fn add(&mut self, peak: &Peak, config: &PatchConfig) -> u8 {
        if peak.weight <= 0.0 {
            return USABLE;
        }
        self.textured += 1;
        let supports =
            f64::from(peak.offset.abs()) <= config.support_px && f64::from(peak.correlation) >= config.correlation_min;
        if supports {
            self.supporting += 1;
            self.correlation += f64::from(peak.correlation);
        }
        if supports { SUPPORTS | USABLE } else { 0 }
    }

    fn outcome(&self, area_px: usize, plane: LevelPlane) -> PatchOutcome {
        PatchOutcome {
            plane,
            textured_share: self.textured as f64 / area_px.max(1) as f64,
            support_share: self.supporting as f64 / self.textured.max(1) as f64,
            mean_correlation: self.correlation / self.supporting.max(1) as f64,
        }
    }
}
