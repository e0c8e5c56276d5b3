//! The half of a run that looks: pairs in, observations for the controller out, and all that is written down of pictures.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation::estimator::{FramePrior, Tracker};
use pb3dp_estimation::published::TrackEstimate;
use pb3dp_estimation::region::Region;
use pb3dp_geometry::frames::{Base, CamLeft, Model, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{CameraErrorKind, FramePair, StereoCamera};
use pb3dp_kinematics::JointState;
use pb3dp_servo::{JointHistory, TargetObservation};

use super::cell::{JOINT_GAP_MAX_S, SimulatedCell};
use super::compared::{Frame, Onlooker};
use super::log::MethodLog;
use super::recording::Recording;
use super::strip::Strip;
use crate::config::setup::Setup;
use crate::follower::Follower;
use crate::picture::model_frame_on_plane;

/// Camera, methods, and what they have seen.
pub struct Looking<'a> {
    setup: &'a Setup,
    camera: Box<dyn StereoCamera>,
    cell: SimulatedCell,
    target_outline_m: Vec<Point3<f64>>,
    follower: Follower,
    onlookers: Vec<Onlooker>,
    begin: MonotonicTime,
    /// The arm that carries the cameras, as it was measured.
    joints: JointHistory,
    pair: FramePair,
    /// When the pair before was exposed, and where the camera was, as far as the joints tell.
    previous: Option<(MonotonicTime, Option<Pose<Base, CamLeft>>)>,
    /// The true place of the model's frame on the target, once the first estimate has said where its origin is.
    target_from_model: Option<Pose<Target, Model>>,
    strip: Strip,
    leading: MethodLog,
    pairs_lost: u64,
    recording: Option<Recording>,
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
    /// The true place of the model's frame on the target; none without an estimate.
    pub target_from_model: Option<Pose<Target, Model>>,
}

impl<'a> Looking<'a> {
    /// A camera whose pairs have been looked at by nobody. Every pair is also written to the folder `record`, if given.
    ///
    /// # Errors
    /// A parameter of a method out of its range.
    pub fn new(
        setup: &'a Setup,
        (camera, cell, target_outline_m): (Box<dyn StereoCamera>, SimulatedCell, Vec<Point3<f64>>),
        (strip, begin): (Strip, MonotonicTime),
        record: Option<&Path>,
    ) -> Result<Self> {
        Ok(Self {
            follower: Follower::new(Tracker::new(setup.method, &setup.rig, &setup.estimator)?, setup.range),
            onlookers: Onlooker::all_of(setup)?,
            begin,
            joints: JointHistory::new(setup.controller.joint_history_samples, JOINT_GAP_MAX_S),
            pair: FramePair::black(camera.info().size),
            previous: None,
            target_from_model: None,
            strip,
            leading: MethodLog { method: setup.method.name().to_owned(), ..MethodLog::default() },
            pairs_lost: 0,
            recording: record.map(|folder| Recording::new(folder, setup)),
            camera,
            cell,
            target_outline_m,
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
        match self.camera.next_pair_into(&mut self.pair, self.setup.camera.period * 2) {
            Ok(()) => {}
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                self.pairs_lost += 1;
                tracing::warn!("{error}");
                return Ok(None);
            }
            Err(error) => return Err(error).context("camera"),
        }
        let at = self.pair.exposed_at;
        let prior = self.prior(at);
        let region = match self.follower.is_started() {
            true => None,
            false => Some(Region::Polygon { vertices_px: self.outline_px(at)? }),
        };
        let started = Instant::now();
        let estimate = self.estimate(region.as_ref(), &prior)?;
        let latency_millis = started.elapsed().as_secs_f64() * 1e3;
        Ok(Some(Seen { at, region, prior, estimate, latency_millis }))
    }

    /// Writes down what was seen in the last pair, beside the truth at the time of its exposure; the onlookers look at it, too.
    ///
    /// # Errors
    /// If the recording can not be written.
    pub fn note(&mut self, seen: &Seen) -> Result<()> {
        let Seen { at, region, prior, estimate, latency_millis } = seen;
        let cam_left_from_target = self.cam_left_from_target_at(*at);
        if let (None, Some(pose)) = (self.target_from_model, estimate.cam_left_from_model) {
            self.target_from_model = true_model_frame(&pose, &cam_left_from_target);
        }
        let t_s = at.seconds_since(self.begin);
        self.strip.offer(t_s, &self.pair, &self.setup.rig, estimate);
        let frame = Frame { t_s, pair: &self.pair, region: region.as_ref(), prior, cam_left_from_target };
        self.leading.push(&frame, estimate, *latency_millis);
        for onlooker in &mut self.onlookers {
            onlooker.look(&frame);
        }
        self.record(*at)
    }

    /// Completes the recording; what was recorded until a failure is the best hint at its cause.
    ///
    /// # Errors
    /// If it can not be written.
    pub fn finish_recording(&mut self) -> Result<()> {
        self.recording.take().map_or(Ok(()), Recording::finish)
    }

    /// What was written down.
    pub fn finish(self) -> Looked {
        Looked {
            leading: self.leading,
            compared: self.onlookers.into_iter().map(Onlooker::into_log).collect(),
            pairs_lost: self.pairs_lost,
            strip: self.strip,
            target_from_model: self.target_from_model,
        }
    }

    /// Writes the pair down with the truth, if a recording is wanted.
    fn record(&mut self, at: MonotonicTime) -> Result<()> {
        let Some(mut recording) = self.recording.take() else { return Ok(()) };
        let outline_px = if recording.is_open() { None } else { Some(self.outline_px(at)?) };
        let pushed = recording.push(&self.pair, &self.cam_left_from_target_at(at), outline_px);
        self.recording = Some(recording);
        pushed
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

    /// Follows the target, or takes the one in `region`.
    fn estimate(&mut self, region: Option<&Region>, prior: &FramePrior) -> Result<TrackEstimate> {
        let estimate = self.follower.look(&self.pair.left, &self.pair.right, region, prior)?;
        if region.is_some() {
            for warning in &estimate.warnings {
                tracing::warn!("{warning}");
            }
            tracing::info!("target taken: {}: {}", estimate.status, estimate.reason);
        }
        Ok(estimate)
    }

    /// What an operator would draw around the target in the left picture.
    fn outline_px(&self, at: MonotonicTime) -> Result<Vec<Vector2<f64>>> {
        let cam_left_from_target = self.cam_left_from_target_at(at);
        let pixel = |point: &Point3<f64>| self.setup.rig.left().project(&cam_left_from_target.transform_point(point));
        let vertices_px: Option<Vec<_>> = self.target_outline_m.iter().map(pixel).collect();
        vertices_px.context("the target is not in front of the camera at the beginning")
    }

    fn cam_left_from_target_at(&self, at: MonotonicTime) -> Pose<CamLeft, Target> {
        self.cell.world_from_cam_left_at(at).inverse() * self.cell.world_from_target_at(at)
    }
}

/// What was seen in one pair.
pub struct Seen {
    at: MonotonicTime,
    region: Option<Region>,
    prior: FramePrior,
    estimate: TrackEstimate,
    latency_millis: f64,
}

impl Seen {
    /// What the controller is told, if there is a pose.
    pub fn observation(&self) -> Option<TargetObservation> {
        let cam_left_from_model = self.estimate.cam_left_from_model?;
        Some(TargetObservation { at: self.at, cam_left_from_model, trusted: self.estimate.status.depth_is_sure() })
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
