//! The published method, end to end: hue model of the left image, RM-GA over planes, votes in the right image.
//!
//! [`PublishedEstimator`] estimates single pairs without a start value (cold start); [`PublishedTracker`] tracks a target from
//! frame to frame. Both accept raw images of any calibrated pair. Images with lens distortion are undistorted first; all
//! further steps use pinhole cameras.
//!
//! The paper defines no status. Here [`crate::observability`] evaluates every estimate. A target whose pixels have no hue is
//! not searched.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, PlanePose};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, MarkedTarget};
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_estimation_core::status::{Status, Verdict};
use pb3dp_geometry::StereoRig;
use pb3dp_geometry::ranges;
use pb3dp_geometry::ranges::check_range;

use crate::fitness::FitnessConfig;
use crate::hue::HueConfig;
use crate::observability::{Landscape, ObservabilityConfig};
use crate::photo_model::PhotoModelConfig;
use crate::search::Found;
use crate::search::rmga::{Population, RmGa, RmGaConfig};

mod backprojection;
mod core;
mod front_end;
mod outline_fit;
mod target;
mod tracker;
mod tracker_config;

use self::core::Core;
pub use pb3dp_estimation_core::estimate::TrackEstimate;
pub use tracker::PublishedTracker;
pub use tracker_config::TrackerConfig;

/// An estimate this close to an end of the depth range counts as being at the end, as a share of the range.
const END_OF_RANGE_SHARE: f64 = 0.004;

/// Reason of a search without any hypothesis that can be scored.
const NO_HYPOTHESIS: &str = "every hypothesis of the search range is behind a camera: check the range";

/// All parameters that the published method leaves open.
#[derive(Clone, Debug, PartialEq)]
pub struct PublishedConfig {
    /// Conditions under which a pixel has a hue.
    pub hue: HueConfig,
    /// Points of the model. Default here: 600 on the target and 400 around it; fewer points cost less time and give a coarser
    /// fitness.
    pub model: PhotoModelConfig,
    /// Parameters of the votes.
    pub fitness: FitnessConfig,
    /// The genetic algorithm; its `generations` apply to a frame of the tracker.
    pub rmga: RmGaConfig,
    /// Parameters of the cold start.
    pub cold_start: ColdStartConfig,
    /// Parameters of regions.
    pub region: RegionConfig,
    /// Limits for the evaluation of estimates.
    pub observability: ObservabilityConfig,
    /// Minimum requirements for a target to be searched.
    pub hue_support: HueSupportConfig,
    /// Parameters of region tracking and loss.
    pub tracker: TrackerConfig,
    /// Whether an estimate also computes the best of all 2^24 chromosomes (tens of seconds). Default false.
    pub reference_optimum: bool,
}

impl Default for PublishedConfig {
    fn default() -> Self {
        Self {
            hue: HueConfig::default(),
            model: PhotoModelConfig { inner_points: 600, outer_points: 400, ..PhotoModelConfig::default() },
            fitness: FitnessConfig::default(),
            rmga: RmGaConfig::default(),
            cold_start: ColdStartConfig::default(),
            region: RegionConfig::default(),
            observability: ObservabilityConfig::default(),
            hue_support: HueSupportConfig::default(),
            tracker: TrackerConfig::default(),
            reference_optimum: false,
        }
    }
}

/// Parameters of the search without a start value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ColdStartConfig {
    /// Generations, 1 to 100000. Default 40: the genetic algorithm reaches its optimum in 20 to 40.
    pub generations: usize,
}

impl Default for ColdStartConfig {
    fn default() -> Self {
        Self { generations: 40 }
    }
}

/// Minimum hue content of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HueSupportConfig {
    /// Smallest share of the target's model points that have a hue, 0 to 1. Default 0.3.
    pub coloured_share_min: f64,
    /// Smallest number of the target's model points that have a hue. Default 40.
    pub points_min: usize,
}

impl HueSupportConfig {
    ranges! {
        fn validate "hue support ";
        coloured_share_min, COLOURED_SHARE_MIN: f64 = 0.0..=1.0;
        points_min, POINTS_MIN: usize = 1..=20_000;
    }
}

impl Default for HueSupportConfig {
    fn default() -> Self {
        Self { coloured_share_min: 0.3, points_min: 40 }
    }
}

impl PublishedConfig {
    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        self.hue.validate()?;
        self.model.validate()?;
        self.fitness.validate()?;
        self.rmga.validate()?;
        check_range("RM-GA generations", self.cold_start.generations, RmGaConfig::GENERATIONS)?;
        self.observability.validate()?;
        self.tracker.validate()?;
        Ok(self.hue_support.validate()?)
    }

    /// The limits for estimates whose depth is roughly known from the previous frame.
    fn tracked_observability(&self) -> ObservabilityConfig {
        ObservabilityConfig { depth_spread_sure: self.tracker.depth_spread_sure, ..self.observability }
    }
}

