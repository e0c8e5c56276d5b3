//! One run of one scenario: the loop of `pb3dp run` with both arms emulated in virtual time, and all faults.

use std::collections::VecDeque;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Result;
use nalgebra::{Matrix6, Vector3, Vector6};
use pb3dp_cell::capturing::{Captured, Capturing};
use pb3dp_cell::cell::{FreeTarget, SimulatedCell};
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::halves::{Capture, Estimate, Record, RunContext};
use pb3dp_cell::journal::Journal;
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::operator::Operator;
use pb3dp_cell::parts::Parts;
use pb3dp_cell::percept::Percept;
use pb3dp_cell::vision::{Estimating, Vision};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::Confidence;
use pb3dp_servo::{SearchConfig, TargetObservation};
use pb3dp_setup::setup::{Carrier, Setup};
use pb3dp_sim::camera_faults::CameraFaultKind;
use pb3dp_sim::trajectory::Trajectory;
use pb3dp_wiring::{VirtualWorld, Wired, wire_cell};
use system_tests::safety::truth::{ARM_NAMES, LogLine, Truth};

use crate::cameras;
use crate::control::{Faulty, Happening};
use crate::effects::{self, Became};
use crate::faults::Kind;
use crate::program_log::ProgramLog;
use crate::recorder::{Recorder, Shared, lock};
use crate::scenario::{Dice, Scenario};
use crate::speaker::{Overheard, Speaker};
use crate::telling::Faults;

/// The search in runs in which the hand may search for its target.
const SEARCH: SearchConfig =
    SearchConfig { back_m: 0.05, radius_m: 0.05, turns: 2.0, speed_m_per_s: 0.03, time_s: 10.0 };
/// Largest duration of a search after the loss, seconds.
pub const SEARCH_MAX_S: f64 = 12.0;
/// Time for which the arms are observed after the end of the control loop.
const AFTERWARDS: Duration = Duration::from_millis(1500);
/// Number of poses that are kept.
const BUFFERED: usize = 8;
/// Interval between these observations.
pub const LOOK: Duration = Duration::from_millis(10);

/// Result of one run.
pub struct Ran {
    /// The true course of the run.
    pub truth: Truth,
    /// Why the control loop ended early.
    pub ended: Option<String>,
    /// Outcome of each fault of the scenario.
    pub became: Vec<Became>,
    /// State of the supervisor in which each fault began.
    pub states: Vec<Option<&'static str>>,
    /// Start of the control loop after that of the camera, seconds; none if a fault may have delayed it.
    pub lead_s: Option<f64>,
    /// A new host began after the first one had died.
    pub has_new_host: bool,
    /// Commands, conditions and latches, for a trace.
    pub notes: Vec<LogLine>,
}

/// What all hosts of a run share.
pub struct Stage<'a> {
    /// The setups that no scenario has changed.
    pub base: &'a Setup,
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// The record of the run.
    pub recorder: Shared,
    /// The true cell, as the first host found it.
    pub cell: SimulatedCell,
    /// What outlives a host.
    pub world: VirtualWorld,
    log: ProgramLog,
}

/// The setup of a scenario, for a host whose camera starts at this time of the run, seconds.
///
/// # Errors
/// If the arms cannot start there.
pub fn setup_of(base: &Setup, scenario: &Scenario, starts_s: f64) -> Result<Setup> {
    let mut setup = base.clone();
    setup.reseed(scenario.seed);
    scenario.workcell.apply(&mut setup)?;
    setup.experiment.motion = scenario.motion.clone();
    setup.experiment.carrier = scenario.carrier;
    if let Some(world) = setup.world.as_mut() {
        world.faults = cameras::plan(&scenario.faults, scenario.seed, starts_s);
    }
    if scenario.searches {
        setup.controller.search = Some(SEARCH);
        setup.supervisor.search_max_s = SEARCH_MAX_S;
    }
    Ok(setup)
}

