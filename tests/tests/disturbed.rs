//! Runs of the whole program in simulated time, with arms that are emulated byte by byte, in which one part stands still for a
//! while, or is later than the program knows.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_cell::capturing::Captured;
use pb3dp_cell::cell::{FreeTarget, SimulatedCell};
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::halves::{Estimate, Mover, RunContext};
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::percept::Percept;
use pb3dp_cell::vision::{Estimating, Vision};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::TargetObservation;
use pb3dp_servo::supervisor::{EstimateInput, FrameInput, Permission, State, Why};
use pb3dp_setup::setup::{Carrier, Leader, Pace, Setup, read_setup};
use pb3dp_sim::trajectory::MotionConfig;
use pb3dp_wiring::{Wired, wire_cell};

use system_tests::repository;

/// Interval of the recorded true poses.
const SAMPLED: Duration = Duration::from_millis(2);

/// A part that can stand still.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The control thread makes no step.
    Host,
    /// No estimate arrives; then the newest one, late.
    Estimator,
    /// No pair is exposed.
    Camera,
    /// The line to the arm that carries the cameras transports nothing.
    Link,
}

/// A part stands still.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stall {
    /// The part.
    pub part: Part,
    /// When it begins, seconds since the first control step.
    pub from_s: f64,
    /// Its length, seconds.
    pub for_s: f64,
}

/// What disturbs a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// Nothing.
    None,
    /// A part stands still once.
    Stall(Stall),
    /// Images are older than their time stamps by this time, seconds: the cameras keep some before they stamp them.
    LateImages(f64),
}

impl Disturbance {
    /// Whether this part stands still.
    fn stops(self, part: Part, t_s: f64) -> bool {
        matches!(self, Self::Stall(stall) if stall.stops(part, t_s))
    }
}

impl Stall {
    fn until_s(&self) -> f64 {
        self.from_s + self.for_s
    }

    /// Whether this part stands still.
    fn stops(&self, part: Part, t_s: f64) -> bool {
        self.part == part && (self.from_s..self.until_s()).contains(&t_s)
    }
}

/// The true state of the cell at a time.
#[derive(Clone, Copy, Debug)]
pub struct TruePlace {
    /// Seconds since the first control step.
    pub t_s: f64,
    /// Position of the hand in the world, mm.
    pub hand_mm: nalgebra::Vector3<f64>,
}

/// A control step.
#[derive(Clone, Copy, Debug)]
pub struct Decided {
    /// Seconds since the first control step.
    pub t_s: f64,
    /// State of the supervisor.
    pub state: State,
    /// Its permission.
    pub permission: Permission,
    /// Its reason.
    pub why: Why,
}

/// The course of a run.
#[derive(Debug, Default)]
pub struct Ran {
    /// True places, every 2 ms.
    pub places: Vec<TruePlace>,
    /// Decisions of the supervisor.
    pub decided: Vec<Decided>,
    /// Why the run ended early.
    pub ended: Option<String>,
}

/// The setup `hil` in simulated time and without images, with a target that no arm carries.
///
/// # Errors
/// If the file cannot be read.
pub fn setup(motion: MotionConfig) -> Result<Setup> {
    let mut setup = read_setup(&repository().join("configs/hil.toml"))?;
    setup.pace = Pace::Fast;
    setup.compared.clear();
    setup.leader = Leader::Geometric(setup.geometric.context("configs/hil.toml has no table estimator.geometric")?);
    setup.experiment.carrier = Carrier::Nothing;
    setup.experiment.motion = motion;
    Ok(setup)
}

/// Runs a setup for some seconds.
///
/// # Errors
/// If it cannot be built; a run that ends early is no error.
pub fn run(setup: &Setup, disturbance: Disturbance, for_s: f64) -> Result<Ran> {
    let Wired { parts, world, .. } = wire_cell(setup, |cell, start| {
        let motion = setup.experiment.motion.begin_at(start)?;
        cell.free_target = Some(FreeTarget::new(Arc::clone(&motion)));
        Ok(motion)
    })?;
    let clock = Arc::clone(&parts.clock);
    let cell = parts.cell.clone();
    let Vision { mut capturing, estimating } =
        Vision::new(setup, (parts.camera, parts.cell, parts.marking), &parts.clock)?;
    let moving = Moving::new(setup, (parts.vs, parts.tc), &*parts.experiment, clock.now())?;
    let mut vision_watcher =
        VisionWatcher { estimating, cell: cell.clone(), disturbance, clock: Arc::clone(&clock), begin: clock.now() };
    let mut disturbed = Disturbed {
        inner: moving,
        disturbance,
        clock: Arc::clone(&clock),
        cell,
        ends: world.arms.into_iter().map(|arm| arm.end).collect(),
        begin: clock.now(),
        sampled: clock.now(),
        progress: Progress::Before,
        waiting: VecDeque::new(),
        ran: Ran::default(),
    };
    let interrupt = AtomicBool::new(false);
    let duration = Duration::from_secs_f64(for_s);
    let run_context = RunContext { setup, clock: &clock, duration, interrupt: &interrupt };
    let ended = run_context
        .run_in_lockstep((&mut capturing, &mut vision_watcher, &mut ()), &mut disturbed)
        .err()
        .map(|error| format!("{error:#}"));
    disturbed.sample();
    Ok(Ran { ended, ..disturbed.ran })
}

