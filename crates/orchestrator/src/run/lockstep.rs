//! The loop of a simulated run: one thread, stepped by one virtual clock, so that the same seed gives the same run.
//!
//! Two things happen, each at its own time, the earlier one first: a control step every control period, and a frame when
//! its exposure has ended. An estimate reaches the controller only `estimate_latency` after its exposure has ended, however
//! fast this machine computed it.

use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation::estimator::{FramePrior, Tracker};
use pb3dp_estimation::published::TrackEstimate;
use pb3dp_estimation::region::Region;
use pb3dp_geometry::frames::{Base, CamLeft, Model, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{CameraErrorKind, FramePair, JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector, smallest_singular_value};
use pb3dp_servo::{Command, Controller, JointHistory, TargetObservation};
use pb3dp_sim::placement::FlangePath;
use pb3dp_sim::trajectory::Trajectory;

use super::carrier::carry;
use super::compared::{Frame, Onlooker};
use super::log::{ControlSample, MethodLog, RunLog};
use super::recording::Recording;
use super::strip::Strip;
use crate::config::setup::Setup;
use crate::follower::Follower;
use crate::picture::model_frame_on_plane;
use crate::wiring::Parts;

/// Gap between joint samples up to which the hand's pose is interpolated, seconds.
const JOINT_GAP_MAX_S: f64 = 0.1;
/// How often progress is told, seconds of the experiment.
const PROGRESS_EVERY_S: f64 = 5.0;

/// What a run leaves behind.
pub struct Outcome {
    /// Everything written down.
    pub log: RunLog,
    /// Annotated pictures from moments of interest.
    pub strip: Strip,
}

/// Runs the experiment to its end, or to `stop_after_s`; every pair is also written to the folder `record`, if given. Both
/// arms are stopped on every way out.
///
/// # Errors
/// If an arm, the camera or the estimator fails for good; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Outcome> {
    let mut looped = Loop::new(setup, parts, record)?;
    let outcome = looped.enable_arms().and_then(|()| looped.run_to_end(stop_after_s));
    let stopped = looped.stop_arms();
    // What was recorded until a failure is the best hint at its cause.
    let recorded = looped.recording.take().map_or(Ok(()), Recording::finish);
    outcome.and(stopped).and(recorded)?;
    Ok(looped.finish())
}

struct Loop<'a> {
    setup: &'a Setup,
    parts: Parts,
    follower: Follower,
    onlookers: Vec<Onlooker>,
    controller: Controller,
    damping: Damping,
    begin: MonotonicTime,
    joints: JointHistory,
    vs_joints: JointState,
    tc_joints: JointState,
    /// Estimates on their way to the controller, with the time of arrival.
    arriving: VecDeque<(MonotonicTime, TargetObservation)>,
    newest: Option<TargetObservation>,
    pair: FramePair,
    /// When the pair before was exposed, and where the camera was, as far as the joints tell.
    previous: Option<(MonotonicTime, Option<Pose<Base, CamLeft>>)>,
    /// The true place of the model's frame on the target, once the first estimate has said where its origin is.
    target_from_model: Option<Pose<Target, Model>>,
    strip: Strip,
    log: RunLog,
    next_progress_s: f64,
    recording: Option<Recording>,
}

impl<'a> Loop<'a> {
    /// Everything that can be refused is made before an arm is switched on.
    fn new(setup: &'a Setup, parts: Parts, record: Option<&Path>) -> Result<Self> {
        let limiter = &setup.vs.limiter;
        let limits = limiter.hard_limits.with_position_range(limiter.operating_min_rad, limiter.operating_max_rad)?;
        let controller = Controller::new(setup.controller, setup.vs.chain.clone(), limits)?;
        let at_rest = |position_rad: JointVector| JointState {
            at: parts.clock.now(),
            position_rad,
            velocity_rad_per_s: JointVector::zeros(),
        };
        let (vs_joints, tc_joints) = (at_rest(setup.vs.start_rad), at_rest(setup.tc.start_rad));
        let leading = MethodLog { method: setup.method.name().to_owned(), ..MethodLog::default() };
        let log = RunLog { marks: parts.experiment.marks().to_vec(), leading, ..RunLog::default() };
        Ok(Self {
            follower: Follower::new(Tracker::new(setup.method, &setup.rig, &setup.estimator)?, setup.range),
            onlookers: Onlooker::all_of(setup)?,
            controller,
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            begin: parts.clock.now(),
            joints: JointHistory::new(setup.controller.joint_history_samples, JOINT_GAP_MAX_S),
            vs_joints,
            tc_joints,
            arriving: VecDeque::new(),
            newest: None,
            pair: FramePair::black(parts.camera.info().size),
            previous: None,
            target_from_model: None,
            strip: Strip::for_marks(&log.marks, setup.experiment.move_s),
            log,
            next_progress_s: 0.0,
            recording: record.map(|folder| Recording::new(folder, setup)),
            setup,
            parts,
        })
    }

    /// Drives on, and where the joints really are.
    fn enable_arms(&mut self) -> Result<()> {
        self.parts.vs.enable().context("vs-robot: enable")?;
        self.parts.tc.enable().context("tc-robot: enable")?;
        self.vs_joints = self.parts.vs.exchange(JointCommand::Hold).context("vs-robot")?;
        self.tc_joints = self.parts.tc.exchange(JointCommand::Hold).context("tc-robot")?;
        Ok(())
    }

