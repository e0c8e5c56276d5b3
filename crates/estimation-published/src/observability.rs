//! Observability of an estimate: evaluates the fitness landscape near and far from the estimate.
//!
//! A high fitness does not prove an estimate: on a target of one hue in front of a background of the same hue every hypothesis
//! scores 1. The estimate is therefore evaluated by its rivals with a similar score, and by the motion of the maximum if other
//! points had been sampled:
//!
//! 1. The score is computed on a coarse grid over the whole search range and on a fine grid around the estimate.
//! 2. The model's points are divided into square blocks. Each resample draws as many blocks as there are, with replacement (a
//!    block bootstrap: neighbouring points are not independent), and finds the hypotheses whose fitness is highest within a
//!    small tolerance.
//! 3. The rms deviation of these maxima from the estimate, over all resamples, is the *spread*: of depth (relative) and of the
//!    normal (angle). A flat landscape gives a spread as wide as the search range; a rough or asymmetric one gives a spread
//!    that measures the influence of chance on the estimate.
//!
//! The probe is deterministic and does not know the ground truth; its limits are parameters of [`ObservabilityConfig`]. It
//! cannot detect a bias common to all points (a wrong calibration, relief). The spreads are therefore not reported as standard
//! deviations.

use nalgebra::Vector3;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::{Status, Verdict};
use pb3dp_estimation_core::trig;
use pb3dp_geometry::ranges;

use crate::search::{PlaneScore, REFUSED};

/// Nodes of the fine grid on either side of the estimate, in depth and in each tilt: with a coarse grid, and alone.
const FINE_HALF: i32 = 6;
const FINE_HALF_ALONE: i32 = 4;

/// Smallest distance of an estimate from an end of the search range, as a share of the depth. A closer estimate may be the
/// slope of a maximum outside the range.
const END_OF_RANGE_ROOM: f64 = 0.005;

/// Number of disparity bands in which rivals are searched.
const RIVAL_BANDS: usize = 8;
/// Largest number of steps of the climb to a rival's maximum.
const CLIMB_STEPS_MAX: usize = 16;

/// Grids and limits of the observability probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservabilityConfig {
    /// Step of the coarse grid in disparity at the model's centre, pixels, 0.1 to 20; the fine grid has half of it. Default 1.
    pub disparity_step_px: f64,
    /// Largest number of depths of the coarse grid, 8 to 1024; wide ranges are sampled more coarsely. Default 96.
    pub depth_nodes_max: usize,
    /// Largest tilt step of the coarse grid, radians. Default 15 degrees.
    pub coarse_tilt_step_rad: f64,
    /// Tilt step of the fine grid, radians. Default 5 degrees.
    pub fine_tilt_step_rad: f64,
    /// Blocks along each side of the region, 2 to 8. Default 4.
    pub blocks_per_side: u32,
    /// Number of resamples, 4 to 1000. Default 24.
    pub resamples: usize,
    /// Number of hypotheses used in the resamples, the best of the grids, 100 to 100000. Default 1000.
    pub candidates_max: usize,
    /// Hypotheses whose fitness is lower than a resample's highest by at most this count as equal to it. Default 0.01.
    pub fitness_tolerance: f64,
    /// Smallest height of the maximum above the median of the coarse grid; below: not observable. Default 0.1.
    pub height_min: f64,
    /// Largest spread of the depth, as a share of the depth; above: not observable. Default 0.05.
    pub depth_spread_max: f64,
    /// Spread of the depth, as a share of the depth, above which the estimate is ambiguous. Default 0.008: on real scenes
    /// nearly all depths below it were within 1 %.
    pub depth_spread_sure: f64,
    /// Share of the maximum's height that a depth farther away than `depth_spread_max` may reach; above: ambiguous. Default
    /// 0.85.
    pub runner_up_max: f64,
    /// Fitness below which the estimate is ambiguous, 0 to 1: positive and negative votes nearly balance. A high fitness proves
    /// nothing, but a low one does. Below zero: not observable. Default 0.35.
    pub fitness_sure: f64,
    /// Spread of the normal above which the tilt is weak, radians. Default 6 degrees.
    pub tilt_spread_sure_rad: f64,
}

