//! The skew of two cameras that nobody has stated, from a sequence.
//!
//! If the right camera exposes later by the skew `s`, a target whose row moves by `v` per second appears `s v` lower in the rectified right
//! image than in the left one. [`SkewWatch`] fits `offset + s v` to the row offsets of a tracked target; the offset, which may change across the
//! image, is that of the calibration. Motion along the rows shows in the disparity only, where it cannot be told from depth: it determines
//! nothing, and costs `z^2 / b` times `s` times the speed of the column.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Matrix4, UnitQuaternion, Vector2, Vector3, Vector4};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, TrackEstimate};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::rig_errors::{MOVED_SIGMAS, ROLL, SCALE};
use pb3dp_estimation_direct::row_measurement::{RegionRows, RowMeter};
use pb3dp_geometry::StereoRig;

/// Standard deviations before any pair: of the row offset that the calibration leaves, tangents (0.7 px at a focal length of 740 px), and of
/// the skew, seconds. Chosen by hand, not varied.
const OFFSET_SIGMA: f64 = 1e-3;
const SKEW_SIGMA_S: f64 = 0.02;
/// The same of the row offset's change along columns and rows, as of a rig that was knocked: a target that moves across the image passes them.
const SLOPE_SIGMAS: [f64; 2] = [MOVED_SIGMAS[ROLL], MOVED_SIGMAS[SCALE]];
/// The skew is determined if its standard deviation is at most this, seconds, from at least so many pairs; and it is no chance if it is this many
/// standard deviations, and seconds, long.
const DETERMINED_S: f64 = 2e-3;
const PAIRS_MIN: usize = 3;
const SIGNIFICANT_SIGMAS: f64 = 4.0;
const SIGNIFICANT_S: f64 = 1e-3;
/// A stated skew is contradicted if the motion differs by so many standard deviations and seconds. Chosen by hand, not varied: fast swings are
/// wrong by up to 2 ms.
const CONTRADICTS_SIGMAS: f64 = 5.0;
const CONTRADICTS_S: f64 = 6e-3;
/// Measurement ends at this standard deviation, seconds, or after so many pairs. Chosen by hand, not varied.
const ENOUGH_S: f64 = 3e-4;
const PAIRS_MAX: usize = 150;
/// The skew of an example, seconds.
const EXAMPLE_S: f64 = 0.01;
/// Error of a skew as a share of it, by motion that changes between the pairs: 28.1 to 30 of 30 ms, 19 to 21.6 of 20 ms were found.
const MODEL_SHARE: f64 = 0.04;
/// Pairs from which the motion of the middle one follows. Chosen by hand, not varied: with fewer, the acceleration is mostly noise.
const WINDOW: usize = 5;
/// Standard deviations of the pose from which a cost matters. Chosen by hand, not varied.
const COST_SIGMAS: f64 = 3.0;
/// Residual beyond which a pair loses weight (Huber), standard deviations.
const HUBER: f64 = 2.0;

/// A skew with its standard deviation, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skew {
    /// Middle of the right exposure minus middle of the left one.
    pub skew_s: f64,
    /// Standard deviation.
    pub sigma_s: f64,
}

/// A tracked pair.
#[derive(Clone, Copy, Debug)]
struct Observed {
    at_s: f64,
    /// Column and row of the target in the rectified left image, tangents.
    place: Vector2<f64>,
    assumed_s: f64,
    rows: Option<RegionRows>,
    depth_m: f64,
    /// Rotation of the target, and standard deviations of its depth and its tilt.
    turn: UnitQuaternion<f64>,
    sigmas: [f64; 2],
}

/// Row offset against the motion of the row, tangents, tangents per second and per second squared.
#[derive(Clone, Copy, Debug)]
struct Sample {
    place: Vector2<f64>,
    speed: f64,
    acceleration: f64,
    /// The skew with which the target was followed, seconds: its place is that of the middle between both images if it was none.
    assumed_s: f64,
    offset: f64,
    sigma: f64,
}

/// Estimates the skew from the pairs of a tracked target.
#[derive(Clone, Debug)]
pub struct SkewWatch {
    meter: RowMeter,
    at_s: f64,
    newest: VecDeque<Observed>,
    samples: Vec<Sample>,
    pairs: usize,
    /// Error of the depth and of the tilt per second of skew, metres and radians per second, and the larger of both in standard deviations.
    costs: Vec<[f64; 3]>,
    /// The same at the newest pair.
    newest_cost: Option<[f64; 3]>,
    /// The skew that was told.
    reported: Option<Skew>,
}

