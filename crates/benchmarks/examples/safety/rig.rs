//! One run of one scenario: the loop of `pb3dp run` with both arms emulated in virtual time, and all faults.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Result;
use nalgebra::{Matrix6, Vector3, Vector6};
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_cell::cell::FreeTarget;
use pb3dp_cell::channels::Plan;
use pb3dp_cell::halves::{Course, Mover, Watcher};
use pb3dp_cell::journal::Journal;
use pb3dp_cell::log::RunLog;
use pb3dp_cell::looking::Looking;
use pb3dp_cell::moving::{Moved, Moving};
use pb3dp_cell::operator::Operator;
use pb3dp_cell::percept::Percept;
use pb3dp_cell::strip::Strip;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::Confidence;
use pb3dp_servo::{SearchConfig, TargetObservation};
use pb3dp_setup::setup::{Carrier, Setup};
use pb3dp_sim::camera_faults::CameraFaultKind;
use pb3dp_wiring::{Wired, wire_cell};
use system_tests::safety::truth::{LogLine, Truth};

use crate::cameras;
use crate::effects::{self, Became};
use crate::faults::{Fault, Kind};
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
const LOOK: Duration = Duration::from_millis(10);

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
    /// Commands, conditions and latches, for a trace.
    pub notes: Vec<LogLine>,
}

