//! Runs estimation, filter, law and supervisor again on the recorded inputs, and compares the results with the recorded ones to the bit.
//!
//! Each thread of the run has recorded what it took from the others: a control step its time, the result of the pair that it used, the
//! answers of the arms and the words of the operator; an estimate the number of steps whose joints it knew and what the operator had
//! selected. So the replay needs no threads and no clock. The arms themselves, with their limiters, are not replayed: their answers are
//! inputs.

mod arm;
mod differences;
mod past;
mod source;

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_bag::BagError;
use pb3dp_bag::messages::LogLine;
use pb3dp_bag::run_messages::{ControlStep, PairResult};
use pb3dp_bag::sinks::Sinks;
use pb3dp_cell::capturing::Captured;
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::follower::Follower;
use pb3dp_cell::halves::Mover;
use pb3dp_cell::journal::{Journal, Outcome, TruePoses};
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::percept::Percept;
use pb3dp_cell::perception::{Perception, View};
use pb3dp_cell::selection::{Choice, Selection, Selections};
use pb3dp_cell::spectator::{RunEnd, Spectator};
use pb3dp_cell::true_surface::TrueSurface;
use pb3dp_cell::vision::Estimating;
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_clock::VirtualClock;
use pb3dp_kinematics::JointState;
use pb3dp_servo::supervisor::FrameInput;
use pb3dp_setup::setup::{Leader, Setup, read_layers};
use pb3dp_sim::trajectory::Trajectory;

use self::arm::{SharedScript, has_begin};
pub use self::differences::{Compared, Differences, First, Kind};
use self::past::Past;
use self::source::{DecodeOptions, Item, RecordedPair, RecordedRun};
use crate::estimates::{is_same_estimate, pair_result, recorded_estimate, recorded_model};
use crate::exact::{marking, of_pose_if_any, percept, pose_if_any, region, same_bits};
use crate::pairs::About;
use crate::run::{RecordTo, recorder};

/// Steps and pairs that are read ahead.
const READ_AHEAD: usize = 32;

/// How a recording is replayed.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    /// Settings that are changed, each as KEY=VALUE.
    pub set: Vec<String>,
    /// Which estimates the control gets.
    pub estimates: Estimates,
}

/// Which estimates the control gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Estimates {
    /// Those of this program from the recorded images.
    #[default]
    Anew,
    /// The recorded ones; images are not read.
    Recorded,
    /// The recorded ones; images are read, for a report.
    RecordedWithImages,
}

/// A recording that can be replayed.
pub struct Opened {
    file: PathBuf,
    run: RecordedRun,
    /// The setup of the run, with the changes.
    pub setup: Setup,
    estimates: Estimates,
}

/// What a replay has found.
pub struct Replayed {
    /// Version that has recorded the run.
    pub version: String,
    /// Number of control steps.
    pub steps: u64,
    /// Number of pairs.
    pub pairs: u64,
    /// Duration of the recorded run, seconds.
    pub duration_s: f64,
    /// Comparisons.
    pub differences: Differences,
    /// Inputs that are missing in the recording.
    pub notes: Vec<String>,
    /// Time at which a recording without the begin of its run begins, seconds since then: its control is as recorded.
    pub begins_s: Option<f64>,
    /// A person led the run.
    pub is_led_by_person: bool,
    /// The end of the run; none if the recording was broken off.
    pub end: Option<RunEnd>,
    /// The record of the run for a report, if one was wanted.
    pub outcome: Option<Outcome>,
}

impl Opened {
    /// Opens a recording.
    ///
    /// # Errors
    /// A file that is no recording of a run, or a setup that this program refuses.
    pub fn new(path: &Path, options: &ReplayOptions) -> Result<Self> {
        refuse_without_effect(options)?;
        let run = RecordedRun::open(path, options.estimates != Estimates::Recorded)?;
        // The settings are in a temporary folder.
        let read = read_layers(&run.setup_args(&options.set)).map_err(|error| error.named(path));
        let mut setup = read.context("the settings of the recording")?;
        setup.layers = setup.layers.with_origins_of(&run.setup_text);
        Ok(Self { file: path.to_path_buf(), run, setup, estimates: options.estimates })
    }

