//! Estimates of pairs in the history of a run: those of all methods with the true poses, recordings and annotated images.

use std::path::Path;

use anyhow::{Result, bail};
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
use super::compared::{Frame, Onlooker};
use super::drift::{DriftWatch, WhenCalibrated};
use super::journal::Journal;
use super::log::Lock;
use super::percept::Percept;
use super::perception::Marking;
use super::recording::Recording;
use super::selection::Choice;
use super::strip::Strip;
use crate::perception::View;
use crate::true_surface::true_model_frame;

/// What happens with each pair besides the record of the leading method.
pub(super) struct PairRecords {
    pub onlookers: Vec<Onlooker>,
    /// Annotated images from moments of interest.
    pub strip: Strip,
    /// The folder to which pairs are recorded, and how the target is marked.
    recording: Option<(Recording, Marking)>,
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
        Ok(Self { onlookers: Onlooker::all_of(setup)?, strip, drift: watch(setup)?, ..records })
    }
}

impl Journal<'_> {
    /// The same, and every pair is also written to that folder; `marking`: how the target is marked.
    ///
    /// # Errors
    /// A run without images.
    pub fn record_to(mut self, folder: &Path, marking: Marking) -> Result<Self> {
        if !self.setup.leader.needs_images() {
            bail!("--record: with estimator.method = {:?} there are no images to record", self.setup.leader.name());
        }
        self.pairs.recording = Some((Recording::new(folder, self.setup), marking));
        Ok(self)
    }

    /// Records the estimate of a pair with its true pose; the compared methods process the pair, too.
    ///
    /// # Errors
    /// If the recording cannot be written.
    pub fn note_pair(&mut self, seen: &PairEstimate) -> Result<()> {
        let PairEstimate { captured, region, prior, estimate, latency_millis, age_millis, .. } = seen;
        let Captured { frame, cam_left_from_target, view } = captured;
        let cam_left_from_plane = seen.cam_left_from_plane();
        let t_s = frame.at.seconds_since(self.begin);
        if region.is_some() {
            self.log.lock = None;
        }
        if let (None, Some(found), Some(cam_left_from_target), Some(plane)) =
            (&self.log.lock, &estimate.cam_left_from_model, cam_left_from_target, &cam_left_from_plane)
        {
            self.log.lock = true_model_frame(found, plane).map(|cam_left_from_model| Lock {
                at_s: t_s,
                target_from_model: cam_left_from_target.inverse() * cam_left_from_model,
                target_from_model_found: cam_left_from_target.inverse() * *found,
                covariance: estimate.pose_covariance,
            });
        }
        let age_millis = Some(*age_millis);
        let (region, cam_left_from_target) = (region.as_ref(), *cam_left_from_target);
        let frame = Frame { t_s, region, prior, cam_left_from_target, cam_left_from_plane, age_millis };
        self.log.leading.push(&frame, estimate, *latency_millis);
        let frame = Frame { age_millis: None, ..frame };
        let View::Images(pair) = view else { return Ok(()) };
        let PairRecords { onlookers, strip, recording, drift } = &mut self.pairs;
        strip.offer(t_s, pair, &self.setup.rig.stereo, estimate);
        for onlooker in onlookers {
            onlooker.look(pair, &frame);
        }
        let drifted = drift.as_mut().map(|drift| drift.look(captured.frame.at, captured.frame.skew_s, pair));
        for line in drifted.into_iter().flatten() {
            tracing::warn!("{line}");
        }
        let Some((recording, marking)) = recording else { return Ok(()) };
        let outline_px = match (recording.is_open(), &*marking, region) {
            (true, ..) => None,
            // The recording begins with the first target.
            (false, Marking::Awaited, None) => return Ok(()),
            (false, Marking::Awaited, Some(region)) => Some(outline_px(Region::clone(region), estimate)),
            (false, marking, _) => {
                Some(outline_px(marking.region(self.setup, cam_left_from_target.as_ref())?, estimate))
            }
        };
        recording.push(pair, cam_left_from_target.as_ref(), outline_px)
    }

    /// Finishes the recording, also after a failure: the recorded pairs help to find its cause.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish_recording(&mut self) -> Result<()> {
        self.pairs.recording.take().map_or(Ok(()), |(recording, _)| recording.finish())
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
