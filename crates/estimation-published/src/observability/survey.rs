//! The survey of the fitness landscape.
//!
//! 1. The score is computed on a coarse grid over the whole search range and on a fine grid around the estimate. The best point
//!    at another depth climbs to its maximum.
//! 2. The model's points are divided into square blocks. Each resample draws as many blocks as there are, with replacement (a
//!    block bootstrap: neighbouring points are not independent), and finds the hypotheses whose fitness is highest within a
//!    small tolerance.
//! 3. The rms deviation of these maxima from the estimate, over all resamples, is the *spread*: of depth (relative) and of the
//!    normal (angle). A flat landscape gives a spread as wide as the search range; a rough or asymmetric one gives a spread
//!    that measures the influence of chance on the estimate.

use nalgebra::Vector2;
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::trig;

use super::{Landscape, ObservabilityConfig, Spread};
use crate::search::{Found, PlaneScore, REFUSED};

/// Nodes of the fine grid on either side of the estimate, in depth and in each tilt: with a coarse grid, and alone.
const FINE_HALF: i32 = 6;
const FINE_HALF_ALONE: i32 = 4;

/// Number of disparity bands in which rivals are searched.
const RIVAL_BANDS: usize = 8;
/// Largest number of steps of the climb to a rival's maximum.
const CLIMB_STEPS_MAX: usize = 16;

/// A hypothesis and its score.
type Scored = (PlaneHypothesis, i32);

/// An estimate, and the scores with which it is evaluated.
#[derive(Clone, Copy, Debug)]
pub struct Survey<'a, S> {
    /// Grids and limits.
    pub config: &'a ObservabilityConfig,
    /// Score of all points.
    pub whole: &'a S,
    /// Scores of disjoint parts of the points.
    pub blocks: &'a [S],
    /// The estimate to evaluate.
    pub answer: PlaneHypothesis,
    /// The searched range.
    pub range: SearchRange,
    /// Focal length times baseline, pixel metres: disparity = this / depth.
    pub focal_baseline_px_m: f64,
}

