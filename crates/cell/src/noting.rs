//! Image records: estimates of all methods with the true poses, recordings and annotated images.

use std::path::Path;

use anyhow::{Result, bail};
use nalgebra::Vector2;
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_servo::TargetObservation;
use pb3dp_setup::setup::{Setup, Synchronisation};

use super::capturing::Captured;
use super::compared::{Frame, Onlooker};
use super::drift::{DriftSummary, DriftWatch, WhenCalibrated};
use super::log::{Lock, MethodLog};
use super::percept::Percept;
use super::perception::Marking;
use super::recording::Recording;
use super::selection::Choice;
use super::strip::Strip;
use crate::perception::View;
use crate::true_surface::true_model_frame;

/// Image records; includes the compared methods.
pub struct EstimateRecorder<'a> {
    setup: &'a Setup,
    begin: MonotonicTime,
    marking: Marking,
    /// Pose of the model frame on the target, after the first estimate.
    lock: Option<Lock>,
    leading: MethodLog,
    onlookers: Vec<Onlooker>,
    strip: Strip,
    recording: Option<Recording>,
    drift: Option<DriftWatch>,
}

/// Finished image records.
pub struct EstimateRecords {
    /// Estimates of the method that leads the hand.
    pub leading: MethodLog,
    /// Estimates of the compared methods.
    pub compared: Vec<MethodLog>,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// Annotated images from moments of interest.
    pub strip: Strip,
    /// Pose of the model frame on the target; none without an estimate.
    pub lock: Option<Lock>,
    /// Camera drift since calibration, if it was measured.
    pub drift: Vec<DriftSummary>,
}

impl<'a> EstimateRecorder<'a> {
    /// Empty records. If `record` is given, every pair is also written to that folder.
    ///
    /// # Errors
    /// A parameter of a compared method out of its range, or `record` without images.
    pub fn new(
        setup: &'a Setup,
        marking: Marking,
        (strip, begin): (Strip, MonotonicTime),
        record: Option<&Path>,
    ) -> Result<Self> {
        let has_images = setup.leader.needs_images();
        if record.is_some() && !has_images {
            bail!("--record: with estimator.method = {:?} there are no images to record", setup.leader.name());
        }
        Ok(Self {
            onlookers: if has_images { Onlooker::all_of(setup)? } else { Vec::new() },
            strip: if has_images { strip } else { Strip::default() },
            drift: if has_images { watch(setup)? } else { None },
            recording: record.map(|folder| Recording::new(folder, setup)),
            begin,
            marking,
            lock: None,
            leading: MethodLog { method: setup.leader.name().to_owned(), ..MethodLog::default() },
            setup,
        })
    }

    /// Sets the start time of the experiment.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    /// Records the estimate of a pair with its true pose; the compared methods process the pair, too.
    ///
    /// # Errors
    /// If the recording cannot be written.
    pub fn note(&mut self, seen: &PairEstimate) -> Result<()> {
        let PairEstimate { captured, region, prior, estimate, latency_millis, age_millis, .. } = seen;
        let Captured { frame, cam_left_from_target, view } = captured;
        let cam_left_from_plane = seen.cam_left_from_plane();
        let t_s = frame.at.seconds_since(self.begin);
        if region.is_some() {
            self.lock = None;
        }
        if let (None, Some(found), Some(cam_left_from_target), Some(plane)) =
            (&self.lock, &estimate.cam_left_from_model, cam_left_from_target, &cam_left_from_plane)
        {
            self.lock = true_model_frame(found, plane).map(|cam_left_from_model| Lock {
                at_s: t_s,
                target_from_model: cam_left_from_target.inverse() * cam_left_from_model,
                target_from_model_found: cam_left_from_target.inverse() * *found,
                covariance: estimate.pose_covariance,
            });
        }
        let age_millis = Some(*age_millis);
        let (region, cam_left_from_target) = (region.as_ref(), *cam_left_from_target);
        let frame = Frame { t_s, region, prior, cam_left_from_target, cam_left_from_plane, age_millis };
        self.leading.push(&frame, estimate, *latency_millis);
        let frame = Frame { age_millis: None, ..frame };
        let View::Images(pair) = view else { return Ok(()) };
        self.strip.offer(t_s, pair, &self.setup.rig.stereo, estimate);
        for onlooker in &mut self.onlookers {
            onlooker.look(pair, &frame);
        }
        let drifted = self.drift.as_mut().map(|drift| drift.look(captured.frame.at, captured.frame.skew_s, pair));
        for line in drifted.into_iter().flatten() {
            tracing::warn!("{line}");
        }
        let Some(recording) = &mut self.recording else { return Ok(()) };
        let outline_px = match (recording.is_open(), &self.marking, region) {
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
        self.recording.take().map_or(Ok(()), Recording::finish)
    }

    /// Returns the records, with the pairs that the camera could not deliver.
    pub fn finish(self, pairs_lost: u64) -> EstimateRecords {
        let compared = self.onlookers.into_iter().map(Onlooker::into_log).collect();
        let drift = self.drift.map(DriftWatch::summaries).unwrap_or_default();
        EstimateRecords { leading: self.leading, compared, pairs_lost, strip: self.strip, lock: self.lock, drift }
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
