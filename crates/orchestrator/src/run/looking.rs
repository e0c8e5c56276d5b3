//! The half of a run that looks: pairs in, observations for the controller out, and all that is written down of pictures.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use nalgebra::{Point3, Vector3};
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation::published::TrackEstimate;
use pb3dp_estimation::region::Region;
use pb3dp_geometry::frames::{Base, CamLeft, Model, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::CameraErrorKind;
use pb3dp_kinematics::JointState;
use pb3dp_servo::supervisor::FrameInput;
use pb3dp_servo::{JointHistory, TargetObservation};

use super::cell::{JOINT_GAP_MAX_S, SimulatedCell};
use super::compared::{Frame, Onlooker};
use super::eyes::{Eyes, Sight};
use super::log::{Lock, MethodLog};
use super::percept::Percept;
use super::strip::Strip;
use crate::config::setup::Setup;
use crate::picture::model_frame_on_plane;

/// Camera, methods, and what they have seen.
pub struct Looking<'a> {
    setup: &'a Setup,
    eyes: Eyes,
    cell: SimulatedCell,
    /// Number of the target: how many were marked.
    target: u64,
    begin: MonotonicTime,
    /// The arm that carries the cameras, as it was measured.
    joints: JointHistory,
    /// When the pair before was exposed, and where the camera was, as far as the joints tell.
    previous: Option<(MonotonicTime, Option<Pose<Base, CamLeft>>)>,
    /// Where on the target the model's frame is, once the first estimate has said so.
    lock: Option<Lock>,
    leading: MethodLog,
    pairs_lost: u64,
}

/// What was written down of pictures.
pub struct Looked {
    /// What the method that leads the hand said.
    pub leading: MethodLog,
    /// What the methods said that only looked on.
    pub compared: Vec<MethodLog>,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// Annotated pictures from moments of interest.
    pub strip: Strip,
    /// Where on the target the model's frame is; none without an estimate.
    pub lock: Option<Lock>,
}

impl<'a> Looking<'a> {
    /// A camera whose pairs have been looked at by nobody. Every pair is also written to the folder `record`, if given.
    ///
    /// # Errors
    /// As [`Eyes::new`].
    pub fn new(
        setup: &'a Setup,
        (camera, cell, target_outline_m): (Sight, SimulatedCell, Vec<Point3<f64>>),
        (strip, begin): (Strip, MonotonicTime),
        record: Option<&Path>,
    ) -> Result<Self> {
        Ok(Self {
            eyes: Eyes::new(setup, (camera, target_outline_m), strip, record)?,
            target: 0,
            begin,
            joints: JointHistory::new(setup.controller.joint_history_samples, JOINT_GAP_MAX_S),
            previous: None,
            lock: None,
            leading: MethodLog { method: setup.leader.name().to_owned(), ..MethodLog::default() },
            pairs_lost: 0,
            cell,
            setup,
        })
    }

    /// The experiment begins at this time.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    /// The arm that carries the cameras was measured.
    pub fn push_joints(&mut self, sample: JointState) {
        self.joints.push(sample);
    }

