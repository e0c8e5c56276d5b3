//! Observability of an estimate: evaluates the fitness landscape near and far from the estimate.
//!
//! The paper has no such evaluation. A high fitness does not prove an estimate: on a target of one hue in front of a background
//! of the same hue every hypothesis scores 1. The estimate is therefore evaluated by its rivals with a similar score, and by the
//! motion of the maximum if other points had been sampled (see [`survey`]).
//!
//! The evaluation is deterministic and does not know the ground truth; its limits are parameters of [`ObservabilityConfig`]. It
//! cannot detect a bias common to all points (a wrong calibration, relief). The spreads are therefore not reported as standard
//! deviations.

use pb3dp_estimation_core::status::{Status, Verdict};
use pb3dp_geometry::ranges;

use crate::search::Found;

pub mod survey;

/// Smallest distance of an estimate from an end of the search range, as a share of the depth. A closer estimate may be the
/// slope of a maximum outside the range.
const END_OF_RANGE_ROOM: f64 = 0.005;

/// Grids and limits of the evaluation.
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

    /// The status that follows from the spread near the estimate, with its reason. It does not consider other peaks.
    pub fn verdict_nearby(&self, spread: &Spread) -> Verdict {
        let (percent, degrees) = (100.0 * spread.depth, spread.tilt_rad.to_degrees());
        let (status, reason) = if spread.depth > self.depth_spread_sure {
            (Status::Ambiguous, depth_reason(spread.depth, self.depth_spread_sure))
        } else if spread.tilt_rad > self.tilt_spread_sure_rad {
            let limit_deg = self.tilt_spread_sure_rad.to_degrees();
            let reason = format!("the normal varies by {degrees:.1} degrees when resampled (limit {limit_deg:.1})");
            (Status::WeakTilt, reason)
        } else {
            (Status::Ok, format!("resampling moves the depth by {percent:.2} % and the normal by {degrees:.1} degrees"))
        };
        Verdict { status, reason }
    }
}

fn depth_reason(spread: f64, limit: f64) -> String {
    format!("the depth varies by {:.2} % when resampled (limit {:.2} %)", 100.0 * spread, 100.0 * limit)
}

/// Result of a survey of the whole search range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landscape {
    /// Number of hypotheses that were scored.
    pub hypotheses: usize,
    /// Highest fitness among them, including the estimate.
    pub fitness_highest: f64,
    /// Median fitness of the coarse grid.
    pub fitness_median: f64,
    /// Best hypothesis whose depth differs from the estimate's by more than `depth_spread_max`.
    pub runner_up: Option<Found>,
    /// Spread of the estimate.
    pub spread: Spread,
    /// Distance from the estimate to the near end of the search range, as a share of the depth.
    pub room_near: f64,
    /// The same to the far end.
    pub room_far: f64,
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
        if let Some(Found { psi, fitness }) = self.runner_up.filter(|rival| rival.fitness >= rival_min) {
            let (z_mm, highest) = (1000.0 * psi.z_m, self.fitness_highest);
            let reason = format!("another depth, {z_mm:.1} mm, reaches fitness {fitness:.3} of {highest:.3}");
            return Verdict { status: Status::Ambiguous, reason };
        }
        if self.spread.depth > config.depth_spread_max {
            let reason = depth_reason(self.spread.depth, config.depth_spread_max);
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
        config.verdict_nearby(&self.spread)
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

#[cfg(test)]
mod tests;