/// Runs a scenario.
///
/// # Errors
/// If it cannot be built: no run of this simulation is refused.
pub fn run(base: &Setup, scenario: &Scenario) -> Result<Ran> {
    let setup = setup_of(base, scenario, -cameras::LEAD_S)?;
    let wired = wire_cell(&setup, |cell, start| {
        scenario.workcell.change(cell)?;
        let motion = scenario.motion.begin_at(start)?;
        if scenario.carrier == Carrier::Nothing {
            cell.free_target = Some(FreeTarget::new(Arc::clone(&motion)));
        }
        Ok(motion)
    })?;
    let Wired { parts, monitors, world } = wired;
    let ends = by_arm(world.arms.iter().map(|arm| (arm.name, arm.end.clone())));
    let of_arms = (by_arm(monitors), ends);
    let (clock, cell) = (Arc::clone(&parts.clock), parts.cell.clone());
    let recorder: Shared = Arc::new(Mutex::new(Recorder::new(scenario.clone(), cell.clone(), of_arms)));
    let log = ProgramLog::new(Arc::clone(&clock));
    let stage = Stage { base, scenario, clock, recorder, cell, world, log };
    let experiment = Arc::clone(&parts.experiment);
    let mut first = Host::new(&stage, (&setup, -cameras::LEAD_S, &*experiment), parts, Happening::new(scenario))?;
    let mut ended = first.run(&stage);
    let lead_s = (!scenario.disturbs_enabling()).then(|| first.writing.begin.seconds_since(first.writing.wired));
    let zero = first.writing.zero;
    if let Some(restart) = scenario.restart.filter(|_| first.faulty.happening.has_died) {
        // The arms of the dead host stay until the next one has connected: they work off what happens at the far ends.
        if let Some((setup, planned_s, Wired { parts, monitors, .. })) = restart.next_host(&stage)? {
            lock(&stage.recorder).connected(by_arm(monitors), parts.cell.clone());
            stage.log.set_closed(false);
            let happening = std::mem::take(&mut first.faulty.happening);
            drop(first);
            let experiment = Arc::clone(&parts.experiment);
            let mut second = Host::new(&stage, (&setup, planned_s, &*experiment), parts, happening)?;
            ended = second.run(&stage);
            return Ok(afterwards(&stage, (lead_s, stage.log.take(zero)), ended));
        }
    }
    let log = stage.log.take(zero);
    Ok(afterwards(&stage, (lead_s, log), ended))
}

/// What belongs to each arm, by its name; an arm that is simulated in the process has no line.
fn by_arm<T>(named: impl IntoIterator<Item = (&'static str, T)>) -> [Option<T>; 2] {
    let mut arms = [None, None];
    for (name, of_arm) in named {
        if let Some(arm) = ARM_NAMES.iter().position(|of| *of == name) {
            arms[arm] = Some(of_arm);
        }
    }
    arms
}

/// A host: the program, from its start to its end or its death.
struct Host<'a> {
    setup: &'a Setup,
    interrupt: Arc<AtomicBool>,
    camera: Camera<'a>,
    vision_watcher: VisionWatcher<'a>,
    writing: Writing<'a>,
    faulty: Faulty<'a>,
}

impl<'a> Host<'a> {
    /// `planned_s`: time of the scenario for which the faults of the camera are planned, which starts now.
    fn new(
        stage: &Stage<'a>,
        (setup, planned_s, experiment): (&'a Setup, f64, &'a dyn Trajectory),
        parts: Parts,
        happening: Happening,
    ) -> Result<Self> {
        let Stage { scenario, clock, recorder, log, world, .. } = stage;
        let now = clock.now();
        let sees = (parts.camera, parts.cell.clone(), parts.marking);
        let Vision { capturing, estimating } = Vision::new(setup, sees, &parts.clock)?;
        let operator: Box<dyn Operator> = match scenario.has_person {
            true => Box::new(Speaker::new(scenario, Arc::clone(clock), (Arc::clone(recorder), log.clone()))),
            false => Box::new(Overheard::new(scenario, Arc::clone(clock), Arc::clone(recorder))),
        };
        let moving = Moving::new(setup, (parts.vs, parts.tc), experiment, now)?.with_operator(operator);
        let (cell, interrupt) = (parts.cell, Arc::new(AtomicBool::new(false)));
        let zero = happening.zero.unwrap_or(now);
        let noticing = CameraFaults { scenario, recorder: Arc::clone(recorder), started: now, planned_s };
        let camera = Camera { capturing, clock: Arc::clone(clock), faults: noticing.clone() };
        let vision_watcher = VisionWatcher {
            estimating,
            scenario,
            clock: Arc::clone(clock),
            recorder: Arc::clone(recorder),
            camera_faults: noticing,
            dice: Dice::new(!scenario.seed),
            hit: false,
            waiting: VecDeque::new(),
            buffered: VecDeque::new(),
            standing: None,
        };
        let writing = Writing {
            journal: Journal::new(setup, experiment, (true, true), (now, scenario.run_s))?,
            unwritten: VecDeque::new(),
            begin_cell: Box::new(move |begin| cell.begin_at(begin)),
            scenario,
            clock: Arc::clone(clock),
            recorder: Arc::clone(recorder),
            wired: now,
            begin: now,
            zero,
            is_first: happening.zero.is_none(),
        };
        let faulty = Faulty {
            inner: moving,
            scenario,
            clock: Arc::clone(clock),
            recorder: Arc::clone(recorder),
            log: log.clone(),
            ends: by_arm(world.arms.iter().map(|arm| (arm.name, arm.end.clone()))),
            interrupt: Arc::clone(&interrupt),
            begin: now,
            wired: now,
            happening,
        };
        Ok(Self { setup, interrupt, camera, vision_watcher, writing, faulty })
    }