    /// Whether images are estimated again.
    fn estimates_anew(&self) -> bool {
        self.setup.leader.needs_images() && self.estimates == Estimates::Anew
    }

    /// Replays the run. If `record_to` is given, the replay is recorded there, as from a run; with `reports` the result has the record of
    /// the run for a report.
    ///
    /// # Errors
    /// A damaged recording, or a failure of the estimation that the run did not have.
    pub fn replay(&mut self, record_to: Option<(&About, Sinks)>, reports: bool) -> Result<Replayed> {
        let file = self.file.clone();
        self.replay_file(record_to, reports).map_err(|error| match error.is::<BagError>() {
            // It names its file.
            true => error,
            false => error.context(file.display().to_string()),
        })
    }

    fn replay_file(&mut self, record_to: Option<(&About, Sinks)>, reports: bool) -> Result<Replayed> {
        let anew = self.estimates_anew();
        let Self { run, setup, .. } = self;
        let setup = &*setup;
        let experiment = experiment(setup)?;
        let script = SharedScript::default();
        let person = (run.begin.is_person, run.begin.can_fall_silent);
        let mut inputs = script.parts(setup.control_period, person);
        let mut recording = None;
        if let Some((about, sinks)) = record_to {
            let to = RecordTo { sinks, ..RecordTo::default() };
            // Images, steps and begin have one clock: that of the recorded run.
            let since_1970 = Duration::from_nanos(run.begin.since_1970_nanos);
            let about = About { since_1970, ..about.clone() };
            let (to_file, tapped) = recorder(&about, setup, (run.begin.clone(), inputs), to)?;
            recording = Some(to_file);
            inputs = tapped;
        }
        let begin = MonotonicTime::from_nanos(run.begin.begin_nanos);
        let journal = || Journal::new(setup, &*experiment, person, (begin, experiment.duration_s()));
        let journal = reports.then(journal).transpose()?.map(Journal::quiet);
        let surface = if reports { TrueSurface::of(setup)? } else { None };
        let moving = Moving::new(setup, (inputs.vs, inputs.tc), &*experiment, begin)?.with_operator(inputs.operator);
        let estimating = if anew { Some(estimating(setup, run)?) } else { None };
        let RecordedRun { version, items, .. } = run;
        let range = setup.rig.real_cameras.as_ref().and_then(|cameras| cameras.stereo.value_range());
        let how = DecodeOptions { size: setup.rig.stereo.left().size(), range };
        let (give_items, read_ahead) = sync_channel(READ_AHEAD);
        let mut replay = Replay {
            begin,
            since_1970_nanos: run.begin.since_1970_nanos,
            items: read_ahead,
            script,
            moving,
            estimating,
            recording,
            journal,
            surface,
            past: Past::default(),
            end: None,
            steps: VecDeque::new(),
            pairs: VecDeque::new(),
            percepts: BTreeMap::new(),
            joints: VecDeque::new(),
            progress: Progress::default(),
            why: [String::new(), String::new()],
            differences: Differences::default(),
            notes: Vec::new(),
        };
        if let Some(recording) = &mut replay.recording {
            recording.begin_at(begin);
        }
        let read = move || {
            loop {
                let item = items.next_item(how).transpose();
                let is_last = !matches!(item, Some(Ok(_)));
                if item.is_some_and(|item| give_items.send(item).is_err()) || is_last {
                    return;
                }
            }
        };
        std::thread::scope(|scope| {
            std::thread::Builder::new().name("reader".to_owned()).spawn_scoped(scope, read)?;
            let replayed = replay.all();
            // The reader does not wait for a replay that has failed.
            drop(std::mem::replace(&mut replay.items, sync_channel(0).1));
            replayed
        })?;
        replay.finish(version.clone(), person.0)
    }
}