    /// What is left behind. Before the first estimate nobody knew where on the target the model is: those samples are
    /// completed now.
    fn finish(mut self) -> Outcome {
        let target_from_model = self.target_from_model.unwrap_or_else(Pose::coincident);
        let model_from_hand = self.setup.controller.model_from_hand_desired;
        for sample in &mut self.log.control {
            sample.world_from_hand_wanted = sample.world_from_target * target_from_model * model_from_hand;
        }
        self.log.compared = self.onlookers.into_iter().map(Onlooker::into_log).collect();
        self.log.limited_steps = self.parts.vs.limited_commands();
        Outcome { log: self.log, strip: self.strip }
    }

    /// Control steps and frames in the order of their times.
    fn run_to_end(&mut self, stop_after_s: Option<f64>) -> Result<()> {
        let duration_s = self.parts.experiment.duration_s();
        let end = self.begin + Duration::from_secs_f64(stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s)));
        let mut next_control = self.begin;
        let mut next_frame = self.begin + self.setup.camera.exposure;
        while next_control.min(next_frame) <= end {
            if next_control <= next_frame {
                self.parts.clock.sleep_until(next_control);
                self.control_step(next_control)?;
                next_control = next_control + self.setup.control_period;
            } else {
                self.frame_step()?;
                next_frame = next_frame + self.setup.camera.period;
            }
        }
        Ok(())
    }

    fn control_step(&mut self, now: MonotonicTime) -> Result<()> {
        let t_s = now.seconds_since(self.begin);
        let path = FlangePath::of_carrier(
            &self.parts.experiment,
            &self.setup.tc.world_from_base,
            &self.setup.flange_from_target,
        );
        let velocity = carry(&self.setup.tc.chain, &self.damping, &path, t_s, &self.tc_joints.position_rad);
        self.tc_joints = self.parts.tc.exchange(JointCommand::Velocity(velocity)).context("tc-robot")?;

        while self.arriving.front().is_some_and(|(due, _)| *due <= now) {
            self.newest = self.arriving.pop_front().map(|(_, observation)| observation);
        }
        let step = self.controller.step(&self.vs_joints, self.newest.as_ref(), now);
        let command = match step.command {
            Command::Velocity(velocity) => JointCommand::Velocity(velocity),
            Command::Hold => JointCommand::Hold,
        };
        self.vs_joints = self.parts.vs.exchange(command).context("vs-robot")?;
        self.joints.push(self.vs_joints);
        self.note_control(t_s, now, step.mode.to_string());
        Ok(())
    }

    /// Writes down where everything truly is.
    fn note_control(&mut self, t_s: f64, now: MonotonicTime, mode: String) {
        let last_mode = self.log.control.last().map(|sample| sample.mode.clone());
        let word = |text: &str| text.split(':').next().unwrap_or_default().to_owned();
        if last_mode.as_deref().map(word) != Some(word(&mode)) {
            self.log.events.push((t_s, mode.clone()));
            tracing::debug!("{t_s:7.2} s  {mode}");
        }
        if t_s >= self.next_progress_s {
            self.next_progress_s += PROGRESS_EVERY_S;
            tracing::info!("{t_s:5.1} of {:.1} s  {mode}", self.parts.experiment.duration_s());
        }
        let cell = &self.parts.cell;
        let world_from_target = cell.world_from_target_at(now);
        let jacobian = self.setup.vs.chain.jacobian(&self.vs_joints.position_rad);
        self.log.control.push(ControlSample {
            t_s,
            world_from_target,
            world_from_hand: cell.world_from_hand_at(now),
            // Completed at the end of the run.
            world_from_hand_wanted: Pose::coincident(),
            mode,
            smallest_singular_value: smallest_singular_value(&jacobian),
        });
    }

    fn frame_step(&mut self) -> Result<()> {
        match self.parts.camera.next_pair_into(&mut self.pair, self.setup.camera.period * 2) {
            Ok(()) => {}
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                self.log.pairs_lost += 1;
                tracing::warn!("{error}");
                return Ok(());
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
        if let Some(cam_left_from_model) = estimate.cam_left_from_model {
            let observation = TargetObservation { at, cam_left_from_model, trusted: estimate.status.depth_is_sure() };
            self.arriving.push_back((self.parts.clock.now() + self.setup.estimate_latency, observation));
        }
        self.note_frame(at, (region.as_ref(), &prior), &estimate, latency_millis);
        self.record(at)
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
        let vertices_px: Option<Vec<_>> = self.parts.target_outline_m.iter().map(pixel).collect();
        vertices_px.context("the target is not in front of the camera at the beginning")
    }

    fn cam_left_from_target_at(&self, at: MonotonicTime) -> Pose<CamLeft, Target> {
        self.parts.cell.world_from_cam_left_at(at).inverse() * self.parts.cell.world_from_target_at(at)
    }

    /// Compares the estimate with the truth at the time of its exposure, and lets the onlookers look at the same pair.
    fn note_frame(
        &mut self,
        at: MonotonicTime,
        (region, prior): (Option<&Region>, &FramePrior),
        estimate: &TrackEstimate,
        latency_millis: f64,
    ) {
        let cam_left_from_target = self.cam_left_from_target_at(at);
        if let (None, Some(pose)) = (self.target_from_model, estimate.cam_left_from_model) {
            self.target_from_model = true_model_frame(&pose, &cam_left_from_target);
        }
        let t_s = at.seconds_since(self.begin);
        self.strip.offer(t_s, &self.pair, &self.setup.rig, estimate);
        let frame = Frame { t_s, pair: &self.pair, region, prior, cam_left_from_target };
        self.log.leading.push(&frame, estimate, latency_millis);
        for onlooker in &mut self.onlookers {
            onlooker.look(&frame);
        }
    }

    /// Both arms come to rest with brakes on, whatever happened; the first failure is told.
    fn stop_arms(&mut self) -> Result<()> {
        let vs = self.parts.vs.stop().context("vs-robot: stop");
        let tc = self.parts.tc.stop().context("tc-robot: stop");
        vs.and(tc)
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
