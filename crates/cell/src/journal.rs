//! The history of a run for its report: control steps together with the true poses; estimates are added in [`crate::estimate_log`].

use std::path::Path;

use anyhow::{Result, bail};
use nalgebra::Vector6;
use pb3dp_geometry::frames::{CamLeft, Hand, Model, Target, World};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::smallest_singular_value;
use pb3dp_servo::supervisor::{Condition, Event, State, Why};
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::Trajectory;

use super::capturing::Captured;
use super::cell::SimulatedCell;
use super::channels::Plan;
use super::commands::CommandSummary;
use super::compared::{ComparedMethod, Frame};
use super::drift::DriftWatch;
use super::estimate_log::{PairEstimate, PairRecords, outline_px};
use super::log::{ArmSample, ControlSample, Lock, MethodLog, RunLog};
use super::moving::StepRecord;
use super::perception::{TargetSource, View};
use super::recording::Recording;
use super::strip::Strip;
use super::supervision::TransitionNote;
use crate::true_surface::true_model_frame;

/// Interval of progress messages, seconds of the experiment.
const PROGRESS_EVERY_S: f64 = 5.0;

/// Grace period for the first pair, seconds. Chosen: the slowest camera delivers ten pairs.
const FIRST_PAIR_WITHIN_S: f64 = 1.0;

/// Result of a run.
pub struct Outcome {
    /// Everything recorded.
    pub log: RunLog,
    /// Parameters of the experiment, for its figures.
    pub plan: Plan,
    /// Annotated images from moments of interest.
    pub strip: Strip,
}

/// True poses at a control step; without a simulation those from the measured joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruePoses {
    /// Of the hand.
    pub world_from_hand: Pose<World, Hand>,
    /// Of the target.
    pub world_from_target: Pose<World, Target>,
}

impl TruePoses {
    /// The poses at this time, if the workcell still has them.
    pub fn at(cell: &SimulatedCell, at: MonotonicTime) -> Option<Self> {
        cell.remembers(at).then(|| Self {
            world_from_hand: cell.world_from_hand_at(at),
            world_from_target: cell.world_from_target_at(at),
        })
    }
}

/// A control step of which only a recording is left.
pub struct RecordedStep {
    /// Begin of the step.
    pub at: MonotonicTime,
    /// Controller mode.
    pub mode: String,
    /// State of the supervisor.
    pub state: State,
    /// The arm that carries the cameras, and the one that carries the target.
    pub arms: [ArmSample; 2],
}

/// The history of a run for its report, from its messages: control steps with the true poses, and estimates of all methods. A run and
/// its recording have the same.
pub struct Journal<'a> {
    pub(super) setup: &'a Setup,
    pub(super) begin: MonotonicTime,
    duration_s: f64,
    next_progress_s: f64,
    steps_untrue: u64,
    is_quiet: bool,
    pub(super) log: RunLog,
    plan: Plan,
    /// What also happens with each pair.
    pub(super) pairs: PairRecords,
}

impl<'a> Journal<'a> {
    /// An empty journal of an experiment with this duration that begins at `begin`. `led_by`: whether a person leads the run, and whether
    /// the operator can fall silent; otherwise nobody can give commands, and the lines of the journal name none.
    ///
    /// # Errors
    /// A parameter of a compared method out of its range.
    pub fn new(
        setup: &'a Setup,
        experiment: &dyn Trajectory,
        led_by: (bool, bool),
        (begin, duration_s): (MonotonicTime, f64),
    ) -> Result<Self> {
        // A person decides when the moves begin.
        let marks = if led_by.0 { Vec::new() } else { experiment.marks().to_vec() };
        let strip = Strip::of(setup.experiment.moments(&marks));
        let mut log = RunLog {
            marks,
            without_images: !setup.leader.needs_images(),
            without_truth: setup.world.is_none(),
            leading: MethodLog { method: setup.leader.name().to_owned(), ..MethodLog::default() },
            ..RunLog::default()
        };
        if led_by == (false, false) {
            log.supervision.leave_out_commands();
        }
        Ok(Self {
            begin,
            duration_s,
            next_progress_s: PROGRESS_EVERY_S,
            steps_untrue: 0,
            is_quiet: false,
            log,
            plan: Plan::of(&setup.experiment.motion, experiment),
            pairs: PairRecords::new(setup, strip)?,
            setup,
        })
    }