impl Default for ObservabilityConfig {
    fn default() -> Self {
        Self {
            disparity_step_px: 1.0,
            depth_nodes_max: 96,
            coarse_tilt_step_rad: 15.0_f64.to_radians(),
            fine_tilt_step_rad: 5.0_f64.to_radians(),
            blocks_per_side: 4,
            resamples: 24,
            candidates_max: 1000,
            fitness_tolerance: 0.01,
            height_min: 0.1,
            depth_spread_max: 0.05,
            depth_spread_sure: 0.008,
            runner_up_max: 0.85,
            fitness_sure: 0.35,
            tilt_spread_sure_rad: 6.0_f64.to_radians(),
        }
    }
}

impl ObservabilityConfig {
    ranges! {
        pub fn validate "probe ";
        disparity_step_px, DISPARITY_STEP_PX: f64 = 0.1..=20.0;
        depth_nodes_max, DEPTH_NODES_MAX: usize = 8..=1024;
        coarse_tilt_step_rad, COARSE_TILT_STEP_RAD: f64 = 1f64.to_radians()..=45f64.to_radians();
        fine_tilt_step_rad, FINE_TILT_STEP_RAD: f64 = 0.5f64.to_radians()..=45f64.to_radians();
        blocks_per_side, BLOCKS_PER_SIDE: u32 = 2..=8;
        resamples, RESAMPLES: usize = 4..=1000;
        candidates_max, CANDIDATES_MAX: usize = 100..=100_000;
        fitness_tolerance, FITNESS_TOLERANCE: f64 = 0.0..=1.0;
        height_min, HEIGHT_MIN: f64 = 0.0..=1.0;
        depth_spread_max, DEPTH_SPREAD_MAX: f64 = 0.0..=1.0;
        depth_spread_sure, DEPTH_SPREAD_SURE: f64 = 0.0..=1.0;
        runner_up_max, RUNNER_UP_MAX: f64 = 0.0..=1.0;
        fitness_sure, FITNESS_SURE: f64 = 0.0..=1.0;
        tilt_spread_sure_rad, TILT_SPREAD_SURE_RAD: f64 = 0.3f64.to_radians()..=85f64.to_radians();
    }
}

impl ObservabilityConfig {
    /// The status that follows from the spreads of depth (relative) and normal (radians) near the estimate, with its reason. It
    /// does not consider other peaks.
    pub fn verdict_nearby(&self, depth_spread: f64, tilt_spread_rad: f64) -> Verdict {
        let (status, reason) = if depth_spread > self.depth_spread_sure {
            (Status::Ambiguous, depth_reason(depth_spread, self.depth_spread_sure))
        } else if tilt_spread_rad > self.tilt_spread_sure_rad {
            let (spread_deg, limit_deg) = (tilt_spread_rad.to_degrees(), self.tilt_spread_sure_rad.to_degrees());
            let reason = format!("the normal varies by {spread_deg:.1} degrees when resampled (limit {limit_deg:.1})");
            (Status::WeakTilt, reason)
        } else {
            let (percent, degrees) = (100.0 * depth_spread, tilt_spread_rad.to_degrees());
            (Status::Ok, format!("resampling moves the depth by {percent:.2} % and the normal by {degrees:.1} degrees"))
        };
        Verdict { status, reason }
    }
}

fn depth_reason(spread: f64, limit: f64) -> String {
    format!("the depth varies by {:.2} % when resampled (limit {:.2} %)", 100.0 * spread, 100.0 * limit)
}

/// A score and its highest possible value.
#[derive(Clone, Copy, Debug)]
pub struct Scored<S> {
    /// The score.
    pub score: S,
    /// Highest possible value; the fitness is the score divided by it.
    pub score_max: i32,
}

/// Result of the probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landscape {
    /// Number of hypotheses that were scored.
    pub hypotheses: usize,
    /// Highest fitness among them, including the estimate.
    pub fitness_highest: f64,
    /// Median fitness of the coarse grid.
    pub fitness_median: f64,
    /// Best hypothesis whose depth differs from the estimate's by more than `depth_spread_max`.
    pub runner_up: Option<RunnerUp>,
    /// Spread of the depth, as a share of the depth.
    pub depth_spread: f64,
    /// Spread of the normal, radians.
    pub tilt_spread_rad: f64,
    /// Distance from the estimate to the near end of the search range, as a share of the depth.
    pub room_near: f64,
    /// The same to the far end.
    pub room_far: f64,
}