    /// Waits for the next pair and looks at it. `None` if it did not come.
    ///
    /// # Errors
    /// If the camera or the leading method fails for good.
    pub fn look(&mut self) -> Result<Option<Seen>> {
        let frame = match self.eyes.wait_for_frame(self.setup.camera.period * 2) {
            Ok(frame) => frame,
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                self.pairs_lost += 1;
                tracing::warn!("{error}");
                return Ok(None);
            }
            Err(error) => return Err(error).context("camera"),
        };
        let prior = self.prior(frame.at);
        let region = self.eyes.region(self.setup, &self.cam_left_from_target_at(frame.at))?;
        self.target += u64::from(region.is_some());
        let started = Instant::now();
        let estimate = self.eyes.estimate(region.as_ref(), &prior)?;
        let latency_millis = started.elapsed().as_secs_f64() * 1e3;
        if region.is_some() {
            for warning in &estimate.warnings {
                tracing::warn!("{warning}");
            }
            tracing::info!("target taken: {}: {}", estimate.status, estimate.reason);
        }
        Ok(Some(Seen { frame, target: self.target, region, prior, estimate, latency_millis }))
    }

    /// Writes down what was seen in the last pair, beside the truth at the time of its exposure; the onlookers look at it, too.
    ///
    /// # Errors
    /// If the recording can not be written.
    pub fn note(&mut self, seen: &Seen) -> Result<()> {
        let Seen { frame: FrameInput { at, .. }, region, prior, estimate, latency_millis, .. } = seen;
        let cam_left_from_target = self.cam_left_from_target_at(*at);
        let t_s = at.seconds_since(self.begin);
        if let (None, Some(found)) = (&self.lock, &estimate.cam_left_from_model) {
            self.lock = true_model_frame(found, &cam_left_from_target).map(|target_from_model| Lock {
                at_s: t_s,
                target_from_model,
                target_from_model_found: cam_left_from_target.inverse() * *found,
                covariance: estimate.covariance,
            });
        }
        let frame = Frame { t_s, region: region.as_ref(), prior, cam_left_from_target };
        self.leading.push(&frame, estimate, *latency_millis);
        self.eyes.keep(self.setup, &frame, estimate)
    }

    /// Completes the recording; what was recorded until a failure is the best hint at its cause.
    ///
    /// # Errors
    /// If it can not be written.
    pub fn finish_recording(&mut self) -> Result<()> {
        self.eyes.finish_recording()
    }

    /// What was written down.
    pub fn finish(self) -> Looked {
        let (strip, onlookers) = self.eyes.finish();
        Looked {
            leading: self.leading,
            compared: onlookers.into_iter().map(Onlooker::into_log).collect(),
            pairs_lost: self.pairs_lost,
            strip,
            lock: self.lock,
        }
    }

    /// The pose of the left camera from the measured joints, as a rig without truth knows it.
    fn base_from_cam_left_at(&self, at: MonotonicTime) -> Option<Pose<Base, CamLeft>> {
        let position_rad = self.joints.position_at(at).ok()?;
        let controller = &self.setup.controller;
        Some(self.setup.vs.chain.forward(&position_rad) * controller.flange_from_hand * controller.hand_from_cam_left)
    }

    /// What the joints and the clock tell about the new frame before it is looked at.
    fn prior(&mut self, at: MonotonicTime) -> FramePrior {
        let base_from_cam_left = self.base_from_cam_left_at(at);
        let previous = self.previous.replace((at, base_from_cam_left));
        let motion = previous.and_then(|(_, prev)| Some(prev?.inverse() * base_from_cam_left?));
        let dt_s = previous.map(|(before, _)| at.seconds_since(before));
        FramePrior { dt_s, ..FramePrior::of_motion(motion.as_ref()) }
    }

    fn cam_left_from_target_at(&self, at: MonotonicTime) -> Pose<CamLeft, Target> {
        self.cell.world_from_cam_left_at(at).inverse() * self.cell.world_from_target_at(at)
    }
}

/// What was seen in one pair.
pub struct Seen {
    frame: FrameInput,
    target: u64,
    region: Option<Region>,
    prior: FramePrior,
    estimate: TrackEstimate,
    latency_millis: f64,
}

impl Seen {
    /// What those who move are told.
    pub fn percept(&self) -> Percept {
        Percept::new(self.frame, &self.estimate, self.target, self.observation())
    }

    /// What the controller is told, if there is a pose.
    pub fn observation(&self) -> Option<TargetObservation> {
        let cam_left_from_model = self.estimate.cam_left_from_model?;
        Some(TargetObservation {
            at: self.frame.at,
            cam_left_from_model,
            trusted: self.estimate.status.depth_is_sure(),
            covariance: self.estimate.covariance,
            rotation_about_normal_observed: self.estimate.rotation_about_normal_observed,
        })
    }
}

/// Where on the target the model's frame truly is: on the target's plane, on the ray of the estimated origin.
fn true_model_frame(
    cam_left_from_model: &Pose<CamLeft, Model>,
    cam_left_from_target: &Pose<CamLeft, Target>,
) -> Option<Pose<Target, Model>> {
    let away = cam_left_from_target.transform_vector(&Vector3::z());
    let origin = cam_left_from_model.translation_m();
    let ray = origin / origin.z;
    let true_depth_m = away.dot(&cam_left_from_target.translation_m()) / away.dot(&ray);
    Some(cam_left_from_target.inverse() * model_frame_on_plane(ray * true_depth_m, &-away)?)
}