    /// The same, but it logs nothing: the run is over.
    #[must_use]
    pub fn quiet(self) -> Self {
        Self { is_quiet: true, ..self }
    }

    /// The line of a reason.
    pub fn text_of(&self, why: &Why) -> String {
        self.log.supervision.text_of(why)
    }

    /// Sets the start time of the experiment.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    /// Number of steps that arrived too late for a true pose; only their supervisor decision is recorded.
    pub fn steps_untrue(&self) -> u64 {
        self.steps_untrue
    }

    /// Records a step, with the true poses if they are known.
    pub fn note(&mut self, moved: &StepRecord, poses: Option<TruePoses>) {
        let t_s = moved.at.seconds_since(self.begin);
        let gone = self.log.supervision.gone(t_s, &moved.decision);
        let transition = self.log.supervision.note(t_s, &moved.decision).cloned();
        if !self.is_quiet {
            self.tell(t_s, moved, gone, transition);
        }
        self.sample((t_s, moved.mode.to_string()), moved.arms, poses);
    }

    /// Records a step of a recording, with the true poses if they are known.
    pub fn note_recorded(&mut self, step: RecordedStep, poses: Option<TruePoses>) {
        let t_s = step.at.seconds_since(self.begin);
        self.log.supervision.note_state(t_s, step.state);
        self.sample((t_s, step.mode), step.arms, poses);
    }

    /// Records a change of state of a recording.
    pub fn note_change(&mut self, change: TransitionNote) {
        self.log.supervision.note_change(change);
    }

    fn sample(&mut self, (t_s, mode): (f64, String), arms: [ArmSample; 2], poses: Option<TruePoses>) {
        let Some(TruePoses { world_from_hand, world_from_target }) = poses else {
            self.steps_untrue += 1;
            return;
        };
        let jacobian = self.setup.rig.arms.vs.chain.jacobian(&arms[0].position_rad);
        self.log.control.push(ControlSample {
            t_s,
            world_from_target,
            world_from_hand,
            // Filled in at the end of the run.
            world_from_hand_wanted: Pose::coincident(),
            world_from_hand_locked: Pose::coincident(),
            mode,
            smallest_singular_value: smallest_singular_value(&jacobian),
            arms,
        });
    }

    /// Logs what a step has changed, and the progress.
    fn tell(&mut self, t_s: f64, moved: &StepRecord, gone: Option<String>, transition: Option<TransitionNote>) {
        if let Some(gone) = gone {
            tracing::info!("{t_s:7.2} s  {gone}");
        } else if let Some(note) = transition {
            match moved.decision.state {
                // No news for the operator who commanded it.
                State::Holding if note.event == Event::Hold.name() => tracing::info!("{t_s:7.2} s  {}", note.why),
                State::Holding | State::Lost | State::Stopped => tracing::warn!("{t_s:7.2} s  {}", note.why),
                State::Fault => tracing::error!("{t_s:7.2} s  {}", note.why),
                State::Selecting if t_s < FIRST_PAIR_WITHIN_S && awaits_first_pair(&moved.decision.why) => {
                    tracing::info!("{t_s:7.2} s  selecting: waiting for the first pair")
                }
                _ => tracing::info!("{t_s:7.2} s  {}", note.why),
            }
        }
        if let Some(refused) = &moved.decision.refused {
            tracing::warn!("{t_s:7.2} s  {refused}");
        }
        if t_s >= self.next_progress_s {
            self.next_progress_s += PROGRESS_EVERY_S;
            tracing::info!("{t_s:5.1} of {:.1} s  {}", self.duration_s, self.text_of(&moved.decision.why));
        }
    }