/// The best hypothesis at another depth than the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunnerUp {
    /// The hypothesis.
    pub psi: PlaneHypothesis,
    /// Its fitness.
    pub fitness: f64,
}

/// Rms deviation of the resampled maxima from the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Deviation of the depth, as a share of the depth.
    pub depth: f64,
    /// Deviation of the normal, radians.
    pub tilt_rad: f64,
}

impl Landscape {
    /// The status that follows from these numbers, with its reason.
    pub fn verdict(&self, config: &ObservabilityConfig) -> Verdict {
        let height = self.fitness_highest - self.fitness_median;
        if height < config.height_min {
            return Verdict { status: Status::NotObservable, reason: self.flat_reason(height, config) };
        }
        if self.fitness_highest <= 0.0 {
            let reason = format!("more points disagree than agree: fitness {:.3}", self.fitness_highest);
            return Verdict { status: Status::NotObservable, reason };
        }
        let rival_min = self.fitness_median + config.runner_up_max * height;
        if let Some(RunnerUp { psi, fitness }) = self.runner_up.filter(|rival| rival.fitness >= rival_min) {
            let (z_mm, highest) = (1000.0 * psi.z_m, self.fitness_highest);
            let reason = format!("another depth, {z_mm:.1} mm, reaches fitness {fitness:.3} of {highest:.3}");
            return Verdict { status: Status::Ambiguous, reason };
        }
        if self.depth_spread > config.depth_spread_max {
            let reason = depth_reason(self.depth_spread, config.depth_spread_max);
            return Verdict { status: Status::NotObservable, reason };
        }
        if self.fitness_highest < config.fitness_sure {
            let (found, limit) = (self.fitness_highest, config.fitness_sure);
            let reason = format!("too few points agree: fitness {found:.3} (limit {limit:.2})");
            return Verdict { status: Status::Ambiguous, reason };
        }
        let (near, far) = (self.room_near, self.room_far);
        if near.min(far) < END_OF_RANGE_ROOM || near + far < 2.0 * config.depth_spread_max {
            return Verdict { status: Status::Ambiguous, reason: self.narrow_reason(config) };
        }
        config.verdict_nearby(self.depth_spread, self.tilt_spread_rad)
    }

    fn narrow_reason(&self, config: &ObservabilityConfig) -> String {
        let (near, far) = (self.room_near, self.room_far);
        format!(
            "the search range extends only {:.1} % of the depth before and {:.1} % behind the estimate: the target may be outside it; widen the range (each side needs {:.1} %, both together {:.0} %)",
            100.0 * near,
            100.0 * far,
            100.0 * END_OF_RANGE_ROOM,
            200.0 * config.depth_spread_max
        )
    }

    fn flat_reason(&self, height: f64, config: &ObservabilityConfig) -> String {
        format!(
            "the fitness is flat: its peak {:.3} is {height:.3} above the median of the search range (limit {:.2}); target and background may have the same hue",
            self.fitness_highest, config.height_min
        )
    }
}

/// Input of the probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeTarget {
    /// The estimate to evaluate.
    pub answer: PlaneHypothesis,
    /// The searched range.
    pub range: SearchRange,
    /// Focal length times baseline, pixel metres: disparity = this / depth.
    pub focal_baseline_px_m: f64,
}

/// The probe with its buffers.
#[derive(Clone, Debug)]
pub struct LandscapeProbe {
    config: ObservabilityConfig,
    hypotheses: Vec<PlaneHypothesis>,
    whole: Vec<i32>,
    /// Scores of the blocks, one row per block.
    blocks: Vec<i32>,
    /// Squared deviations from the estimate: relative depth, angle of the normal.
    deviations: Vec<(f64, f64)>,
    sums: Vec<i32>,
}