    /// Runs the program; returns why it ended early.
    fn run(&mut self, stage: &Stage<'_>) -> Option<String> {
        let Stage { scenario, clock, recorder, log, .. } = stage;
        let left_s = scenario.run_s - lock(recorder).t_s(clock.now());
        let duration = Duration::from_secs_f64(left_s.max(0.0));
        let run_context = RunContext { setup: self.setup, clock, duration, interrupt: &self.interrupt };
        let outcome = tracing::subscriber::with_default(log.clone(), || {
            let Self { camera, vision_watcher, writing, faulty, .. } = self;
            let outcome = run_context.run_in_lockstep((camera, vision_watcher, writing), faulty);
            self.writing.write_all();
            outcome
        });
        let ended = outcome.err().map(|error| format!("{error:#}"));
        // The program prints the failure that ends it.
        ended.iter().for_each(|ended| log.push(ended.clone()));
        ended
    }
}

/// Observes both arms for a while, and collects what was noticed.
fn afterwards(stage: &Stage<'_>, (lead_s, log): (Option<f64>, Vec<LogLine>), ended: Option<String>) -> Ran {
    let Stage { scenario, clock, recorder, .. } = stage;
    let mut recording = lock(recorder);
    recording.ended(clock.now());
    recording.catch_up(clock.now());
    let until = clock.now() + AFTERWARDS;
    while clock.now() < until {
        clock.sleep_until(clock.now() + LOOK);
        recording.catch_up(clock.now());
    }
    recording.noticed_s.extend(log.iter().map(|line| line.t_millis as f64 * 1e-3));
    recording.truth.log = log;
    let (times, resets_s) = (recording.times(), std::mem::take(&mut recording.resets_s));
    let absent_s = recording.absent_s;
    let faults = Faults { faults: &scenario.faults, times: &times, resets_s: &resets_s, absent_s };
    recording.truth.injected = faults.to_be_logged(&recording.truth);
    let became = effects::all(scenario, &times, &recording);
    let states = effects::states(&scenario.faults, &times, &recording.truth);
    let notes = std::mem::take(&mut recording.notes);
    let has_new_host = absent_s.is_some_and(|(_, until_s)| until_s.is_finite());
    Ran { truth: std::mem::take(&mut recording.truth), ended, became, states, lead_s, has_new_host, notes }
}

/// The camera: notices what its faults do to the pairs that do not come.
struct Camera<'a> {
    capturing: Capturing,
    clock: Arc<dyn Clock>,
    faults: CameraFaults<'a>,
}

impl Capture for Camera<'_> {
    fn capture(&mut self) -> Result<Option<Captured>> {
        let captured = self.capturing.capture()?;
        if captured.is_none() {
            self.faults.note(None, self.clock.now());
        }
        Ok(captured)
    }
}

/// The perception thread with its faults.
struct VisionWatcher<'a> {
    estimating: Estimating<'a>,
    scenario: &'a Scenario,
    clock: Arc<dyn Clock>,
    recorder: Shared,
    camera_faults: CameraFaults<'a>,
    dice: Dice,
    /// Whether the last checked fault changed a percept.
    hit: bool,
    /// Late percepts, and when they are due.
    waiting: VecDeque<(MonotonicTime, Percept)>,
    /// The last poses.
    buffered: VecDeque<Option<TargetObservation>>,
    /// The image number that repeats.
    standing: Option<u64>,
}

