//! Estimates of pairs in the history of a run: those of all methods with the true poses, recordings and annotated images.

use anyhow::Result;
use nalgebra::Vector2;
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_servo::TargetObservation;
use pb3dp_setup::setup::{Setup, Synchronisation};

use super::capturing::Captured;
use super::compared::ComparedMethod;
use super::drift::{DriftWatch, WhenCalibrated};
use super::percept::Percept;
use super::perception::TargetSource;
use super::recording::Recording;
use super::selection::Choice;
use super::strip::Strip;

/// What happens with each pair besides the record of the leading method.
pub(super) struct PairRecords {
    pub onlookers: Vec<ComparedMethod>,
    /// Annotated images from moments of interest.
    pub strip: Strip,
    /// The folder to which pairs are recorded, and how the target is marked.
    pub recording: Option<(Recording, TargetSource)>,
    /// Camera drift since calibration, if it is measured.
    pub drift: Option<DriftWatch>,
}

impl PairRecords {
    /// Nothing is recorded yet.
    pub fn new(setup: &Setup, strip: Strip) -> Result<Self> {
        let records = Self { onlookers: Vec::new(), strip: Strip::default(), recording: None, drift: None };
        if !setup.leader.needs_images() {
            return Ok(records);
        }
        Ok(Self { onlookers: ComparedMethod::all_of(setup)?, strip, drift: watch(setup)?, ..records })
    }
}

/// Camera drift measurement, if the setup requests it.
fn watch(setup: &Setup) -> Result<Option<DriftWatch>, EstimationError> {
    let real = setup.rig.real_cameras.as_ref();
    let is_synchronous = real.is_none_or(|cameras| cameras.synchronisation == Synchronisation::HardwareTrigger);
    let of_head = setup.rig.calibrations.iter().find(|calibration| calibration.table == "camera");
    let judgement = of_head.and_then(|calibration| calibration.judgement.as_ref());
    let when_calibrated = judgement.map(WhenCalibrated::of).unwrap_or_default();
    setup.drift.map(|config| DriftWatch::new(config, &setup.rig.stereo, (is_synchronous, when_calibrated))).transpose()
}

/// A region as a polygon; for a region without corners, the outline from the method.
pub fn outline_px(region: Region, estimate: &TrackEstimate) -> Vec<Vector2<f64>> {
    match region {
        Region::Polygon { vertices_px } => vertices_px,
        Region::Rectangle { x, y, width, height } => {
            let (left, top) = (f64::from(x), f64::from(y));
            let (right, bottom) = (left + f64::from(width), top + f64::from(height));
            [[left, top], [right, top], [right, bottom], [left, bottom]].map(Vector2::from).to_vec()
        }
        Region::Mask(_) | Region::Click { .. } => estimate.outline_px.clone(),
    }
}

/// Estimate of one pair.
#[derive(Clone)]
pub struct PairEstimate {
    /// The pair.
    pub captured: Captured,
    /// Control steps whose joints the estimate knew.
    pub steps: u64,
    /// What the operator selected for this pair.
    pub chosen: Option<Choice>,
    /// Number of the target.
    pub target: u64,
    /// The region that was marked since the previous pair.
    pub region: Option<Region>,
    /// Prior information.
    pub prior: FramePrior,
    /// The estimate.
    pub estimate: TrackEstimate,
    /// The true plane of the target, in simulation with images: that of its visible surface inside the region, see [`TrueSurface`].
    ///
    /// [`TrueSurface`]: crate::true_surface::TrueSurface
    pub target_from_plane: Option<Pose<Target, Model>>,
    /// Wall time of the method, milliseconds.
    pub latency_millis: f64,
    /// From mid-exposure until the estimate is available to the controller, milliseconds.
    pub age_millis: f64,
}

impl PairEstimate {
    /// The true plane in this pair: that of the surface, or without one the plane z = 0 of the target.
    pub fn cam_left_from_plane(&self) -> Option<Pose<CamLeft, Model>> {
        let target_from_plane =
            self.target_from_plane.unwrap_or_else(|| Pose::<Target, Target>::coincident().relabel());
        Some(self.captured.cam_left_from_target? * target_from_plane)
    }

    /// Input of the motion half.
    pub fn percept(&self) -> Percept {
        Percept::new(self.captured.frame, &self.estimate, self.target, self.observation())
    }

    /// Input of the controller, if there is a pose.
    pub fn observation(&self) -> Option<TargetObservation> {
        let cam_left_from_model = self.estimate.cam_left_from_model?;
        Some(TargetObservation {
            at: self.captured.frame.at,
            cam_left_from_model,
            trusted: self.estimate.status.depth_is_sure(),
            covariance: self.estimate.covariance,
            observed: self.estimate.observed_directions(),
        })
    }
}