impl LandscapeProbe {
    /// A probe.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: ObservabilityConfig) -> Result<Self, EstimationError> {
        config.validate()?;
        let (hypotheses, whole, blocks) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { config, hypotheses, whole, blocks, deviations: Vec::new(), sums: Vec::new() })
    }

    /// The parameters.
    pub fn config(&self) -> &ObservabilityConfig {
        &self.config
    }

    /// Surveys the whole search range and the neighbourhood of the estimate. `blocks` are the scores of disjoint parts of the
    /// points of `whole`.
    pub fn survey<S: PlaneScore>(
        &mut self,
        whole: &Scored<S>,
        blocks: &[Scored<S>],
        target: &ProbeTarget,
    ) -> Landscape {
        self.hypotheses.clear();
        self.add_coarse_grid(target);
        let coarse = self.hypotheses.len();
        self.add_fine_grid(target, FINE_HALF);
        let coarse = self.score_whole(&whole.score, coarse);
        let fitness = |score: i32| f64::from(score) / f64::from(whole.score_max.max(1));
        let median = median(&mut self.whole[..coarse].to_vec());
        let hypotheses = self.hypotheses.len();
        self.measure_deviations(&target.answer);
        let rival = self.runner_up(&whole.score, target);
        if let Some((psi, score)) = rival {
            self.hypotheses.push(psi);
            self.whole.push(score);
        }
        let highest = self.whole.iter().copied().max().unwrap_or(REFUSED);
        let runner_up = rival.map(|(psi, score)| RunnerUp { psi, fitness: fitness(score) });
        self.keep_candidates();
        self.measure_deviations(&target.answer);
        let spread = self.spread(blocks);
        Landscape {
            hypotheses,
            fitness_highest: fitness(highest),
            fitness_median: fitness(median),
            runner_up,
            depth_spread: spread.depth,
            tilt_spread_rad: spread.tilt_rad,
            room_near: 1.0 - target.range.z_min_m / target.answer.z_m,
            room_far: target.range.z_max_m / target.answer.z_m - 1.0,
        }
    }

    /// As [`Self::survey`], on the fine grid only: fast enough for every frame of a tracker, but it misses other peaks.
    pub fn survey_nearby<S: PlaneScore>(
        &mut self,
        whole: &Scored<S>,
        blocks: &[Scored<S>],
        target: &ProbeTarget,
    ) -> Spread {
        self.hypotheses.clear();
        self.add_fine_grid(target, FINE_HALF_ALONE);
        self.score_whole(&whole.score, 0);
        self.keep_candidates();
        self.measure_deviations(&target.answer);
        self.spread(blocks)
    }

    /// Adds hypotheses with depths equidistant in disparity and tilts equidistant in angle.
    fn add_coarse_grid(&mut self, target: &ProbeTarget) {
        let range = &target.range;
        let (far, near) = (target.focal_baseline_px_m / range.z_max_m, target.focal_baseline_px_m / range.z_min_m);
        let wanted = ((near - far) / self.config.disparity_step_px).ceil() as usize;
        let depth_steps = wanted.clamp(8, self.config.depth_nodes_max);
        let tilt_steps = 2 * (range.tilt_max_rad / self.config.coarse_tilt_step_rad).ceil() as usize;
        let tilt = |k: usize| range.tilt_max_rad * (2.0 * k as f64 / tilt_steps.max(1) as f64 - 1.0);
        for i in 0..=depth_steps {
            let disparity_px = far + (near - far) * i as f64 / depth_steps as f64;
            let z_m = target.focal_baseline_px_m / disparity_px;
            for k in 0..=tilt_steps {
                for l in 0..=tilt_steps {
                    let psi = PlaneHypothesis { z_m, theta_x_rad: tilt(k), theta_y_rad: tilt(l) };
                    self.hypotheses.push(psi);
                }
            }
        }
    }

    fn add_fine_grid(&mut self, target: &ProbeTarget, half: i32) {
        let answer = &target.answer;
        let disparity_px = target.focal_baseline_px_m / answer.z_m;
        self.hypotheses.push(*answer);
        for i in -half..=half {
            let shifted_px = disparity_px + 0.5 * self.config.disparity_step_px * f64::from(i);
            if shifted_px <= 0.0 {
                continue;
            }
            let z_m = target.focal_baseline_px_m / shifted_px;
            for k in -half..=half {
                for l in -half..=half {
                    let psi = PlaneHypothesis {
                        z_m,
                        theta_x_rad: answer.theta_x_rad + self.config.fine_tilt_step_rad * f64::from(k),
                        theta_y_rad: answer.theta_y_rad + self.config.fine_tilt_step_rad * f64::from(l),
                    };
                    if target.range.contains(&psi) {
                        self.hypotheses.push(psi);
                    }
                }
            }
        }
    }

    /// Scores all hypotheses and removes those that cannot be scored; returns how many of the first `coarse` remain.
    fn score_whole<S: PlaneScore>(&mut self, score: &S, coarse: usize) -> usize {
        self.whole.clear();
        self.whole.resize(self.hypotheses.len(), REFUSED);
        score.score(&self.hypotheses, &mut self.whole);
        let mut kept = 0;
        let mut coarse_kept = 0;
        for i in 0..self.hypotheses.len() {
            if self.whole[i] != REFUSED {
                self.hypotheses[kept] = self.hypotheses[i];
                self.whole[kept] = self.whole[i];
                kept += 1;
                coarse_kept += usize::from(i < coarse);
            }
        }
        self.hypotheses.truncate(kept);
        self.whole.truncate(kept);
        coarse_kept
    }

    /// Keeps the hypotheses that may win a resample: about the best `candidates_max`. From a larger plateau it takes a uniform
    /// selection.
    fn keep_candidates(&mut self) {
        let (total, wanted) = (self.whole.len(), self.config.candidates_max);
        if total <= wanted {
            return;
        }
        let mut ranked = self.whole.clone();
        let threshold = *ranked.select_nth_unstable(total - wanted).1;
        let reaching = self.whole.iter().filter(|score| **score >= threshold).count();
        let (mut kept, mut seen) = (0, 0);
        for i in 0..total {
            if self.whole[i] >= threshold {
                // Bresenham's rule: `wanted` of `reaching`, uniformly distributed.
                if (seen + 1) * wanted / reaching > seen * wanted / reaching {
                    self.hypotheses[kept] = self.hypotheses[i];
                    kept += 1;
                }
                seen += 1;
            }
        }
        self.hypotheses.truncate(kept);
    }

    fn measure_deviations(&mut self, answer: &PlaneHypothesis) {
        let normal = answer.normal();
        self.deviations.clear();
        self.deviations.extend(self.hypotheses.iter().map(|psi| {
            let depth = psi.z_m / answer.z_m - 1.0;
            let angle = angle_between(&psi.normal(), &normal);
            (depth * depth, angle * angle)
        }));
    }

    /// The best hypothesis far from the estimate in depth: in every band of disparities, the best one climbs to its maximum.
    fn runner_up<S: PlaneScore>(&self, score: &S, target: &ProbeTarget) -> Option<(PlaneHypothesis, i32)> {
        let far = self.config.depth_spread_max * self.config.depth_spread_max;
        let mut starts: [Option<usize>; RIVAL_BANDS] = [None; RIVAL_BANDS];
        let (near, range) = (1.0 / target.range.z_min_m, 1.0 / target.range.z_min_m - 1.0 / target.range.z_max_m);
        for i in (0..self.hypotheses.len()).filter(|i| self.deviations[*i].0 > far) {
            let share = (near - 1.0 / self.hypotheses[i].z_m) / range;
            let start = &mut starts[((share * RIVAL_BANDS as f64) as usize).min(RIVAL_BANDS - 1)];
            if start.is_none_or(|best| self.whole[i] > self.whole[best]) {
                *start = Some(i);
            }
        }
        let summits =
            starts.into_iter().flatten().map(|i| self.climb(score, (self.hypotheses[i], self.whole[i]), target));
        summits.max_by_key(|(_, score)| *score)
    }

    /// The maximum near a hypothesis of the coarse grid, which rarely hits a narrow peak itself: repeatedly the best of the 26
    /// neighbours, with steps halved if none is better. Stays far from the estimate in depth.
    fn climb<S: PlaneScore>(
        &self,
        score: &S,
        start: (PlaneHypothesis, i32),
        target: &ProbeTarget,
    ) -> (PlaneHypothesis, i32) {
        let mut best = start;
        let (mut disparity_step_px, mut tilt_step_rad) =
            (0.5 * self.config.disparity_step_px, 0.5 * self.config.coarse_tilt_step_rad);
        let mut scores = [REFUSED; 27];
        for _ in 0..CLIMB_STEPS_MAX {
            let disparity_px = target.focal_baseline_px_m / best.0.z_m;
            let neighbours: [PlaneHypothesis; 27] = std::array::from_fn(|k| {
                let offset = |divisor: usize| (k / divisor % 3) as f64 - 1.0;
                PlaneHypothesis {
                    z_m: target.focal_baseline_px_m / (disparity_px + offset(1) * disparity_step_px),
                    theta_x_rad: best.0.theta_x_rad + offset(3) * tilt_step_rad,
                    theta_y_rad: best.0.theta_y_rad + offset(9) * tilt_step_rad,
                }
            });
            score.score(&neighbours, &mut scores);
            let allowed = |psi: &PlaneHypothesis| {
                let depth = psi.z_m / target.answer.z_m - 1.0;
                target.range.contains(psi) && depth.abs() > self.config.depth_spread_max
            };
            let better = neighbours.iter().zip(scores).filter(|(psi, score)| *score > best.1 && allowed(psi));
            match better.max_by_key(|(_, score)| *score) {
                Some((psi, score)) => best = (*psi, score),
                None => (disparity_step_px, tilt_step_rad) = (0.5 * disparity_step_px, 0.5 * tilt_step_rad),
            }
        }
        best
    }

    fn spread<S: PlaneScore>(&mut self, blocks: &[Scored<S>]) -> Spread {
        let n = self.hypotheses.len();
        if n == 0 || blocks.is_empty() {
            return Spread { depth: f64::INFINITY, tilt_rad: f64::INFINITY };
        }
        self.blocks.clear();
        self.blocks.resize(n * blocks.len(), REFUSED);
        for (row, block) in self.blocks.chunks_exact_mut(n).zip(blocks) {
            block.score.score(&self.hypotheses, row);
        }
        let mut rng = SplitMix64::new(1);
        let (mut depth, mut angle) = (0.0, 0.0);
        for _ in 0..self.config.resamples {
            let score_max = self.resample(blocks, &mut rng);
            let (d, a) = self.mean_deviation_of_summit(score_max);
            depth += d;
            angle += a;
        }
        let resamples = self.config.resamples as f64;
        Spread { depth: (depth / resamples).sqrt(), tilt_rad: (angle / resamples).sqrt() }
    }

    /// Draws blocks with replacement and adds their scores; returns the highest possible sum.
    fn resample<S>(&mut self, blocks: &[Scored<S>], rng: &mut SplitMix64) -> i32 {
        let n = self.hypotheses.len();
        self.sums.clear();
        self.sums.resize(n, 0);
        let mut score_max = 0_i32;
        for _ in 0..blocks.len() {
            let drawn = rng.below(blocks.len() as u32) as usize;
            score_max = score_max.saturating_add(blocks[drawn].score_max);
            for (sum, score) in self.sums.iter_mut().zip(&self.blocks[drawn * n..(drawn + 1) * n]) {
                *sum = sum.saturating_add(*score);
            }
        }
        score_max
    }

    fn mean_deviation_of_summit(&self, score_max: i32) -> (f64, f64) {
        let highest = self.sums.iter().copied().max().unwrap_or(REFUSED);
        let tolerance = (f64::from(score_max) * self.config.fitness_tolerance) as i32;
        let (mut count, mut depth, mut angle) = (0_usize, 0.0, 0.0);
        for (sum, deviation) in self.sums.iter().zip(&self.deviations) {
            if *sum >= highest.saturating_sub(tolerance) {
                count += 1;
                depth += deviation.0;
                angle += deviation.1;
            }
        }
        let count = count.max(1) as f64;
        (depth / count, angle / count)
    }
}

fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    trig::atan2(a.cross(b).norm(), a.dot(b))
}

fn median(scores: &mut [i32]) -> i32 {
    if scores.is_empty() {
        return REFUSED;
    }
    let middle = scores.len() / 2;
    *scores.select_nth_unstable(middle).1
}

#[cfg(test)]
mod tests;
