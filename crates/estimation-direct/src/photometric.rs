//! Photometric refinement of a plane: minimises the difference between the left image and the right image warped by the plane.
//!
//! Gauss-Newton in the disparity plane `(d0, du, dv)` and a small row offset, from coarse to fine. Each channel (red, green,
//! blue) has its own gain and offset, which are eliminated in every step. Tukey's weights reject pixels that do not belong to
//! the plane. If the rows turn out to be misaligned, or one image is less sharp than the other, the channels are recomputed
//! with the rows moved and the sharper image smoothed, and the iteration continues. The covariance is a sandwich estimate from
//! the scores of pixel blocks, not the inverse of the Gauss-Newton matrix.

mod config;
mod covariance;
mod kernel;
mod level_rows;
mod points;
mod prepare;
mod sharpness;
mod solve;
mod start;

pub use config::RefineConfig;
use covariance::BlockPulls;
use kernel::{CHANNELS_MAX, ChannelState, PointSet, Shade, Sums, Thinning, Warp};
use nalgebra::{Matrix3, Vector2, Vector4};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_views::disparity_plane::DisparityPlane;
use pb3dp_estimation_views::front_end::{Side, StereoFrontEnd};
use pb3dp_estimation_views::image_plane::PixelWindow;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionLevel, RegionPyramid};
use points::{PointLimits, RightRows, Rims, Selection};
use prepare::{CameraChannels, ChannelRequest, Pair, Preparation, inside, reach_px, rows_of};
use sharpness::Sharpness;
use solve::{Normal, bounded_step, reliability, tukey_limit, tukey_moments};
use start::first_state;

/// Smallest number of points for a refinement. Chosen by hand, not varied: about seven for each of six fitted values; fewer
/// points leave the patch plane and `weak-tilt`.
const POINTS_MIN: usize = 40;
/// Lower bound of Tukey's initial residual limit, grey levels. Chosen: in the prototype of ADR 7 a start at 4 failed with
/// unequal gains.
const START_LIMIT_GREY: f64 = 15.0;
/// Step on the finest level at which the border is tested. Chosen by hand, not varied: before, the weights depend on the
/// start; no refinement with a border ends earlier.
const BORDER_JUDGED_AT: usize = 2;
/// The border is tested if the border and the interior each have this many points. Chosen by hand, not varied: mean squares
/// of 200 points scatter by 10 % (sqrt(2 / 200)), less than half of what rejects a border.
const BORDER_POINTS_MIN: f64 = 200.0;
/// The border is rejected if its mean weight is below this share of the interior's. Chosen by hand, not varied: with less,
/// a blurred border tilts the plane; with more, good borders are lost.
const BORDER_WEIGHT_MIN: f64 = 0.9;
/// The border is rejected if its mean square is above this multiple of the interior's. Chosen by hand, not varied: with
/// more, a blurred border tilts the plane; with less, good borders are lost.
const BORDER_SQUARES_MAX: f64 = 1.25;
/// The plane has converged if the last step moved no point of the region by more than this, pixels of the level. Chosen by
/// hand, not varied: without convergence, the answer is the patch plane.
const SETTLED_PX: f64 = 0.03;
/// The first steps use every n-th group of points, as long as enough points remain. Chosen: the real cases pass as without.
const THINNING_MAX: usize = 4;
const THINNED_POINTS: usize = 1200;
/// Thinning ends when a step moves no point of the region by more than this, pixels of the level. Chosen by hand, not
/// varied: only time depends on it, as the last steps use all points.
const THINNED_TO_PX: f64 = 0.1;
/// A step below this many standard deviations (by single-pixel noise) is small enough. Chosen: real cases pass as with steps of 0.006 px.
const SIGMAS_LEFT: f64 = 0.1;
/// Largest number of times that the channels are recomputed. Chosen by hand, not varied: time grows with it.
const PASSES_MAX: usize = 4;
/// Rows are moved if their offset reaches this, pixels: a smaller offset is linear. Chosen by hand, not varied: with less,
/// channels are computed again more often.
const ROWS_MOVED_FROM_PX: f64 = 0.1;
/// The sharper image is smoothed if the blur variances differ by this, squared pixels of the level. Chosen by hand, not
/// varied: a smaller difference is left to the covariance (`direct.refine.blur_sigma_px2`: 0.2).
const BLUR_EVENED_FROM_PX2: f64 = 0.3;
/// Largest ratio of noise to texture in the squared gradients; above it, both images are smoothed more. Chosen by hand, not
/// varied: with more, the step is less certain; with less, sharp texture is smoothed.
const NOISE_SHARE_MAX: f64 = 0.5;
/// Target value of this ratio for the smoothing. Chosen by hand, not varied: below [`NOISE_SHARE_MAX`], so that one
/// smoothing is enough.
const NOISE_SHARE: f64 = 0.3;
/// Largest smoothing, pixels of the level. Chosen by hand, not varied: with more, kernels mix more background into small
/// regions.
const SMOOTHING_MAX_PX: f64 = 1.6;
/// The background mixes into the border over this many standard deviations of the blur difference. Chosen by hand, not
/// varied: there, an edge with Gaussian blur has 2 % of the background.
const MIXED_SIGMAS: f64 = 2.0;
/// Lower bound of the residuals' standard deviation, grey levels. Derived: rounding alone leaves 1 / sqrt(12) = 0.29.
const SIGMA_MIN_GREY: f64 = 0.3;