/// Estimator of the published method for single pairs.
#[derive(Clone, Debug)]
pub struct PublishedEstimator {
    core: Core,
}

impl PublishedEstimator {
    /// Creates an estimator for a calibrated pair, rectified or not, with or without lens distortion.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(rig: &StereoRig, config: PublishedConfig) -> Result<Self, EstimationError> {
        Ok(Self { core: Core::new(rig, config, Kernels::best())? })
    }

    /// As [`Self::new`], with the given kernels; the estimates are identical, the speed differs.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn with_kernels(rig: &StereoRig, config: PublishedConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        Ok(Self { core: Core::new(rig, config, kernels)? })
    }

    /// The parameters.
    pub fn config(&self) -> &PublishedConfig {
        self.core.config()
    }

    fn fill(&self, estimate: &mut PlaneEstimate, found: &Found, landscape: &Landscape, range: &SearchRange) {
        let Verdict { status, reason } = landscape.verdict(&self.core.config().observability);
        let pose = self.core.plane_pose(&found.psi, &estimate.centroid_px);
        estimate.pose = pose.filter(|_| status != Status::NotObservable);
        (estimate.status, estimate.reason) = (status, reason);
        (estimate.psi, estimate.fitness) = (Some(found.psi), Some(found.fitness));
        if landscape.fitness_highest > found.fitness + 0.02 {
            estimate
                .warnings
                .push(EstimateWarning::SearchIncomplete { found: found.fitness, grid: landscape.fitness_highest });
        }
        let margin_m = END_OF_RANGE_SHARE * (range.z_max_m - range.z_min_m);
        if found.psi.z_m < range.z_min_m + margin_m || found.psi.z_m > range.z_max_m - margin_m {
            estimate.warnings.push(EstimateWarning::EndOfRange { z_mm: 1000.0 * found.psi.z_m });
        }
    }
}

/// Without lens distortion the same request gives the same estimate on every machine. With distortion the undistortion may
/// differ in the last bits between system libraries.
impl EstimationMethod for PublishedEstimator {
    type Answer = PlaneEstimate;

    /// Estimates the plane of a region in one pair of raw images, without a start value: the whole range is searched.
    fn answer(&mut self, request: &mut EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        let MarkedTarget { region, range, .. } = request.marked()?;
        let EstimateRequest { left, right, ref mut deadline, .. } = *request;
        range.validate()?;
        let taken = self.core.take(left, right, region)?;
        let warnings = taken.warnings.into_iter().map(EstimateWarning::Region).collect();
        let mut estimate = self.core.blank_estimate(taken.centroid_px, warnings);
        if let Some(reason) = self.core.lack_of_hue() {
            estimate.reason = reason;
            return Ok(estimate);
        }
        let PublishedConfig { rmga, cold_start, .. } = self.core.config();
        let (mut population, generations) = (Population::random(rmga), cold_start.generations);
        let mut rmga = RmGa::new(*rmga, *range)?;
        let Some(found) = self.core.search(&mut rmga, &mut population, generations, deadline)? else {
            estimate.reason = NO_HYPOTHESIS.to_owned();
            return Ok(estimate);
        };
        let landscape = self.core.survey(&found, range)?;
        self.fill(&mut estimate, &found, &landscape, range);
        if self.core.config().reference_optimum {
            estimate.reference_optimum = self.core.reference_optimum(rmga.codec())?;
        }
        Ok(estimate)
    }

    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        *self = Self::new(rig, self.config().clone())?;
        Ok(())
    }
}

/// Methods shared by estimator and tracker.
impl Core {
    /// An empty estimate.
    fn blank_estimate(&self, centroid_px: Vector2<f64>, warnings: Vec<EstimateWarning>) -> PlaneEstimate {
        let blank = PlaneEstimate::without_pose(Status::NotObservable, String::new(), centroid_px, *self.left_camera());
        PlaneEstimate { warnings, ..blank }
    }

    /// The plane of a hypothesis, with its depth on the ray of a raw pixel.
    fn plane_pose(&self, psi: &PlaneHypothesis, raw_px: &Vector2<f64>) -> Option<PlanePose> {
        let q = psi.inverse_depth_plane(&self.pair().left_ray(&self.model_centre_px()))?;
        PlanePose::from_inverse_depth_plane(q, &self.left_camera().unproject(raw_px).ok()?)
    }
}