/// The setup of a scenario.
fn setup_of(base: &Setup, scenario: &Scenario) -> Result<Setup> {
    let mut setup = base.clone();
    setup.reseed(scenario.seed);
    scenario.workcell.apply(&mut setup)?;
    setup.experiment.motion = scenario.motion.clone();
    setup.experiment.carrier = scenario.carrier;
    if let Some(world) = setup.world.as_mut() {
        world.faults = cameras::plan(&scenario.faults, scenario.seed);
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
    let setup = setup_of(base, scenario)?;
    let Wired { parts, monitors, virtual_ends } = wire_cell(&setup, |cell, start| {
        scenario.workcell.change(cell)?;
        let motion = scenario.motion.begin_at(start)?;
        if scenario.carrier == Carrier::Nothing {
            cell.free_target = Some(FreeTarget::new(Arc::clone(&motion)));
        }
        Ok(motion)
    })?;
    let ends = virtual_ends.into_iter().map(|(_, end)| end).collect::<Vec<_>>();
    let monitors = monitors.into_iter().map(|(_, monitor)| monitor);
    let arms: Vec<_> = monitors.zip(ends.clone()).collect();
    let arms = arms.try_into().map_err(|_| anyhow::anyhow!("not two emulated arms"))?;
    let recorder: Shared = Arc::new(Mutex::new(Recorder::new(scenario.clone(), parts.cell.clone(), arms)));
    let clock = Arc::clone(&parts.clock);
    let now = clock.now();
    let looking = Looking::new(
        &setup,
        (parts.camera, parts.cell.clone(), parts.marking),
        (Strip::default(), &parts.clock),
        None,
    )?;
    let log = ProgramLog::new(Arc::clone(&clock));
    let operator: Box<dyn Operator> = match scenario.has_person {
        true => Box::new(Speaker::new(scenario, Arc::clone(&clock), (Arc::clone(&recorder), log.clone()))),
        false => Box::new(Overheard::new(scenario, Arc::clone(&clock), Arc::clone(&recorder))),
    };
    let moving = Moving::new(&setup, (parts.vs, parts.tc), &*parts.experiment, now)?.with_operator(operator);
    let plan = Plan::of(&scenario.motion, &*parts.experiment);
    let cell = parts.cell;
    let mut watching = Watching {
        looking,
        journal: Journal::new(&setup, (now, scenario.run_s), (RunLog::default(), plan)),
        begin_cell: Box::new(move |begin| cell.begin_at(begin)),
        scenario,
        clock: Arc::clone(&clock),
        recorder: Arc::clone(&recorder),
        wired: now,
        begin: now,
        dice: Dice::new(!scenario.seed),
        hit: false,
        waiting: VecDeque::new(),
        buffered: VecDeque::new(),
        standing: None,
    };
    let interrupt = AtomicBool::new(false);
    let mut faulty = Faulty {
        inner: moving,
        scenario,
        clock: Arc::clone(&clock),
        recorder: Arc::clone(&recorder),
        ends,
        begin: now,
        interrupt: &interrupt,
        wired: now,
        begun_at: vec![None; scenario.faults.len()],
        ended: vec![false; scenario.faults.len()],
    };
    let duration = Duration::from_secs_f64(scenario.run_s);
    let course = Course { setup: &setup, clock: &clock, duration, interrupt: &interrupt };
    let outcome = tracing::subscriber::with_default(log.clone(), || course.run_in_lockstep(&mut watching, &mut faulty));
    let lead_s = (!scenario.disturbs_enabling()).then(|| watching.begin.seconds_since(watching.wired));
    let ended = outcome.err().map(|error| format!("{error:#}"));
    // The program prints the failure that ends it.
    ended.iter().for_each(|ended| log.push(ended.clone()));
    let log = log.take(watching.begin);
    Ok(afterwards(scenario, (lead_s, log), (&clock, &recorder), ended))
}

/// Observes both arms for a while, and collects what was noticed.
fn afterwards(
    scenario: &Scenario,
    (lead_s, log): (Option<f64>, Vec<LogLine>),
    (clock, recorder): (&Arc<dyn Clock>, &Shared),
    ended: Option<String>,
) -> Ran {
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
    let faults = Faults { faults: &scenario.faults, times: &times, resets_s: &resets_s };
    recording.truth.injected = faults.to_be_told(&recording.truth);
    let became = effects::all(scenario, &times, &recording);
    let states = effects::states(&scenario.faults, &times, &recording.truth);
    let notes = std::mem::take(&mut recording.notes);
    Ran { truth: std::mem::take(&mut recording.truth), ended, became, states, lead_s, notes }
}

/// The perception thread with its faults.
struct Watching<'a> {
    looking: Looking<'a>,
    /// The part of the program that writes the log of a run.
    journal: Journal,
    begin_cell: Box<dyn Fn(MonotonicTime)>,
    scenario: &'a Scenario,
    clock: Arc<dyn Clock>,
    recorder: Shared,
    /// When the camera started.
    wired: MonotonicTime,
    begin: MonotonicTime,
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

impl Watcher for Watching<'_> {
    type Step = Moved;

    fn begin_at(&mut self, begin: MonotonicTime) {
        (self.begin_cell)(begin);
        self.looking.begin_at(begin);
        self.journal.begin_at(begin);
        self.begin = begin;
        lock(&self.recorder).begin_at(begin);
    }

    fn moved(&mut self, step: &Moved) {
        self.looking.push_joints(step.vs_joints);
        self.journal.note(step, None);
        lock(&self.recorder).moved(step, self.clock.now());
    }

    fn look(&mut self) -> Result<Option<Percept>> {
        let seen = self.looking.look()?.map(|seen| seen.percept());
        let (now, t_s) = (self.clock.now(), self.clock.now().seconds_since(self.begin));
        self.note_cameras(seen.as_ref(), t_s);
        let Some(percept) = seen else { return Ok(None) };
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
        Ok(changed)
    }

    fn note(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Watching<'_> {
    /// Records the effect of camera faults on the frame pair that is due now.
    fn note_cameras(&self, seen: Option<&Percept>, t_s: f64) {
        let is_spoiled = seen.is_none_or(|percept| percept.estimate.confidence != Confidence::Sure);
        for (index, fault) in self.scenario.faults.iter().enumerate().filter(|(_, fault)| fault.is_on(t_s)) {
            let Kind::Camera(kind) = fault.kind else { continue };
            let mut recorder = lock(&self.recorder);
            if is_spoiled || cameras::is_of_each_pair(&kind) {
                recorder.touched(index);
            }
            // A frozen camera delivers no new image, whatever frame number it reports.
            let exposed_s = seen.map(|percept| percept.frame.at.seconds_since(self.wired) - cameras::LEAD_S);
            if let (Some(percept), true, CameraFaultKind::Frozen) =
                (seen, exposed_s.is_some_and(|exposed_s| fault.is_on(exposed_s)), kind)
            {
                recorder.spoiled(percept.frame.sequence);
            }
        }
    }

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
                percept.observation.iter_mut().for_each(|seen| seen.covariance = seen.covariance.map(scaled));
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

/// The control thread with its faults and those behind it.
struct Faulty<'a> {
    inner: Moving<'a>,
    scenario: &'a Scenario,
    clock: Arc<dyn Clock>,
    recorder: Shared,
    ends: Vec<VirtualEnd>,
    /// Ends the control loop.
    interrupt: &'a AtomicBool,
    begin: MonotonicTime,
    /// When the cell was wired; the arms are being enabled until `begin`.
    wired: MonotonicTime,
    /// When each fault actually began: while the arms are being enabled the control loop waits.
    begun_at: Vec<Option<MonotonicTime>>,
    ended: Vec<bool>,
}

impl Mover for Faulty<'_> {
    type Step = Moved;

    fn enable(&mut self) -> Result<bool> {
        let now = self.clock.now();
        self.begin_and_end_faults(now, now.seconds_since(self.wired) - cameras::LEAD_S)?;
        let enabled = self.inner.enable();
        if let Err(why) = &enabled {
            // The control loop does not begin: the record begins with the enabling.
            lock(&self.recorder).not_enabled(self.wired, why, self.clock.now());
        }
        enabled
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
        self.inner.begin_at(begin);
    }

    fn observe(&mut self, percept: Percept, now: MonotonicTime) {
        lock(&self.recorder).delivered(&percept);
        self.inner.observe(percept, self.shown(now));
    }

    fn step(&mut self, now: MonotonicTime) -> Result<Moved> {
        self.begin_and_end_faults(now, now.seconds_since(self.begin))?;
        let shown = self.shown(now);
        lock(&self.recorder).stepping([now, shown], self.clock.now());
        let stepped = self.inner.step(shown);
        if let Err(why) = &stepped {
            lock(&self.recorder).failed(why, self.clock.now());
        }
        stepped
    }

    fn stop(&mut self) -> Result<()> {
        self.inner.stop()
    }
}