impl SkewWatch {
    /// No pair yet.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn new(rig: &StereoRig) -> Result<Self, EstimationError> {
        Ok(Self {
            meter: RowMeter::new(rig, Kernels::best())?,
            at_s: 0.0,
            newest: VecDeque::with_capacity(WINDOW),
            samples: Vec::new(),
            pairs: 0,
            costs: Vec::new(),
            newest_cost: None,
            reported: None,
        })
    }

    /// Whether more pairs would not tell more.
    pub fn is_done(&self) -> bool {
        self.pairs >= PAIRS_MAX
            || self.skew().is_some_and(|skew| skew.sigma_s < ENOUGH_S.hypot(MODEL_SHARE * skew.skew_s))
    }

    /// Takes a pair, `dt_s` after the one before, that was tracked with an assumed skew.
    pub fn take(
        &mut self,
        images: (ImageView<'_>, ImageView<'_>),
        (dt_s, assumed_s): (f64, f64),
        estimate: &TrackEstimate,
    ) {
        let has_changed = self.newest.back().is_some_and(|last| (last.assumed_s - assumed_s).abs() > SIGNIFICANT_S);
        if dt_s <= 0.0 || has_changed {
            // Another round of a recording, or places of another kind.
            self.newest.clear();
        }
        self.at_s += dt_s;
        let is_done = self.is_done();
        self.pairs += 1;
        self.newest_cost = None;
        let Some(pose) = estimate.cam_left_from_model.filter(|_| estimate.status.depth_is_sure()) else {
            self.newest.clear();
            return;
        };
        let depth_m = pose.translation_m().z;
        let rows = if is_done { None } else { self.meter.measure_region(images, &estimate.outline_px, depth_m) };
        if self.newest.len() == WINDOW {
            self.newest.pop_front();
        }
        let sigma =
            |index: usize| estimate.covariance.map_or(0.0, |covariance| covariance[(index, index)].max(0.0).sqrt());
        let sigmas = [sigma(2), sigma(3).hypot(sigma(4))];
        let place = self.meter.left_ray(&pose.translation_m());
        self.newest.push_back(Observed {
            at_s: self.at_s,
            place,
            assumed_s,
            rows,
            depth_m,
            turn: pose.rotation(),
            sigmas,
        });
        self.note_cost();
        self.note_rows();
    }

    /// Speed of the target around a pair of the newest ones, tangents and radians per second.
    fn speed(&self, middle: usize) -> Option<(Vector2<f64>, f64)> {
        let (first, last) = (self.newest.get(middle.saturating_sub(1))?, self.newest.get(middle + 1)?);
        let duration_s = last.at_s - first.at_s;
        let speed = (last.place - first.place) / duration_s;
        speed.iter().all(|x| x.is_finite()).then(|| (speed, first.turn.angle_to(&last.turn) / duration_s))
    }

    fn note_cost(&mut self) {
        let index = self.newest.len().saturating_sub(2);
        let (Some((speed, turned_per_s)), Some(middle)) = (self.speed(index), self.newest.get(index)) else { return };
        let baselines = middle.depth_m / self.meter.baseline_m();
        // A turn by an angle between the exposures shears the disparities of the target by as much.
        let per_s = [baselines * middle.depth_m * speed.x.abs(), baselines * turned_per_s];
        let in_sigmas = |index: usize| per_s[index] / middle.sigmas[index].max(f64::MIN_POSITIVE);
        let cost = [per_s[0], per_s[1], in_sigmas(0).max(in_sigmas(1))];
        self.newest_cost = Some(cost);
        if self.costs.len() < PAIRS_MAX {
            self.costs.push(cost);
        }
    }

    fn note_rows(&mut self) {
        let Some(middle) = self.newest.len().checked_sub(2).filter(|middle| *middle > 0) else { return };
        let (Some((speed, _)), Some(observed)) = (self.speed(middle), self.newest.get(middle)) else { return };
        let (at_s, place, Some(rows)) = (observed.at_s, observed.place, observed.rows) else { return };
        let acceleration = acceleration(self.newest.iter().map(|observed| (observed.at_s - at_s, observed.place.y)));
        let assumed_s = observed.assumed_s;
        self.samples.push(Sample {
            place,
            speed: speed.y,
            acceleration,
            assumed_s,
            offset: rows.offset,
            sigma: rows.sigma,
        });
    }

    /// The skew so far; `None` without a pair that shows the rows of the target.
    pub fn skew(&self) -> Option<Skew> {
        if self.samples.len() < PAIRS_MIN {
            return None;
        }
        let sigmas = Vector4::new(OFFSET_SIGMA, SKEW_SIGMA_S, SLOPE_SIGMAS[0], SLOPE_SIGMAS[1]);
        let prior = Matrix4::from_diagonal(&sigmas.map(|sigma| sigma.powi(-2)));
        let mut found: Vector4<f64> = Vector4::zeros();
        let mut covariance = Matrix4::zeros();
        for _ in 0..5 {
            let (mut information, mut pull) = (prior, Vector4::zeros());
            let (mut squares, mut count) = (0.0, 0.0);
            for Sample { place, speed, acceleration, assumed_s, offset, sigma } in &self.samples {
                let by = Vector4::new(1.0, speed + 0.5 * assumed_s * acceleration, place.x, place.y);
                let residual = (offset - by.dot(&found)) / sigma;
                let weight = (HUBER / residual.abs().max(HUBER)).min(1.0);
                information += by * by.transpose() * (weight / sigma.powi(2));
                pull += by * (weight * offset / sigma.powi(2));
                squares += weight * residual * residual;
                count += weight;
            }
            covariance = information.try_inverse()?;
            found = covariance * pull;
            // Neighbouring pairs share errors of the texture, which their own scatter shows.
            covariance *= (squares / f64::max(count - 4.0, 1.0)).max(1.0);
        }
        Some(Skew { skew_s: found.y, sigma_s: covariance[(1, 1)].sqrt().hypot(MODEL_SHARE * found.y) })
    }

    /// The skew, if it is determined and no chance.
    pub fn found(&self) -> Option<Skew> {
        self.skew().filter(|Skew { skew_s, sigma_s }| {
            *sigma_s <= DETERMINED_S && skew_s.abs() > f64::max(SIGNIFICANT_SIGMAS * sigma_s, SIGNIFICANT_S)
        })
    }

    /// What there is to tell of the newest pair: the skew once it is found, and again when it is known twice as well; before, what an unknown
    /// one costs at its speed.
    pub fn news(&mut self) -> Option<EstimateWarning> {
        let Some(found) = self.found() else { return self.warning(self.newest_cost?) };
        if self.reported.is_some_and(|reported| found.sigma_s > 0.5 * reported.sigma_s) {
            return None;
        }
        self.reported = Some(found);
        Some(EstimateWarning::Skewed { skew_ms: 1e3 * found.skew_s, sigma_ms: 1e3 * found.sigma_s })
    }

    /// That the motion contradicts the skew that is stated, once.
    pub fn contradiction(&mut self, stated_s: f64) -> Option<EstimateWarning> {
        let Skew { skew_s, sigma_s } =
            self.skew().filter(|skew| self.reported.is_none() && skew.sigma_s <= DETERMINED_S)?;
        if (skew_s - stated_s).abs() <= f64::max(CONTRADICTS_SIGMAS * sigma_s, CONTRADICTS_S) {
            return None;
        }
        self.reported = Some(Skew { skew_s, sigma_s });
        let [stated_ms, skew_ms, sigma_ms] = [stated_s, skew_s, sigma_s].map(|time_s| 1e3 * time_s);
        Some(EstimateWarning::SkewContradicted { stated_ms, skew_ms, sigma_ms })
    }

    /// What an unknown skew costs at most pairs, if the motion does not tell it and the cost counts.
    pub fn cost(&self) -> Option<EstimateWarning> {
        let median = |index: usize| {
            let mut sorted: Vec<f64> = self.costs.iter().map(|cost| cost[index]).collect();
            sorted.sort_by(f64::total_cmp);
            sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
        };
        self.warning([0, 1, 2].map(median))
    }

    /// Names a cost, unless it does not count or the skew is determined.
    fn warning(&self, cost_per_s: [f64; 3]) -> Option<EstimateWarning> {
        let is_determined = self.skew().is_some_and(|skew| skew.sigma_s <= DETERMINED_S);
        let [depth_m, tilt_rad, in_sigmas] = cost_per_s.map(|per_s| EXAMPLE_S * per_s);
        (!is_determined && in_sigmas > COST_SIGMAS).then(|| EstimateWarning::SkewUnknown {
            example_ms: 1e3 * EXAMPLE_S,
            cost_mm: 1e3 * depth_m,
            cost_deg: tilt_rad.to_degrees(),
        })
    }
}

/// Acceleration of points `(time, place)`: of their parabola of least squares. Zero if it is not determined.
fn acceleration(points: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (mut information, mut pull) = (Matrix3::zeros(), Vector3::zeros());
    for (t, place) in points {
        let by = Vector3::new(1.0, t, 0.5 * t * t);
        information += by * by.transpose();
        pull += by * place;
    }
    information.try_inverse().map_or(0.0, |inverse| (inverse * pull).z)
}