impl Estimate<StepRecord> for VisionWatcher<'_> {
    type Observed = PairEstimate;

    fn moved(&mut self, step: &StepRecord) {
        self.estimating.moved(step);
    }

    fn look(&mut self, frame: Captured) -> Result<(Option<Percept>, PairEstimate)> {
        let newest = self.estimating.look(frame)?;
        let (percept, now) = (newest.percept(), self.clock.now());
        self.camera_faults.note(Some(&percept), now);
        let t_s = lock(&self.recorder).t_s(now);
        self.buffered.push_front(percept.observation);
        self.buffered.truncate(BUFFERED);
        let mut changed = Some(percept);
        let mut faults: Vec<_> =
            self.scenario.faults.iter().enumerate().filter(|(_, fault)| fault.is_on(t_s)).collect();
        // A camera buffers images before anything else can happen to their poses: a pose that is scattered stays scattered.
        faults.sort_by_key(|(_, fault)| !matches!(fault.kind, Kind::OldContent(_)));
        for (index, fault) in faults {
            let Some(percept) = changed else { break };
            self.hit = true;
            changed = self.spoil(&fault.kind, percept, now);
            if self.hit {
                lock(&self.recorder).touched(index);
            }
        }
        if changed.is_none() {
            let is_due = self.waiting.front().is_some_and(|(due, _)| *due <= now);
            changed = if is_due { self.waiting.pop_front().map(|(_, percept)| percept) } else { None };
        }
        Ok((changed, newest))
    }
}

/// The recording thread with its faults.
struct Writing<'a> {
    /// The part of the program that writes the log of a run.
    journal: Journal<'a>,
    /// Control steps that wait for it while it stands still.
    unwritten: VecDeque<StepRecord>,
    begin_cell: Box<dyn Fn(MonotonicTime)>,
    scenario: &'a Scenario,
    clock: Arc<dyn Clock>,
    recorder: Shared,
    /// When the camera started.
    wired: MonotonicTime,
    begin: MonotonicTime,
    /// Time zero of the scenario: the begin of the first host.
    zero: MonotonicTime,
    is_first: bool,
}

impl Record<StepRecord, PairEstimate> for Writing<'_> {
    fn begin_at(&mut self, begin: MonotonicTime) {
        (self.begin_cell)(begin);
        self.journal.begin_at(begin);
        self.begin = begin;
        if self.is_first {
            self.zero = begin;
            lock(&self.recorder).begin_at(begin);
        } else {
            lock(&self.recorder).begin_again(begin);
        }
    }

    fn moved(&mut self, step: &StepRecord) {
        self.unwritten.push_back(*step);
        self.write_unless_stalled();
        lock(&self.recorder).moved(step, self.clock.now());
    }
}

impl Writing<'_> {
    /// Writes the control steps that wait, as a thread of its own does in a real run, unless that thread stands still.
    fn write_unless_stalled(&mut self) {
        let t_s = self.clock.now().seconds_since(self.zero);
        let mut faults = self.scenario.faults.iter().enumerate();
        let stall = faults.find(|(_, fault)| matches!(fault.kind, Kind::RecorderStalls) && fault.is_on(t_s));
        match stall {
            Some((index, _)) => lock(&self.recorder).touched(index),
            None => self.write_all(),
        }
    }

    fn write_all(&mut self) {
        while let Some(step) = self.unwritten.pop_front() {
            self.journal.note(&step, None);
        }
    }
}

/// What the faults of the camera do.
#[derive(Clone)]
struct CameraFaults<'a> {
    scenario: &'a Scenario,
    recorder: Shared,
    /// When the camera started, and the time of the scenario for which its faults are planned: the arms of a new host are connected
    /// between the two.
    started: MonotonicTime,
    planned_s: f64,
}

impl CameraFaults<'_> {
    /// Records the effect of camera faults on the frame pair that is due now.
    fn note(&self, newest: Option<&Percept>, now: MonotonicTime) {
        let t_s = self.planned_s + now.seconds_since(self.started);
        let is_spoiled = newest.is_none_or(|percept| percept.estimate.confidence != Confidence::Sure);
        for (index, fault) in self.scenario.faults.iter().enumerate().filter(|(_, fault)| fault.is_on(t_s)) {
            let Kind::Camera(kind) = fault.kind else { continue };
            let mut recorder = lock(&self.recorder);
            if is_spoiled || cameras::is_of_each_pair(&kind) {
                recorder.touched(index);
            }
            // A frozen camera delivers no new image, whatever frame number it reports.
            let exposed_s = newest.map(|percept| self.planned_s + since_s(percept.frame.at, self.started));
            if let (Some(percept), true, CameraFaultKind::Frozen) =
                (newest, exposed_s.is_some_and(|exposed_s| fault.is_on(exposed_s)), kind)
            {
                recorder.spoiled(percept.frame.sequence);
            }
        }
    }
}