/// A refined plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinedPlane {
    /// The plane, with the region's centroid as its reference pixel.
    pub plane: DisparityPlane,
    /// Covariance of `(d0, du, dv)` of [`Self::plane`]: pixels, and pixel per pixel.
    pub covariance: Matrix3<f64>,
    /// Row of the right image minus row of the left image, in addition to the pyramid's row offset, pixels.
    pub row_offset_px: f64,
    /// Blur variance of the right image minus that of the left image, compensated part only, squared pixels.
    pub blur_px2: f64,
    /// Share of the points that agree with the plane, 0 to 1.
    pub inlier_share: f64,
    /// Share of the points inside the right window, 0 to 1.
    pub visible_share: f64,
    /// Standard deviation of the residuals of agreeing points, grey levels of the first channel.
    pub residual_sigma: f64,
    /// Gain of the right image relative to the left: a right value is this times the left one.
    pub gain: f64,
    /// Number of points compared on the finest level.
    pub points: usize,
    /// Number of steps on all levels.
    pub iterations: usize,
    /// Whether the last step was small and the plane stayed close to its start.
    pub converged: bool,
}

/// Refines planes; keeps its buffers, so that it allocates only for a region larger than all previous ones.
#[derive(Clone, Debug, Default)]
pub struct PlaneRefiner {
    config: RefineConfig,
    kernels: Kernels,
    preparation: Preparation,
    selection: Selection,
    left: CameraChannels,
    right: CameraChannels,
    points: PointSet,
    made: Option<Made>,
    scores: [Vec<f32>; 4],
    pulls: BlockPulls,
}

/// State carried from level to level.
#[derive(Clone, Copy, Debug)]
struct Progress {
    plane: DisparityPlane,
    row_px: f64,
    /// Blur variance of the right image minus that of the left image, squared pixels of the level.
    blur_px2: f64,
    /// Smoothing of the sharper image, pixels of the level.
    smoothing_px: f64,
    states: Option<[ChannelState; CHANNELS_MAX]>,
    /// Initial channel states, if already known.
    first: Option<[ChannelState; CHANNELS_MAX]>,
    weights: [f64; CHANNELS_MAX],
    iterations: usize,
    settled: bool,
}