impl Ran {
    /// Largest distance between the hands of two runs from a time on, mm, and the time from which on it stays within `within_mm`, seconds
    /// after `from_s`; infinite if it does not.
    pub fn beside(&self, other: &Self, (from_s, within_mm): (f64, f64)) -> (f64, f64) {
        let pairs = self.places.iter().zip(&other.places).filter(|(place, _)| place.t_s >= from_s);
        let (mut most_mm, mut outside_s) = (0.0_f64, from_s);
        let mut last_s = from_s;
        for (own, other) in pairs {
            let apart_mm = (own.hand_mm - other.hand_mm).norm();
            most_mm = most_mm.max(apart_mm);
            last_s = own.t_s;
            if apart_mm > within_mm {
                outside_s = own.t_s;
            }
        }
        let back_s = if outside_s >= last_s { f64::INFINITY } else { outside_s - from_s };
        (most_mm, back_s)
    }

    /// First time at or after `from_s` at which the supervisor does not permit motion, seconds.
    pub fn held_at(&self, from_s: f64) -> Option<&Decided> {
        self.decided.iter().find(|step| step.t_s >= from_s && !matches!(step.permission, Permission::Move { .. }))
    }
}

/// The vision half, without pairs while the camera stands still.
struct VisionWatcher<'a> {
    estimating: Estimating<'a>,
    cell: SimulatedCell,
    disturbance: Disturbance,
    clock: Arc<dyn Clock>,
    begin: MonotonicTime,
}

impl Estimate<StepRecord> for VisionWatcher<'_> {
    type Observed = PairEstimate;

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.cell.begin_at(begin);
        self.begin = begin;
    }

    fn moved(&mut self, step: &StepRecord) {
        self.estimating.moved(step);
    }

    fn look(&mut self, frame: Captured) -> Result<(Option<Percept>, PairEstimate)> {
        let pair_estimate = self.estimating.look(frame)?;
        let t_s = self.clock.now().seconds_since(self.begin);
        Ok(((!self.disturbance.stops(Part::Camera, t_s)).then(|| pair_estimate.percept()), pair_estimate))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Before,
    Within,
    Over,
}

/// The motion half with its stall, and the record of what is true.
struct Disturbed<'a> {
    inner: Moving<'a>,
    disturbance: Disturbance,
    clock: Arc<dyn Clock>,
    cell: SimulatedCell,
    ends: Vec<VirtualEnd>,
    begin: MonotonicTime,
    sampled: MonotonicTime,
    progress: Progress,
    /// Percepts that have not arrived, and when they do.
    waiting: VecDeque<(MonotonicTime, Percept)>,
    ran: Ran,
}

impl Mover for Disturbed<'_> {
    type Step = StepRecord;

    fn enable(&mut self) -> Result<bool> {
        self.inner.enable()
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        (self.begin, self.sampled) = (begin, begin);
        self.inner.begin_at(begin);
    }

    fn observe(&mut self, percept: Percept, now: MonotonicTime) {
        match self.disturbance {
            Disturbance::Stall(stall) if stall.stops(Part::Estimator, now.seconds_since(self.begin)) => {
                // The estimator leaves older pairs out.
                self.waiting.clear();
                self.waiting.push_back((self.begin + Duration::from_secs_f64(stall.until_s()), percept));
            }
            Disturbance::LateImages(by_s) => {
                let by = Duration::from_secs_f64(by_s);
                self.waiting.push_back((now + by, stamped_later(percept, by)));
            }
            _ => self.inner.observe(percept, now),
        }
    }

    fn step(&mut self, now: MonotonicTime) -> Result<StepRecord> {
        self.disturb(now)?;
        while self.waiting.front().is_some_and(|(due, _)| *due <= now)
            && let Some((_, percept)) = self.waiting.pop_front()
        {
            self.inner.observe(percept, now);
        }
        let moved = self.inner.step(self.clock.now())?;
        self.sample();
        let decision = moved.decision;
        let t_s = now.seconds_since(self.begin);
        let step = Decided { t_s, state: decision.state, permission: decision.permission, why: decision.why };
        self.ran.decided.push(step);
        Ok(moved)
    }

    fn stop(&mut self) -> Result<()> {
        self.inner.stop()
    }
}

impl Disturbed<'_> {
    fn disturb(&mut self, now: MonotonicTime) -> Result<()> {
        let t_s = now.seconds_since(self.begin);
        let Disturbance::Stall(stall) = self.disturbance else { return Ok(()) };
        match self.progress {
            Progress::Before if t_s >= stall.from_s => self.progress = Progress::Within,
            Progress::Within if t_s >= stall.until_s() => self.progress = Progress::Over,
            _ => return Ok(()),
        }
        match (stall.part, self.progress) {
            (Part::Host, Progress::Within) => {
                self.clock.sleep_until(self.begin + Duration::from_secs_f64(stall.until_s()));
            }
            (Part::Link, progress) => {
                let switch = if progress == Progress::Within { "on" } else { "off" };
                self.ends[0].command_line(&format!("line silence {switch}"))?;
                self.ends[0].command_line(&format!("line deaf {switch}"))?;
            }
            _ => {}
        }
        Ok(())
    }

    /// Records the true places since the last ones.
    fn sample(&mut self) {
        let now = self.clock.now();
        while self.sampled <= now {
            let at = self.sampled;
            let hand_mm = self.cell.world_from_hand_at(at).translation_m() * 1e3;
            self.ran.places.push(TruePlace { t_s: at.seconds_since(self.begin), hand_mm });
            self.sampled = self.sampled + SAMPLED;
        }
    }
}

/// The same percept with later time stamps.
fn stamped_later(percept: Percept, by: Duration) -> Percept {
    let Percept { frame, estimate, observation, surface_from_model } = percept;
    Percept {
        frame: FrameInput { at: frame.at + by, ..frame },
        estimate: EstimateInput { at: estimate.at + by, ..estimate },
        observation: observation.map(|observation| TargetObservation { at: observation.at + by, ..observation }),
        surface_from_model,
    }
}