/// Refuses changes that a replay does not see.
fn refuse_without_effect(options: &ReplayOptions) -> Result<()> {
    let of = |prefix: &'static str| options.set.iter().find(|set| set.starts_with(prefix));
    if let Some(set) = ["scene.", "truth."].into_iter().find_map(of) {
        bail!("--set {set}: a replay has the images of the recording; this key changes only what a simulation renders");
    }
    match of("estimator.") {
        Some(set) if options.estimates != Estimates::Anew => {
            bail!(
                "--set {set}: with the recorded estimates (--without-images) this key has no effect; leave one of both out"
            )
        }
        _ => Ok(()),
    }
}

/// The motion of the target that the setup plans, from its start.
fn experiment(setup: &Setup) -> Result<Arc<dyn Trajectory>> {
    let tc = &setup.rig.arms.tc;
    let start = tc.world_from_base * tc.chain.forward(&tc.start_rad) * setup.rig.flange_from_target;
    Ok(setup.experiment.motion.begin_at(start)?)
}

/// The estimation as it began, with a target for each selection.
fn estimating<'a>(setup: &'a Setup, run: &RecordedRun) -> Result<(Estimating<'a>, Selections)> {
    let Leader::Images(method) = setup.leader else { bail!("a run without images has no estimation") };
    let cameras = Perception::Images(Box::new(Follower::of_setup(setup, method)?), marking(&run.begin.marking)?);
    let selections = Selections::default();
    if let Some(of_setup) = run.begin.target_of_setup.first() {
        selections.set_target_of_setup(&marking(of_setup)?);
    }
    let estimating = Estimating::new(setup, Arc::new(VirtualClock::new()), cameras);
    Ok((estimating.with_selections(Some(selections.clone())), selections))
}

#[derive(Clone, Copy, Debug, Default)]
struct Progress {
    steps: u64,
    pairs: u64,
    /// Steps whose joints the estimation knows.
    known_steps: u64,
    /// Sequence number of the last pair.
    last_pair: Option<u64>,
    last_at: Option<MonotonicTime>,
    /// The recording is read to its end.
    is_read: bool,
    /// The control has ended, or its inputs are missing.
    control_is_over: bool,
    /// Images are missing since the last initialisation.
    is_blind: bool,
}

struct Replay<'a> {
    begin: MonotonicTime,
    since_1970_nanos: u64,
    /// Steps and pairs, read by a thread of its own.
    items: Receiver<Result<Item>>,
    script: SharedScript,
    moving: Moving<'a>,
    estimating: Option<(Estimating<'a>, Selections)>,
    recording: Option<Box<dyn Spectator>>,
    /// The history of the run, for a report.
    journal: Option<Journal<'a>>,
    /// The true surface of a simulated target, for a report.
    surface: Option<TrueSurface>,
    /// The control, if it cannot be replayed.
    past: Past,
    end: Option<RunEnd>,
    /// Read ahead, in their order.
    steps: VecDeque<ControlStep>,
    pairs: VecDeque<RecordedPair>,
    /// Results that no step has used yet, by the number of their pair.
    percepts: BTreeMap<u64, Percept>,
    /// Joints of steps that the estimation does not know yet.
    joints: VecDeque<JointState>,
    progress: Progress,
    /// The last reason of the supervisor: recorded, and now.
    why: [String; 2],
    differences: Differences,
    notes: Vec<String>,
}