impl VisionWatcher<'_> {
    /// Applies a fault to a percept; `None`: it is not delivered now.
    fn spoil(&mut self, kind: &Kind, mut percept: Percept, now: MonotonicTime) -> Option<Percept> {
        match *kind {
            Kind::EstimatesLost(share) if self.dice.unit() < share => return None,
            Kind::NoPose => {
                percept.estimate.confidence = Confidence::NoPose;
                percept.observation = None;
            }
            Kind::Doubtful => {
                percept.estimate.confidence = Confidence::Doubtful;
                percept.observation.iter_mut().for_each(|observation| observation.trusted = false);
            }
            Kind::Late(by_s) => {
                self.waiting.push_back((now + Duration::from_secs_f64(by_s), percept));
                return None;
            }
            Kind::Stall => {
                self.waiting = VecDeque::from([(now, percept)]);
                return None;
            }
            Kind::Off(by_m, turned_rad) => displace(&mut percept, by_m, turned_rad),
            Kind::Outliers(by_m) if self.dice.unit() < 0.2 => displace(&mut percept, by_m, 0.0),
            Kind::Skew(by_s) => percept.frame.skew_s = by_s,
            Kind::OldImages => {
                percept.frame.sequence = percept.frame.sequence.saturating_sub(5);
                percept.frame.at = percept.frame.at - Duration::from_millis(150);
                percept.estimate.at = percept.frame.at;
                percept.observation.iter_mut().for_each(|observation| observation.at = percept.frame.at);
            }
            Kind::OtherTarget => percept.estimate.target += 1,
            Kind::NumbersStand => {
                let number = *self.standing.get_or_insert(percept.frame.sequence.saturating_sub(1));
                percept.frame.sequence = number;
            }
            Kind::OldContent(pairs) => {
                let old = self.buffered.get(pairs).copied().flatten();
                if let (Some(observation), Some(old)) = (&mut percept.observation, old) {
                    observation.cam_left_from_model = old.cam_left_from_model;
                }
            }
            Kind::Scatter(by_m) => {
                let side = [0, 1, 2].map(|_| self.dice.within(-1.0, 1.0));
                scatter(&mut percept, by_m, side);
                lock(&self.recorder).spoiled(percept.frame.sequence);
            }
            Kind::Unsure(factors) => {
                let share = |i: usize| if i < 3 { factors[0] } else { factors[1] };
                let scaled = |covariance: Matrix6<f64>| covariance.map_with_location(|i, j, c| c * share(i) * share(j));
                percept.estimate.covariance = percept.estimate.covariance.map(scaled);
                percept.observation.iter_mut().for_each(|newest| newest.covariance = newest.covariance.map(scaled));
            }
            _ => self.hit = false,
        }
        Some(percept)
    }
}

/// Displaces a pose by this much in a direction; the length of `side` does not matter.
fn scatter(percept: &mut Percept, by_m: f64, side: [f64; 3]) {
    let side = Vector3::from(side);
    let way_m = side.try_normalize(1e-6).unwrap_or_else(Vector3::x) * by_m;
    if let Some(observation) = &mut percept.observation {
        let xi = Vector6::new(way_m.x, way_m.y, way_m.z, 0.0, 0.0, 0.0);
        observation.cam_left_from_model = observation.cam_left_from_model.perturbed_in_from(&xi);
    }
}

fn displace(percept: &mut Percept, by_m: f64, turned_rad: f64) {
    let xi = Vector6::new(by_m, 0.3 * by_m, -0.5 * by_m, turned_rad, 0.2 * turned_rad, 0.0);
    if let Some(observation) = &mut percept.observation {
        observation.cam_left_from_model = observation.cam_left_from_model.perturbed_in_from(&xi);
    }
}

/// Seconds from one time to another; negative if it is earlier.
fn since_s(at: MonotonicTime, zero: MonotonicTime) -> f64 {
    if at >= zero { at.seconds_since(zero) } else { -zero.seconds_since(at) }
}