impl Progress {
    /// Standard deviations of the smoothing of the left and the right image that make both equally sharp, pixels of the level.
    fn smoothings_px(&self) -> (f64, f64) {
        let own = self.smoothing_px.powi(2);
        ((own + self.blur_px2.max(0.0)).sqrt(), (own - self.blur_px2.min(0.0)).sqrt())
    }
}

/// Input of the left image's points; they are reused if only the right image changes.
#[derive(Clone, Copy, Debug)]
struct Made {
    scale: usize,
    rims: Rims,
    /// The box of the marked pixels.
    bounds: PixelWindow,
    /// Number of marked pixels.
    marked: usize,
    request: ChannelRequest,
    channels: usize,
}

/// A level prepared for the comparison.
struct Prepared {
    /// The centre of the points, position in the left window.
    centre: Vector2<f64>,
    scale: f64,
    channels: usize,
    /// Half the extent of the points, pixels of the level.
    half: Vector2<f64>,
    /// Right column of the right planes minus left column of the left window, at shift zero.
    column_shift: f64,
    /// Row offset already applied to the right planes, pixels of the level.
    row_applied: f64,
    /// Whether some points are on a border that may be rejected.
    has_border: bool,
    /// Thinning for the first steps.
    thinning: Thinning,
    count: usize,
}

impl PlaneRefiner {
    /// A refiner with these parameters.
    pub fn new(config: RefineConfig, kernels: Kernels) -> Self {
        Self { config, kernels, ..Self::default() }
    }

    /// The parameters.
    pub fn config(&self) -> &RefineConfig {
        &self.config
    }

    /// Refines a plane on the supported pixels of a region; `pyramid` is built from `source`. `None` if there are too few
    /// pixels, or if the right window does not show them.
    pub fn refine(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        pyramid: &RegionPyramid,
        start: &DisparityPlane,
    ) -> Option<RefinedPlane> {
        let colours = [Side::Left, Side::Right].map(|side| pyramid.colours(side));
        let pair = Pair { front_end, source, colours, unit: pyramid.colour_scale() };
        self.made = None;
        let levels = pyramid.levels();
        let finest =
            levels.iter().position(|l| l.area_px <= self.config.area_max_px).unwrap_or(levels.len().max(1) - 1);
        let coarsest = (finest + self.config.levels_max.max(1) - 1).min(levels.len().max(1) - 1);
        let mut progress = Progress {
            plane: start.centred_at(pyramid.centroid_px()),
            row_px: 0.0,
            blur_px2: 0.0,
            smoothing_px: self.config.smoothing_px,
            states: None,
            first: None,
            weights: [1.0; CHANNELS_MAX],
            iterations: 0,
            settled: false,
        };
        for index in (finest + 1..=coarsest).rev() {
            let level = levels.get(index)?;
            if let Some(prepared) = self.prepare(&pair, level, &progress) {
                self.descend(level, &prepared, &mut progress, false);
            }
        }
        let level = levels.get(finest)?;
        let mut prepared = self.prepare(&pair, level, &progress)?;
        if self.smooth_more(level, &prepared, &mut progress) {
            prepared = self.prepare(&pair, level, &progress)?;
        }
        for _ in 1..PASSES_MAX {
            self.descend(level, &prepared, &mut progress, true);
            let sums = self.sums_there(level, &prepared, &progress)?;
            if !self.adapt(&sums, &prepared, &mut progress) {
                return self.finish(level, &prepared, &progress, &sums, start);
            }
            prepared = self.prepare(&pair, level, &progress)?;
        }
        self.descend(level, &prepared, &mut progress, true);
        let sums = self.sums_there(level, &prepared, &progress)?;
        self.finish(level, &prepared, &progress, &sums, start)
    }

    /// The sums over all points at the current state; `None` before the first step.
    fn sums_there(&self, level: &RegionLevel, prepared: &Prepared, progress: &Progress) -> Option<Sums> {
        let states = progress.states?;
        Some(self.accumulate(&self.warp(level, prepared, progress, &states), Thinning::NONE))
    }