impl Replay<'_> {
    fn all(&mut self) -> Result<()> {
        loop {
            let next_pair = self.pairs.front().map(|pair| pair.result.steps);
            if next_pair.is_some_and(|steps| steps <= self.progress.steps || self.nothing_else_comes()) {
                if let Some(pair) = self.pairs.pop_front() {
                    self.pair(&pair)?;
                }
            } else if self.steps.front().is_some_and(|step| self.can_take(step)) {
                if let Some(step) = self.steps.pop_front() {
                    self.step(step)?;
                }
            } else if self.progress.is_read {
                return Ok(());
            } else {
                match self.items.recv().ok().transpose()? {
                    Some(Item::Step(step)) => self.steps.push_back(*step),
                    Some(Item::Pair(pair)) => self.pairs.push_back(*pair),
                    Some(Item::Event(line)) => self.event(&line),
                    Some(Item::End(end)) => self.end = Some(end),
                    None => self.progress.is_read = true,
                }
            }
        }
    }

    /// Whether a pair waits for steps that are missing.
    fn nothing_else_comes(&self) -> bool {
        self.progress.is_read && self.steps.is_empty()
    }

    /// Whether the result that a step uses is there, or does not come any more.
    fn can_take(&self, step: &ControlStep) -> bool {
        let Some(observed) = step.observed.first() else { return true };
        self.percepts.contains_key(&observed.sequence)
            || self.progress.last_pair.is_some_and(|last| last >= observed.sequence)
            || self.progress.is_read
    }

    fn t_s(&self, at_nanos: u64) -> f64 {
        MonotonicTime::from_nanos(at_nanos).seconds_since(self.begin)
    }

    fn note(&mut self, at_nanos: u64, what: &str) {
        self.notes.push(format!("{:.3} s: {what}", self.t_s(at_nanos)));
    }

    /// Estimates a pair again, or takes the recorded estimate.
    fn pair(&mut self, recorded: &RecordedPair) -> Result<()> {
        let result = &recorded.result;
        self.progress.pairs += 1;
        self.progress.last_pair = Some(result.sequence);
        if self.progress.is_blind && !result.region.is_empty() {
            self.progress.is_blind = false;
            self.initialise_anew(result)?;
        }
        if self.estimating.is_some() && recorded.images.is_none() {
            let what = format!(
                "the images of pair {} are missing; estimates are compared again from the next",
                result.sequence
            );
            self.note(result.exposed_at_nanos, &format!("{what} initialisation"));
            self.progress.is_blind = true;
        }
        let mut pair_estimate = match &self.estimating {
            Some(_) if !self.progress.is_blind => self.estimated(recorded)?,
            _ => as_recorded(recorded)?,
        };
        if let Some(surface) = &mut self.surface {
            pair_estimate.target_from_plane =
                surface.see(pair_estimate.chosen.as_ref(), pair_estimate.region.as_ref(), &pair_estimate.captured);
        }
        self.percepts.insert(result.sequence, pair_estimate.percept());
        if let Some(recording) = &mut self.recording {
            recording.estimated(&pair_estimate);
        }
        if let Some(journal) = &mut self.journal {
            journal.note_pair(&pair_estimate)?;
        }
        Ok(())
    }

    /// Follows the target that is initialised in this pair: those before were not replayed.
    fn initialise_anew(&mut self, result: &PairResult) -> Result<()> {
        let Some((estimating, selections)) = &mut self.estimating else { return Ok(()) };
        estimating.count_targets(result.target.saturating_sub(1));
        if let (Some(marked), []) = (result.region.first(), &result.chosen[..]) {
            selections.give(Choice::Marked(Selection { region: region(marked)?, drawn_on: None, model: None }));
        }
        Ok(())
    }

    fn estimated(&mut self, recorded: &RecordedPair) -> Result<PairEstimate> {
        let (result, t_s) = (&recorded.result, self.t_s(recorded.result.exposed_at_nanos));
        let images = recorded.images.clone().context("the images are missing")?;
        let Some((estimating, selections)) = &mut self.estimating else { bail!("nothing estimates") };
        if let Some(chosen) = result.chosen.first() {
            selections.give(match chosen.kind.as_str() {
                "of setup" => Choice::OfSetup,
                _ => {
                    let is_this = chosen.drawn_on.first() == Some(&result.sequence);
                    let drawn_on = if is_this { Some(Arc::clone(&images)) } else { recorded.drawn_on.clone() };
                    Choice::Marked(Selection {
                        region: region(&chosen.region)?,
                        drawn_on,
                        model: recorded_model(result)?.map(Box::new),
                    })
                }
            });
        }
        estimating.take_selection();
        let new_steps = result.steps.saturating_sub(self.progress.known_steps);
        let new_steps = usize::try_from(new_steps).unwrap_or(usize::MAX).min(self.joints.len());
        self.joints.drain(..new_steps).for_each(|joints| estimating.push_joints(joints));
        self.progress.known_steps += new_steps as u64;
        let pair_estimate = estimating
            .look(captured(result, View::Images(images))?)
            .with_context(|| format!("the estimate of pair {} at {t_s:.3} s", result.sequence))?;
        let now = pair_result(&pair_estimate);
        let is_same = is_same_estimate(&now, result);
        self.differences.compare(Kind::Estimates, t_s, is_same, || (estimate_text(result), estimate_text(&now)));
        Ok(pair_estimate)
    }

    /// Runs a control step again.
    fn step(&mut self, mut step: ControlStep) -> Result<()> {
        let t_s = self.t_s(step.at_nanos);
        let is_first = self.progress.steps == 0;
        if step.number != self.progress.steps {
            let (from, to) = (self.progress.steps, step.number);
            self.note(step.at_nanos, &format!("steps {from} to {} are missing", to.saturating_sub(1)));
        }
        if step.lost > 0 {
            self.note(step.at_nanos, &format!("{} inputs of step {} are missing", step.lost, step.number));
        }
        self.progress.steps = step.number + 1;
        self.progress.last_at = Some(MonotonicTime::from_nanos(step.at_nanos));
        if self.progress.control_is_over {
            return Ok(());
        }
        if is_first && self.estimating.is_none() && self.journal.is_some() && !has_begin(&step) {
            self.past.begins_s = Some(t_s);
        }
        if self.past.begins_s.is_some() {
            return self.as_recorded(&step);
        }
        if is_first {
            self.script.begin(&mut step)?;
            if !self.moving.enable()? {
                bail!("the recording begins with arms that are not enabled");
            }
            self.moving.begin_at(self.begin);
        }
        self.script.load(&step, t_s)?;
        let at = MonotonicTime::from_nanos(step.at_nanos);
        if let Some(recorded) = percept(&step)? {
            let sequence = recorded.frame.sequence;
            let replayed = self.percepts.remove(&sequence);
            self.percepts.retain(|other, _| *other > sequence);
            self.moving.observe(replayed.unwrap_or(recorded), at);
        }
        let outcome = self.moving.step(at);
        self.script.end_step(outcome.is_err() && !step.finished)?;
        self.differences.add(self.script.differences());
        match (outcome, step.finished) {
            (Ok(moved), true) => self.compare(&step, t_s, &moved, true_poses(&step)?),
            (Ok(_), false) => self.decided(t_s, "the run ends with a failure", "it goes on"),
            (Err(why), true) => self.decided(t_s, "the run goes on", &format!("{why:#}")),
            (Err(_), false) => self.progress.control_is_over = true,
        }
        Ok(())
    }

    /// Keeps a step for the report that cannot be replayed.
    fn as_recorded(&mut self, step: &ControlStep) -> Result<()> {
        let Some(journal) = &mut self.journal else { return Ok(()) };
        if let Some(recorded) = self.past.step(step)? {
            journal.note_recorded(recorded, true_poses(step)?);
        }
        Ok(())
    }

    fn event(&mut self, line: &LogLine) {
        if self.journal.is_some() {
            let at_nanos = line.stamp.nanos().saturating_sub(self.since_1970_nanos);
            self.past.event(line, self.t_s(at_nanos));
        }
    }

    fn decided(&mut self, t_s: f64, recorded: &str, now: &str) {
        self.differences.differ(Kind::Decisions, t_s, recorded.to_owned(), now.to_owned());
        self.progress.control_is_over = true;
    }

    fn compare(&mut self, step: &ControlStep, t_s: f64, moved: &StepRecord, poses: Option<TruePoses>) {
        let filtered = of_pose_if_any(moved.base_from_model.as_ref());
        let same = same_bits(&step.base_from_model, &filtered);
        self.differences.compare(Kind::Filter, t_s, same, || (numbers(&step.base_from_model), numbers(&filtered)));
        if !step.why.is_empty() {
            self.why[0].clone_from(&step.why);
        }
        self.why[1] = moved.decision.why.to_string();
        let (mode, state) = (moved.mode.to_string(), moved.decision.state.name());
        let same = step.mode == mode && step.state == state && self.why[0] == self.why[1];
        let text_of = |mode: &str, state: &str, why: &str| format!("{mode}; {state}; {why}");
        let [recorded, now] = &self.why;
        self.differences.compare(Kind::Decisions, t_s, same, || {
            (text_of(&step.mode, &step.state, recorded), text_of(&mode, state, now))
        });
        if self.estimating.is_some() {
            self.joints.push_back(moved.vs_joints);
        }
        if let Some(recording) = &mut self.recording {
            recording.moved(moved, poses);
        }
        if let Some(journal) = &mut self.journal {
            journal.note(moved, poses);
        }
    }

    fn finish(mut self, version: String, is_led_by_person: bool) -> Result<Replayed> {
        let end = self.end.clone().unwrap_or_default();
        if let Some(recording) = self.recording.take() {
            recording.finish(&end)?;
        }
        if let (Some(journal), Some(_)) = (&mut self.journal, self.past.begins_s) {
            // The changes of state of a control that was not replayed are those of the recording.
            self.past.changes.into_iter().for_each(|change| journal.note_change(change));
        }
        let Progress { steps, pairs, last_at, .. } = self.progress;
        if steps == 0 {
            bail!("the recording has no control step");
        }
        Ok(Replayed {
            version,
            steps,
            pairs,
            duration_s: last_at.map_or(0.0, |at| at.seconds_since(self.begin)),
            differences: self.differences,
            notes: self.notes,
            is_led_by_person,
            begins_s: self.past.begins_s,
            outcome: self.journal.map(|journal| journal.finish(end.pairs_lost, end.commands)),
            end: self.end,
        })
    }
}