impl<S: PlaneScore> Survey<'_, S> {
    /// Surveys the whole search range and the neighbourhood of the estimate.
    pub fn landscape(&self) -> Landscape {
        let mut scored = self.scored(&self.coarse_grid());
        let median = median(scored.iter().map(|(_, score)| *score).collect());
        scored.extend(self.scored(&self.fine_grid(FINE_HALF)));
        let hypotheses = scored.len();
        let rival = self.runner_up(&scored);
        scored.extend(rival);
        let highest = scored.iter().map(|(_, score)| *score).max().unwrap_or(REFUSED);
        let fitness = |score: i32| f64::from(score) / f64::from(self.whole.score_max().max(1));
        Landscape {
            hypotheses,
            fitness_highest: fitness(highest),
            fitness_median: fitness(median),
            runner_up: rival.map(|(psi, score)| Found { psi, fitness: fitness(score) }),
            spread: self.spread(&candidates(scored, self.config.candidates_max)),
            room_near: 1.0 - self.range.z_min_m / self.answer.z_m,
            room_far: self.range.z_max_m / self.answer.z_m - 1.0,
        }
    }

    /// The spread from the fine grid only: fast enough for every frame of a tracker, but it misses other peaks.
    pub fn spread_nearby(&self) -> Spread {
        let scored = self.scored(&self.fine_grid(FINE_HALF_ALONE));
        self.spread(&candidates(scored, self.config.candidates_max))
    }

    /// Uniform in disparity and in both tilts, over the search range.
    fn coarse_grid(&self) -> Vec<PlaneHypothesis> {
        let tilt_max_rad = self.range.tilt_max_rad;
        let [far, near] = [self.range.z_max_m, self.range.z_min_m].map(|z_m| self.focal_baseline_px_m / z_m);
        let wanted = ((near - far) / self.config.disparity_step_px).ceil() as usize;
        let depth_steps = wanted.clamp(8, self.config.depth_nodes_max);
        let tilt_steps = 2 * (tilt_max_rad / self.config.coarse_tilt_step_rad).ceil() as usize;
        let disparities = (0..=depth_steps).map(|i| far + (near - far) * i as f64 / depth_steps as f64);
        let tilts = (0..=tilt_steps).map(|k| tilt_max_rad * (2.0 * k as f64 / tilt_steps.max(1) as f64 - 1.0));
        let tilts: Vec<f64> = tilts.collect();
        self.grid(disparities, &tilts, &tilts)
    }

    /// The estimate, and the nodes around it that are in the search range.
    fn fine_grid(&self, half: i32) -> Vec<PlaneHypothesis> {
        let nodes = |centre: f64, step: f64| (-half..=half).map(move |i| centre + step * f64::from(i));
        let disparities = nodes(self.focal_baseline_px_m / self.answer.z_m, 0.5 * self.config.disparity_step_px);
        let tilts = |centre_rad: f64| nodes(centre_rad, self.config.fine_tilt_step_rad).collect::<Vec<_>>();
        let mut grid = self.grid(disparities, &tilts(self.answer.theta_x_rad), &tilts(self.answer.theta_y_rad));
        grid.retain(|psi| self.range.contains(psi));
        grid.insert(0, self.answer);
        grid
    }

    fn grid(&self, disparities: impl Iterator<Item = f64>, x_rad: &[f64], y_rad: &[f64]) -> Vec<PlaneHypothesis> {
        let mut grid = Vec::new();
        for disparity_px in disparities {
            let z_m = self.focal_baseline_px_m / disparity_px;
            for &theta_x_rad in x_rad {
                grid.extend(y_rad.iter().map(|&theta_y_rad| PlaneHypothesis { z_m, theta_x_rad, theta_y_rad }));
            }
        }
        grid
    }

    /// The hypotheses that can be scored, with their scores.
    fn scored(&self, hypotheses: &[PlaneHypothesis]) -> Vec<Scored> {
        let scores = scores(self.whole, hypotheses);
        hypotheses.iter().copied().zip(scores).filter(|(_, score)| *score != REFUSED).collect()
    }

    /// Relative difference of the depth from the estimate's.
    fn depth_off(&self, psi: &PlaneHypothesis) -> f64 {
        psi.z_m / self.answer.z_m - 1.0
    }

    /// Whether a hypothesis is far from the estimate in depth.
    fn is_far(&self, psi: &PlaneHypothesis) -> bool {
        self.depth_off(psi).abs() > self.config.depth_spread_max
    }

    /// The best hypothesis far from the estimate in depth: in every band of disparities, the best one climbs to its maximum.
    fn runner_up(&self, scored: &[Scored]) -> Option<Scored> {
        let mut starts: [Option<Scored>; RIVAL_BANDS] = [None; RIVAL_BANDS];
        let (near, range) = (1.0 / self.range.z_min_m, 1.0 / self.range.z_min_m - 1.0 / self.range.z_max_m);
        for &(psi, score) in scored.iter().filter(|(psi, _)| self.is_far(psi)) {
            let share = (near - 1.0 / psi.z_m) / range;
            let start = &mut starts[((share * RIVAL_BANDS as f64) as usize).min(RIVAL_BANDS - 1)];
            if start.is_none_or(|(_, best)| score > best) {
                *start = Some((psi, score));
            }
        }
        starts.into_iter().flatten().map(|start| self.climb(start)).max_by_key(|(_, score)| *score)
    }

    /// The maximum near a hypothesis of the coarse grid, which rarely hits a narrow peak itself: repeatedly the best of the 26
    /// neighbours, with steps halved if none is better. Stays far from the estimate in depth.
    fn climb(&self, mut best: Scored) -> Scored {
        let mut disparity_step_px = 0.5 * self.config.disparity_step_px;
        let mut tilt_step_rad = 0.5 * self.config.coarse_tilt_step_rad;
        for _ in 0..CLIMB_STEPS_MAX {
            let disparity_px = self.focal_baseline_px_m / best.0.z_m;
            let neighbours: [PlaneHypothesis; 27] = std::array::from_fn(|k| {
                let [disparity, theta_x, theta_y] = [k % 3, k / 3 % 3, k / 9].map(|step| step as f64 - 1.0);
                PlaneHypothesis {
                    z_m: self.focal_baseline_px_m / (disparity_px + disparity * disparity_step_px),
                    theta_x_rad: best.0.theta_x_rad + theta_x * tilt_step_rad,
                    theta_y_rad: best.0.theta_y_rad + theta_y * tilt_step_rad,
                }
            });
            let scored = neighbours.iter().copied().zip(scores(self.whole, &neighbours));
            let better = scored.filter(|(psi, score)| *score > best.1 && self.range.contains(psi) && self.is_far(psi));
            match better.max_by_key(|(_, score)| *score) {
                Some(neighbour) => best = neighbour,
                None => (disparity_step_px, tilt_step_rad) = (0.5 * disparity_step_px, 0.5 * tilt_step_rad),
            }
        }
        best
    }

    /// Rms deviation of the maxima of all resamples.
    fn spread(&self, candidates: &[PlaneHypothesis]) -> Spread {
        if candidates.is_empty() || self.blocks.is_empty() {
            return Spread { depth: f64::INFINITY, tilt_rad: f64::INFINITY };
        }
        let normal = self.answer.normal();
        let squared_deviation = |psi: &PlaneHypothesis| {
            let other = psi.normal();
            let off = Vector2::new(self.depth_off(psi), trig::atan2(other.cross(&normal).norm(), other.dot(&normal)));
            off.component_mul(&off)
        };
        let deviations: Vec<Vector2<f64>> = candidates.iter().map(squared_deviation).collect();
        let block_scores: Vec<Vec<i32>> = self.blocks.iter().map(|block| scores(block, candidates)).collect();
        let mut rng = SplitMix64::new(1);
        let mut total = Vector2::zeros();
        for _ in 0..self.config.resamples {
            let (mut sums, mut score_max) = (vec![0_i32; candidates.len()], 0_i32);
            for _ in self.blocks {
                let drawn = rng.below(self.blocks.len() as u32) as usize;
                score_max = score_max.saturating_add(self.blocks[drawn].score_max());
                for (sum, score) in sums.iter_mut().zip(&block_scores[drawn]) {
                    *sum = sum.saturating_add(*score);
                }
            }
            let tolerance = (f64::from(score_max) * self.config.fitness_tolerance) as i32;
            let summit = sums.iter().copied().max().unwrap_or(REFUSED).saturating_sub(tolerance);
            let on_summit: Vec<_> = sums
                .iter()
                .zip(&deviations)
                .filter(|(sum, _)| **sum >= summit)
                .map(|(_, deviation)| deviation)
                .collect();
            total += on_summit.iter().copied().sum::<Vector2<f64>>() / on_summit.len() as f64;
        }
        let rms = (total / self.config.resamples as f64).map(f64::sqrt);
        Spread { depth: rms.x, tilt_rad: rms.y }
    }
}