    /// The result of the run, with what is known at its end. The model pose on the target is only known after the first estimate, so the
    /// desired hand poses are filled in now.
    pub fn finish(self, pairs_lost: u64, commands: Vec<CommandSummary>) -> Outcome {
        let PairRecords { onlookers, strip, drift, .. } = self.pairs;
        let mut log = RunLog {
            compared: onlookers.into_iter().map(ComparedMethod::into_log).collect(),
            drift: drift.map(DriftWatch::summaries).unwrap_or_default(),
            pairs_lost,
            commands,
            ..self.log
        };
        let until_s = log.marks.first().map_or(f64::INFINITY, |mark| mark.at_s);
        if let Some(lock) = &mut log.lock {
            lock.target_from_model_found = mean_place(&log.leading, until_s).unwrap_or(lock.target_from_model_found);
        }
        let places = log.lock.map(|lock| (lock.target_from_model, lock.target_from_model_found));
        let (wanted, locked) = places.unwrap_or_else(|| (Pose::coincident(), Pose::coincident()));
        let model_from_hand_desired = self.setup.controller.model_from_hand_desired;
        for sample in &mut log.control {
            sample.world_from_hand_wanted = sample.world_from_target * wanted * model_from_hand_desired;
            sample.world_from_hand_locked = sample.world_from_target * locked * model_from_hand_desired;
        }
        Outcome { log, plan: self.plan, strip }
    }
}

impl Journal<'_> {
    /// The same, and every pair is also written to that folder; `marking`: how the target is marked.
    ///
    /// # Errors
    /// A run without images.
    pub fn record_to(mut self, folder: &Path, marking: TargetSource) -> Result<Self> {
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
    pub fn note_pair(&mut self, pair_estimate: &PairEstimate) -> Result<()> {
        let PairEstimate { captured, region, prior, estimate, latency_millis, age_millis, .. } = pair_estimate;
        let Captured { frame, cam_left_from_target, view } = captured;
        let cam_left_from_plane = pair_estimate.cam_left_from_plane();
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
            (false, TargetSource::FromOperator, None) => return Ok(()),
            (false, TargetSource::FromOperator, Some(region)) => Some(outline_px(region.clone(), estimate)),
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

/// Mean estimated pose of the model frame on the target before `until_s`; none without estimates.
fn mean_place(log: &MethodLog, until_s: f64) -> Option<Pose<Target, Model>> {
    let frames = log.frames.iter().zip(&log.estimated).zip(&log.truth);
    let mut places = frames
        .filter(|((frame, _), _)| frame.t_s < until_s)
        .filter_map(|((_, estimated), truth)| Some(truth.relabel::<CamLeft, Target>().inverse() * (*estimated)?));
    let first = places.next()?;
    let (sum, count) = places
        .fold((Vector6::zeros(), 1.0), |(sum, count), place| (sum + (first.inverse() * place).log(), count + 1.0));
    Some(first.perturbed_in_from(&(sum / count)))
}

fn awaits_first_pair(why: &Why) -> bool {
    matches!(why, Why::Waiting { cause } if cause.condition == Condition::FrameStale && cause.value.is_infinite())
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_geometry::Frame;

    use super::super::log::FrameSample;
    use super::*;

    fn pose<To: Frame, From: Frame>(t: [f64; 3], r: [f64; 3]) -> Pose<To, From> {
        Pose::from_parts(Vector3::from(t), UnitQuaternion::from_scaled_axis(Vector3::from(r)))
    }

    #[test]
    fn the_place_of_the_model_is_the_mean_before_the_first_move() {
        let place = pose::<Target, Model>([0.01, -0.02, 0.003], [0.2, -0.1, 0.4]);
        let mut log = MethodLog::default();
        // Offset to either side, one frame without a pose, one without offset, and an outlier after the move has begun.
        for (k, off) in [1.0, -1.0, 0.5, -0.5, 0.0, 77.0].into_iter().enumerate() {
            let truth = pose::<CamLeft, Target>([0.03, 0.01 * k as f64, 0.5], [0.1, 0.2 * k as f64, -0.3]);
            let found = place.perturbed_in_from(&(Vector6::new(1e-3, -2e-3, 5e-4, 1e-3, 3e-3, -2e-3) * off));
            log.estimated.push((k != 4).then(|| truth * found));
            log.truth.push(truth.relabel());
            log.frames.push(FrameSample {
                t_s: k as f64,
                status: "ok".to_owned(),
                fitness: None,
                depth_error_m: None,
                normal_error_rad: None,
                latency_millis: 0.0,
                age_millis: None,
                covariance: None,
                pose_covariance: None,
            });
        }
        let mean = mean_place(&log, 5.0).unwrap();
        // The remaining error is of second order in the offsets.
        assert!((place.inverse() * mean).log().norm() < 1e-5, "{mean:?}");
        assert_eq!(mean_place(&log, 0.0), None);
    }
}