    /// Increases the smoothing if noise dominates the gradients; returns whether it did.
    fn smooth_more(&self, level: &RegionLevel, prepared: &Prepared, progress: &mut Progress) -> bool {
        let states = self.start_states(level, prepared, progress);
        let sums = self.accumulate(&self.warp(level, prepared, progress, &states), prepared.thinning);
        let (texture, all) = sums
            .channel
            .iter()
            .take(prepared.channels)
            .fold((0.0, 0.0), |(texture, all), s| (texture + s.products.gs, all + s.products.gg));
        let noise_share = (all - texture) / texture.max(0.02 * all);
        if noise_share <= NOISE_SHARE_MAX {
            progress.first = Some(states);
            return false;
        }
        let wanted_px = progress.smoothing_px * (noise_share / NOISE_SHARE).powf(0.25);
        progress.smoothing_px = wanted_px.min(SMOOTHING_MAX_PX).max(progress.smoothing_px);
        true
    }

    /// Whether the channels must be recomputed, because rows or sharpness have changed since, or the plane has not converged.
    fn adapt(&self, sums: &Sums, prepared: &Prepared, progress: &mut Progress) -> bool {
        let (left, right) = progress.smoothings_px();
        let change = Sharpness { left_px: left, right_px: right }.difference_px2(&sums.sharpness);
        let blurred = change.abs() > BLUR_EVENED_FROM_PX2;
        if blurred {
            progress.blur_px2 += change;
        }
        !progress.settled
            || blurred
            || (progress.row_px - prepared.row_applied * prepared.scale).abs() > ROWS_MOVED_FROM_PX
    }

    /// Smooths both images around the region as mapped by the plane, and collects the points.
    fn prepare(&mut self, pair: &Pair<'_>, level: &RegionLevel, progress: &Progress) -> Option<Prepared> {
        let scale = level.scale as f64;
        let side_px = (level.area_px as f64).sqrt();
        let mixed_px = MIXED_SIGMAS * progress.blur_px2.abs().sqrt();
        let rim = |px: f64, share: f64| (px / scale + mixed_px).min(share * side_px).round() as usize;
        let c = &self.config;
        let outer = rim(c.erosion_min_px, 0.5 * c.erosion_share_max);
        let rims = Rims { outer, inner: rim(c.erosion_max_px, c.erosion_share_max).max(outer) };
        let known = self.made.filter(|made| (made.scale, made.rims) == (level.scale, rims));
        let (bounds, marked) = match known {
            Some(made) => (made.bounds, made.marked),
            None => self.selection.mark(level, rims)?,
        };
        if marked < POINTS_MIN {
            return None;
        }
        let (left_px, right_px) = progress.smoothings_px();
        let margin = reach_px(left_px.max(right_px)) as u32 + 1;
        let part = inside(&bounds.grown(margin), &level.left.window);
        let right_part = self.right_part(level, progress, &bounds, margin + 3)?;
        // Gradients along columns need one more row on either side.
        let request = ChannelRequest { part, rows: rows_of(&bounds.grown(1), 0, &part), smoothing_px: left_px };
        let known = known.filter(|made| made.request == request);
        let channels = match known {
            Some(made) => made.channels,
            None => self.preparation.left(pair, level, &request, &mut self.left),
        };
        self.made = Some(Made { scale: level.scale, rims, bounds, marked, request, channels });
        let rows = rows_of(&bounds, level.left.window.y - level.right.window.y, &right_part);
        let request = ChannelRequest { part: right_part, rows, smoothing_px: right_px };
        let row_px = if progress.row_px.abs() > ROWS_MOVED_FROM_PX { progress.row_px } else { 0.0 };
        self.preparation.right(pair, level, &request, row_px, channels, &mut self.right);
        let rows = RightRows {
            shift: level.left.window.y - level.right.window.y - right_part.y,
            width: right_part.width,
            height: right_part.height,
        };
        if known.is_none() {
            let limits = PointLimits { marked, points_max: self.config.points_max };
            self.selection.collect(level, &self.left, channels, limits, &rows, self.kernels);
        }
        self.points.place(&self.selection, level, &part, &rows);
        if known.is_none() {
            self.points.take(&self.left, channels, self.kernels);
        }
        let count = self.selection.count();
        let centre = Vector2::new(f64::from(part.x), f64::from(part.y))
            + Vector2::new(part.width as f64 - 1.0, part.height as f64 - 1.0) / 2.0;
        (count >= POINTS_MIN).then_some(Prepared {
            centre,
            scale,
            channels,
            half: Vector2::new(bounds.width as f64, bounds.height as f64) / 2.0,
            column_shift: -f64::from(right_part.x),
            row_applied: row_px / scale,
            has_border: rims.inner > rims.outer,
            thinning: Thinning { step: (count / THINNED_POINTS).clamp(1, THINNING_MAX) },
            count,
        })
    }