impl Faulty<'_> {
    fn begin_and_end_faults(&mut self, now: MonotonicTime, t_s: f64) -> Result<()> {
        for index in 0..self.scenario.faults.len() {
            let fault = &self.scenario.faults[index];
            if self.begun_at[index].is_none() && t_s >= fault.from_s {
                self.begun_at[index] = Some(now);
                lock(&self.recorder).began(index, self.clock.now());
                self.begin_fault(fault)?;
            }
            let is_over = self.begun_at[index].is_some_and(|begun| now.seconds_since(begun) >= fault.for_s);
            if is_over && !self.ended[index] {
                self.ended[index] = true;
                self.end_fault(fault)?;
                lock(&self.recorder).ceased(index, self.clock.now());
            }
        }
        Ok(())
    }

    fn on(&self, t_s: f64) -> impl Iterator<Item = &Fault> {
        self.scenario.faults.iter().filter(move |fault| fault.is_on(t_s))
    }

    /// The time that the clock of the control loop shows.
    fn shown(&self, now: MonotonicTime) -> MonotonicTime {
        let t_s = now.seconds_since(self.begin);
        let jumps_s = self.on(t_s).map(|fault| if let Kind::ClockJump(by_s) = fault.kind { by_s } else { 0.0 });
        let by_s: f64 = jumps_s.sum();
        let by = Duration::from_secs_f64(by_s.abs());
        if by_s < 0.0 { now - by } else { now + by }
    }

    fn begin_fault(&self, fault: &Fault) -> Result<()> {
        match &fault.kind {
            Kind::Overrun(by_s) => self.clock.sleep_until(self.clock.now() + Duration::from_secs_f64(*by_s)),
            Kind::EmergencyStopOfBoth => {
                for end in &self.ends {
                    end.command_line("e-stop press")?;
                }
            }
            Kind::Unplugged(arm) => self.ends[*arm].unplug(),
            Kind::GatewayRestart(arm) => self.ends[*arm].restart_gateway(),
            Kind::HostDies => {
                for line in self.ends.iter().flat_map(|end| [(end, "line deaf on"), (end, "line silence on")]) {
                    line.0.command_line(line.1)?;
                }
                lock(&self.recorder).dies(self.clock.now());
                self.interrupt.store(true, Ordering::SeqCst);
            }
            Kind::Arm { arm, line, .. } => self.ends[*arm].command_line(line)?,
            _ => {}
        }
        Ok(())
    }

    fn end_fault(&self, fault: &Fault) -> Result<()> {
        match &fault.kind {
            Kind::EmergencyStopOfBoth => {
                for end in &self.ends {
                    end.command_line("e-stop release")?;
                }
            }
            Kind::Unplugged(arm) => self.ends[*arm].plug(),
            Kind::Arm { arm, end: Some(line), .. } => self.ends[*arm].command_line(line)?,
            _ => {}
        }
        Ok(())
    }
}