fn scores<S: PlaneScore>(score: &S, hypotheses: &[PlaneHypothesis]) -> Vec<i32> {
    let mut scores = vec![REFUSED; hypotheses.len()];
    score.score(hypotheses, &mut scores);
    scores
}

/// The hypotheses that may win a resample: about the best `wanted`. From a larger plateau it takes a uniform selection.
pub(super) fn candidates(mut scored: Vec<Scored>, wanted: usize) -> Vec<PlaneHypothesis> {
    if scored.len() > wanted {
        let mut ranked: Vec<i32> = scored.iter().map(|(_, score)| *score).collect();
        let threshold = *ranked.select_nth_unstable(scored.len() - wanted).1;
        scored.retain(|(_, score)| *score >= threshold);
    }
    // Bresenham's rule: `wanted` of `reaching`, uniformly distributed.
    let reaching = scored.len().max(wanted);
    let is_chosen = |i: usize| (i + 1) * wanted / reaching > i * wanted / reaching;
    scored.into_iter().enumerate().filter(|(i, _)| is_chosen(*i)).map(|(_, (psi, _))| psi).collect()
}

fn median(mut scores: Vec<i32>) -> i32 {
    let middle = scores.len() / 2;
    if scores.is_empty() { REFUSED } else { *scores.select_nth_unstable(middle).1 }
}