    /// The part of the right window that the points may need.
    fn right_part(
        &self,
        level: &RegionLevel,
        progress: &Progress,
        bounds: &PixelWindow,
        margin: u32,
    ) -> Option<PixelWindow> {
        let plane = level.level_plane(&progress.plane);
        let (x0, y0) = (f64::from(bounds.x), f64::from(bounds.y));
        let (x1, y1) = (x0 + bounds.width as f64, y0 + bounds.height as f64);
        let corners = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| x - (plane.c + plane.a * x + plane.b * y));
        let (low, high) = corners.iter().fold((f64::MAX, f64::MIN), |(low, high), &x| (low.min(x), high.max(x)));
        if !(low.abs() < 1e6 && high.abs() < 1e6) {
            return None;
        }
        let reach = (self.config.jump_max_px / level.scale as f64).ceil();
        let (low, high) = ((low - reach).floor() as i32, (high + reach).ceil() as i32);
        let wanted = PixelWindow {
            x: low,
            y: bounds.y + plane.row,
            width: (high - low + 1).max(1) as usize,
            height: bounds.height,
        };
        let part = inside(&wanted.grown(margin), &level.right.window);
        (part.width >= 6 && part.height >= 1).then_some(part)
    }

    fn warp(&self, level: &RegionLevel, prepared: &Prepared, progress: &Progress, states: &[ChannelState]) -> Warp {
        let plane = level.level_plane(&progress.plane);
        let at = prepared.centre;
        let column = at.x - (plane.c + plane.a * at.x + plane.b * at.y) + prepared.column_shift;
        Warp {
            column: column as f32,
            per_x: (1.0 - plane.a) as f32,
            per_y: -plane.b as f32,
            row: (progress.row_px / prepared.scale - prepared.row_applied) as f32,
            width: self.right.part.width,
            channels: prepared.channels,
            shades: std::array::from_fn(|c| states.get(c).map(Shade::from).unwrap_or_default()),
            place_variance: self.config.place_sigma_px.powi(2) as f32,
            limit: tukey_limit(prepared.channels) as f32,
        }
    }

    fn accumulate(&self, warp: &Warp, thinning: Thinning) -> Sums {
        kernel::accumulate(self.kernels, &self.points, &self.right_planes(), warp, thinning)
    }

    fn right_planes(&self) -> [&[f32]; CHANNELS_MAX] {
        std::array::from_fn(|c| self.right.planes[c].values())
    }

    /// Runs the Gauss-Newton steps on one level.
    fn descend(&mut self, level: &RegionLevel, prepared: &Prepared, progress: &mut Progress, finest: bool) {
        let channels = prepared.channels;
        let mut thinning = if progress.states.is_none() { prepared.thinning } else { Thinning::NONE };
        let mut states = progress.first.take().unwrap_or_else(|| self.start_states(level, prepared, progress));
        let steps = if finest { self.config.iterations_max } else { self.config.iterations_max.min(5) };
        let tolerance_px = if finest { 0.006 } else { 0.05 };
        progress.settled = false;
        for step_index in 0..steps {
            let warp = self.warp(level, prepared, progress, &states);
            if step_index >= BORDER_JUDGED_AT {
                thinning = Thinning::NONE;
            }
            let mut sums = self.accumulate(&warp, thinning);
            if finest && prepared.has_border && step_index == BORDER_JUDGED_AT {
                sums = self.drop_bad_border(&warp, sums);
            }
            let normal = self.normal(&sums, prepared, progress, &states);
            let Some(step) = bounded_step(&normal, &prepared.half) else { break };
            normal.move_states(&step, channels, &mut states);
            self.follow_scale(&sums, channels, &mut states, &mut progress.weights);
            apply(level, prepared, &step, progress);
            progress.iterations += 1;
            let size = step.x.abs() + (step.y * prepared.half.x).abs() + (step.z * prepared.half.y).abs();
            progress.settled = size < SETTLED_PX;
            let earliest = if prepared.has_border { BORDER_JUDGED_AT } else { 1 };
            let is_small = size < tolerance_px || (progress.settled && normal.sigmas(&step) < SIGMAS_LEFT);
            if is_small && step_index >= earliest && thinning == Thinning::NONE {
                break;
            }
            if size < THINNED_TO_PX {
                thinning = Thinning::NONE;
            }
        }
        progress.states = Some(states);
    }

    /// Excludes the border of the region if it agrees worse than the interior: if a camera is out of focus, the background
    /// mixes into the border.
    fn drop_bad_border(&mut self, warp: &Warp, all: Sums) -> Sums {
        let squares = |sums: &Sums| sums.channel.iter().take(warp.channels).map(|s| s.products.rr).sum::<f64>();
        let inner = &all.inner;
        let border_visible = all.visible - inner.visible;
        let (border_weight, border_squares) = (all.weight - inner.weight, squares(&all) - inner.squares);
        let enough = inner.visible >= BORDER_POINTS_MIN && border_visible >= BORDER_POINTS_MIN;
        let lost = border_weight / border_visible < BORDER_WEIGHT_MIN * inner.weight / inner.visible;
        let worse = border_squares * inner.weight > BORDER_SQUARES_MAX * inner.squares * border_weight;
        if enough && (lost || worse) {
            std::mem::swap(&mut self.points.unit, &mut self.points.inner);
            return self.accumulate(warp, Thinning::NONE);
        }
        all
    }

    fn normal(
        &self,
        sums: &Sums,
        prepared: &Prepared,
        progress: &Progress,
        states: &[ChannelState; CHANNELS_MAX],
    ) -> Normal {
        let mut normal = Normal::of(sums, prepared.channels, states, &progress.weights);
        let sigma = self.config.row_sigma_px.max(1e-6) / prepared.scale;
        normal.matrix[(3, 3)] += sigma.powi(-2);
        normal.slope[3] += progress.row_px / prepared.scale * sigma.powi(-2);
        normal
    }

    /// Updates variances and weights of the channels from the residuals and gradients.
    fn follow_scale(
        &self,
        sums: &Sums,
        channels: usize,
        states: &mut [ChannelState; CHANNELS_MAX],
        weights: &mut [f64; CHANNELS_MAX],
    ) {
        let squared = tukey_moments(channels).square;
        for c in 0..channels {
            let s = &sums.channel[c].products;
            let ratio = if s.usable > 0.0 { s.rr / (squared * s.usable) } else { 1.0 };
            states[c].variance = (states[c].variance * ratio.clamp(0.1, 2.0)).max(SIGMA_MIN_GREY.powi(2));
            weights[c] = reliability(s);
        }
    }

    /// Initial gains, offsets and variances of a level.
    fn start_states(
        &self,
        level: &RegionLevel,
        prepared: &Prepared,
        progress: &Progress,
    ) -> [ChannelState; CHANNELS_MAX] {
        let lowest = (START_LIMIT_GREY / tukey_limit(1).sqrt()).powi(2);
        if let Some(mut states) = progress.states {
            for state in &mut states {
                state.variance = (4.0 * state.variance).max(lowest);
            }
            return states;
        }
        let plain = [ChannelState { gain_root: 1.0, offset: 0.0, variance: 1.0 }; CHANNELS_MAX];
        let warp = self.warp(level, prepared, progress, &plain);
        std::array::from_fn(|c| match c < prepared.channels {
            true => first_state(&self.points, self.right.planes[c].values(), &warp, c, lowest),
            false => plain[c],
        })
    }

    fn finish(
        &mut self,
        level: &RegionLevel,
        prepared: &Prepared,
        progress: &Progress,
        sums: &Sums,
        start: &DisparityPlane,
    ) -> Option<RefinedPlane> {
        let states = progress.states?;
        let warp = self.warp(level, prepared, progress, &states);
        let normal = self.normal(sums, prepared, progress, &states);
        let length = self.points.x.len();
        for scores in &mut self.scores {
            scores.resize(length, 0.0);
        }
        let unmodelled = kernel::scores(
            self.kernels,
            &self.points,
            &std::array::from_fn(|c| self.right.planes[c].values()),
            &warp,
            &normal.projections(),
            &mut self.scores,
        );
        let row_information = (self.config.row_sigma_px.max(1e-6) / prepared.scale).powi(-2);
        self.pulls.sum(&self.scores, &self.selection.block_ends, &self.selection.block_places);
        let response = normal.matrix * tukey_moments(prepared.channels).response;
        let inverse = normal.matrix.try_inverse()?;
        let local = self.pulls.covariance(&response, row_information)?
            + covariance::unmodelled(&inverse, &unmodelled, &self.config, &prepared.half, prepared.scale);
        let centre_px = level.full_from_level(&prepared.centre);
        let floor = covariance::calibration(self.config.calibration_sigma_px, &(prepared.half * prepared.scale));
        let covariance = covariance::at_full_size(&local, prepared.scale) + floor;
        let covariance = covariance::moved(&covariance, &(progress.plane.centre_px - centre_px));
        let jump_px = (progress.plane.at(&progress.plane.centre_px) - start.at(&progress.plane.centre_px)).abs();
        let used: f64 = self.points.unit.iter().map(|&unit| f64::from(unit)).sum();
        let mean_weight = tukey_moments(prepared.channels).weight;
        let finite = covariance.iter().chain(progress.plane.parameters().iter()).all(|value| value.is_finite());
        finite.then_some(RefinedPlane {
            plane: progress.plane,
            covariance,
            row_offset_px: progress.row_px,
            blur_px2: progress.blur_px2 * prepared.scale * prepared.scale,
            inlier_share: (sums.weight / (mean_weight * sums.visible.max(1.0))).min(1.0),
            visible_share: sums.visible / used.max(1.0),
            residual_sigma: states[0].variance.sqrt(),
            gain: states[0].gain_root.powi(-2),
            points: prepared.count,
            iterations: progress.iterations,
            converged: progress.settled && jump_px <= self.config.jump_max_px,
        })
    }
}

fn apply(level: &RegionLevel, prepared: &Prepared, step: &Vector4<f64>, progress: &mut Progress) {
    let at = progress.plane.centred_at(level.full_from_level(&prepared.centre));
    let change = nalgebra::Vector3::new(step.x * prepared.scale, step.y, step.z);
    progress.plane = at.with_parameters(&(at.parameters() + change)).centred_at(progress.plane.centre_px);
    progress.row_px += step.w * prepared.scale;
}