fn true_poses(step: &ControlStep) -> Result<Option<TruePoses>> {
    let hand = pose_if_any("world_from_hand", &step.world_from_hand)?;
    let target = pose_if_any("world_from_target", &step.world_from_target)?;
    Ok(hand.zip(target).map(|(world_from_hand, world_from_target)| TruePoses { world_from_hand, world_from_target }))
}

fn captured(result: &PairResult, view: View) -> Result<Captured> {
    let at = MonotonicTime::from_nanos(result.exposed_at_nanos);
    Ok(Captured {
        frame: FrameInput { sequence: result.sequence, at, skew_s: result.skew_s },
        cam_left_from_target: pose_if_any("cam_left_from_target", &result.cam_left_from_target)?,
        view,
    })
}

/// The recorded estimate.
fn as_recorded(recorded: &RecordedPair) -> Result<PairEstimate> {
    let result = &recorded.result;
    let view = recorded.images.clone().map_or(View::Nothing, View::Images);
    let motion = pose_if_any("cam_left_prev_from_cam_left_now", &result.cam_left_prev_from_cam_left_now)?;
    let dt_s = result.since_previous_s.first().copied();
    let prior = FramePrior { dt_s, skew_s: result.skew_s, ..FramePrior::of_motion(motion.as_ref()) };
    Ok(PairEstimate {
        captured: captured(result, view)?,
        steps: result.steps,
        chosen: None,
        target: result.target,
        region: result.region.first().map(region).transpose()?,
        prior,
        estimate: recorded_estimate(result)?,
        target_from_plane: None,
        latency_millis: result.latency_millis,
        age_millis: result.age_millis,
    })
}

fn numbers(values: &[f64]) -> String {
    if values.is_empty() { "none".to_owned() } else { format!("{values:?}") }
}

fn estimate_text(result: &PairResult) -> String {
    format!(
        "pair {}: {}, target {}, pose {}",
        result.sequence,
        result.status,
        result.target,
        numbers(&result.cam_left_from_model)
    )
}
