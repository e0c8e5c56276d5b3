//! Records the true motion: joints from the simulated plants, latches from gateways and drivers, and log lines.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_arm_pa10_gateway::gateway::Gateway;
use pb3dp_arm_pa10_protocol::gateway_protocol::GatewayState;
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_cell::moving::Moved;
use pb3dp_cell::percept::Percept;
use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Condition, Confidence, Event, OperatorCommand, State, Transition};
use pb3dp_sim::joint_dynamics::{AxisMode, JointPlant};
use system_tests::safety::truth::{ARM_NAMES, ArmTruth, HAND_ARM, Joints, LogLine, Placement, Step, TARGET_ARM, Truth};

use crate::faults::{Fault, Kind};
use crate::rig::SEARCH_MAX_S;
use crate::scenario::Scenario;
use crate::telling::Happened;

/// Time between two samples of the record: a fifth of the control cycle; costs 8 % more CPU than one sample per cycle.
const STEP_NANOS: u64 = 2_000_000;

/// Shared by the threads of a run.
pub type Shared = Arc<Mutex<Recorder>>;

/// Locks the recorder.
pub fn lock(recorder: &Shared) -> MutexGuard<'_, Recorder> {
    recorder.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A command older than this has no effect, seconds: `word_age_max_s`, and a cycle.
const WORD_AGE_S: f64 = 0.51;
/// Without an operator heartbeat for longer than this both arms must hold, seconds: `operator_silent`, and a cycle.
const SILENCE_S: f64 = 1.01;
/// Largest uncertainty of a usable pose: root of the summed variances of position and orientation, metres and radians.
const SURE_M: f64 = 0.020;
const SURE_RAD: f64 = 6.0 * std::f64::consts::PI / 180.0;
/// A search that exceeds its time ends within one control cycle, seconds.
const SEARCH_END_S: f64 = 0.02;
/// Conditions that only a person can judge: after each the hand waits for a command, whatever the supervisor does. They
/// are listed here again, because a supervisor that resumes by itself would otherwise permit itself to do so.
/// `crates/servo/tests/supervisor/starting.rs` and `conditions.rs` check one by one that the hand waits after each of
/// them, and after a second one during a hold: eight of those tests fail without `!self.needs_word` in
/// `Supervisor::by_itself`.
const FOR_PERSONS: [Condition; 6] = [
    Condition::EmergencyStop,
    Condition::ArmFault,
    Condition::ArmDisabled,
    Condition::ClockStepped,
    Condition::OperatorSilent,
    Condition::TargetChanged,
];
/// After each of these the arm with the target waits for a command too.
const HOLD_BOTH: [Condition; 3] = [Condition::ArmDisabled, Condition::ClockStepped, Condition::OperatorSilent];
/// Largest difference between the exposures of both cameras, seconds.
const TOGETHER_S: f64 = 0.005;

/// The state of one run in progress.
pub struct Recorder {
    /// The record.
    pub truth: Truth,
    scenario: Scenario,
    cell: SimulatedCell,
    arms: [(ArmMonitor, VirtualEnd); 2],
    begin: Option<MonotonicTime>,
    next: MonotonicTime,
    /// Last control step.
    stepped_at: MonotonicTime,
    /// By target: exposure time of the newest confident estimate of a new image that was delivered.
    exposed: BTreeMap<u64, MonotonicTime>,
    /// Number and exposure time of the newest delivered image.
    newest: Option<(u64, MonotonicTime)>,
    /// The followed target and the time since when, from the delivered estimates.
    followed: Vec<(MonotonicTime, u64)>,
    /// The target that was followed when the operator gave `start`.
    target: Option<u64>,
    /// Images whose poses are worthless.
    spoiled: BTreeSet<u64>,
    /// Start and end of the scenario's faults, if they have occurred.
    began_at: Vec<Option<MonotonicTime>>,
    ended_at: Vec<Option<MonotonicTime>>,
    /// Which faults had an effect.
    touched: Vec<bool>,
    /// Which faults started while both arms were enabled and not yet stopped.
    could_stop: Vec<bool>,
    latched_since: [Option<MonotonicTime>; 2],
    was_latched: [bool; 2],
    state: State,
    stopped_at: Option<MonotonicTime>,
    /// Last reset by the operator, number of resets, and last sign of the operator.
    reset_at: MonotonicTime,
    resets: u32,
    /// Times of the operator's resets, seconds.
    pub resets_s: Vec<f64>,
    heard_at: Option<MonotonicTime>,
    /// Time of the operator's last start or resume; commands given before `not_before` have no effect.
    go_at: Option<MonotonicTime>,
    not_before: MonotonicTime,
    /// The operator gave `hold`, and no `resume` since.
    was_told_to_rest: bool,
    /// A condition that only a person can judge was detected during this hold.
    waits_for_person: bool,
    /// Time since which the supervisor reports the target as lost.
    lost_at: Option<MonotonicTime>,
    says_why: bool,
    may_go: [bool; 2],
    found: [bool; Condition::COUNT],
    /// Error counters of links and gateways at the last check; grows with each detected error.
    counted: u64,
    /// Times at which a fault was noticed, seconds.
    pub noticed_s: Vec<f64>,
}

impl Recorder {
    /// An empty record.
    pub fn new(scenario: Scenario, cell: SimulatedCell, arms: [(ArmMonitor, VirtualEnd); 2]) -> Self {
        Self {
            truth: Truth::default(),
            cell,
            arms,
            begin: None,
            next: MonotonicTime::ZERO,
            stepped_at: MonotonicTime::ZERO,
            exposed: BTreeMap::new(),
            newest: None,
            followed: Vec::new(),
            target: None,
            spoiled: BTreeSet::new(),
            began_at: vec![None; scenario.faults.len()],
            ended_at: vec![None; scenario.faults.len()],
            touched: vec![false; scenario.faults.len()],
            could_stop: vec![false; scenario.faults.len()],
            latched_since: [None; 2],
            was_latched: [false; 2],
            state: State::Idle,
            stopped_at: None,
            reset_at: MonotonicTime::ZERO,
            resets: 0,
            resets_s: Vec::new(),
            heard_at: None,
            go_at: None,
            not_before: MonotonicTime::ZERO,
            was_told_to_rest: false,
            waits_for_person: false,
            lost_at: None,
            says_why: true,
            may_go: [false; 2],
            found: [false; Condition::COUNT],
            counted: 0,
            noticed_s: Vec::new(),
            scenario,
        }
    }

    /// Control steps begin now.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        (self.begin, self.next, self.stepped_at) = (Some(begin), begin, begin);
        self.may_go[TARGET_ARM] = !self.scenario.has_person;
        self.counted = self.count();
    }

    /// Seconds since the run began.
    pub fn t_s(&self, at: MonotonicTime) -> f64 {
        self.begin.map_or(0.0, |begin| at.seconds_since(begin))
    }

    /// Actual start and end of each fault of the scenario.
    pub fn times(&self) -> Vec<Happened> {
        let seconds = |at: Option<MonotonicTime>| at.map(|at| self.t_s(at));
        let times = self.began_at.iter().zip(&self.ended_at).zip(&self.could_stop);
        times
            .map(|((began, ended), &could_stop)| Happened {
                from_s: seconds(*began),
                until_s: seconds(*ended),
                could_stop,
            })
            .collect()
    }

    /// This fault of the scenario had an effect.
    pub fn touched(&mut self, index: usize) {
        self.touched[index] = true;
    }

    /// Whether this fault had an effect.
    pub fn was_touched(&self, index: usize) -> bool {
        self.touched[index]
    }

    /// The pose of this image is worthless, but nothing indicates that.
    pub fn spoiled(&mut self, sequence: u64) {
        self.spoiled.insert(sequence);
    }

    /// This fault of the scenario has begun.
    pub fn began(&mut self, index: usize, now: MonotonicTime) {
        let about = self.scenario.faults[index].kind.arm();
        let is_on = |arm: usize| about.is_some_and(|about| about != arm) || self.truth_of(arm, now).servo_on;
        let may_be_told = self.latched_since.iter().all(Option::is_none) && !self.state.is_latched();
        // Only a moving arm misses the next command at once.
        let misses = !matches!(self.scenario.faults[index].kind, Kind::Overrun(_)) || self.state.is_moving();
        self.could_stop[index] = may_be_told && misses && is_on(HAND_ARM) && is_on(TARGET_ARM);
        self.began_at[index] = Some(now);
    }

    /// This fault of the scenario has ended.
    pub fn ceased(&mut self, index: usize, now: MonotonicTime) {
        self.ended_at[index] = Some(now);
    }

    /// The true state of an arm.
    fn truth_of(&self, arm: usize, at: MonotonicTime) -> ArmTruth {
        let site = [&self.cell.vs, &self.cell.tc][arm];
        let plant = site.joints.simulated().map(|plant| plant.lock().unwrap_or_else(PoisonError::into_inner));
        plant.map_or(ArmTruth::resting_at([f64::NAN; 7]), |plant| joints(plant, at))
    }

    /// The joint of this arm that does not obey, and whether that lasts: a joint that was driven away needs time to come
    /// to rest.
    fn by_itself(&self, arm: usize, at: MonotonicTime) -> Option<(usize, bool)> {
        const BACK_S: f64 = 0.1;
        let times = self.began_at.iter().zip(&self.ended_at);
        self.scenario.faults.iter().zip(times).find_map(|(fault, (began, ended))| {
            let (of, joint) = fault.kind.disobeys()?;
            let since_s = ended.map_or(-1.0, |ended| at.seconds_since(ended));
            (of == arm && began.is_some_and(|began| began <= at) && since_s < BACK_S).then_some((joint, since_s < 0.0))
        })
    }

    /// Time since the last command that could reach the gateway of this arm, seconds.
    fn command_age_s(&self, arm: usize, at: MonotonicTime) -> f64 {
        let times = self.began_at.iter().zip(&self.ended_at);
        let kept_since = self.scenario.faults.iter().zip(times).filter_map(|(fault, (began, ended))| {
            let is_on = began.is_some_and(|began| began <= at) && ended.is_none_or(|ended| ended > at);
            began.filter(|_| is_on && fault.kind.keeps_commands_from() == Some(arm))
        });
        kept_since.chain([self.stepped_at]).map(|since| at.seconds_since(since)).fold(0.0, f64::max)
    }

    /// Delivers an estimate to the control loop. It counts if it is confident, of an image that is newer than all before
    /// by number and time, with synchronous exposures, of the started target, and with a small enough uncertainty.
    pub fn delivered(&mut self, percept: &Percept, now: MonotonicTime) {
        let Percept { frame, estimate, .. } = percept;
        let is_newest = self.newest.is_none_or(|(number, at)| frame.sequence > number && frame.at > at);
        if is_newest {
            self.newest = Some((frame.sequence, frame.at));
            let is_followed = self.followed.last().is_some_and(|(_, target)| *target == estimate.target);
            if estimate.confidence != Confidence::NoPose && !is_followed {
                self.followed.push((now, estimate.target));
            }
        }
        let sigma = |first: usize| {
            let variance =
                |covariance: nalgebra::Matrix6<f64>| (0..3).map(|i| covariance[(first + i, first + i)]).sum();
            estimate.covariance.map_or(0.0, |covariance| f64::sqrt(variance(covariance)))
        };
        let is_sure = sigma(0) <= SURE_M && sigma(3) <= SURE_RAD && frame.skew_s.abs() <= TOGETHER_S;
        let is_right = !self.spoiled.contains(&frame.sequence);
        if estimate.confidence == Confidence::Sure && is_newest && is_sure && is_right {
            let exposed = self.exposed.entry(estimate.target).or_insert(frame.at);
            *exposed = frame.at.max(*exposed);
        }
    }

    /// Records a control step.
    pub fn moved(&mut self, step: &Moved, now: MonotonicTime) {
        let decision = &step.decision;
        if let Some(transition) = decision.transition {
            let why = decision.why.to_string();
            self.says_why = !why.is_empty();
            self.say(now, format!("{} {}: {why}", transition.event.name(), transition.to.name()));
            self.follow(transition, now);
        }
        self.state = decision.state;
        let is_for_person = FOR_PERSONS.into_iter().any(|condition| decision.found.contains(condition));
        self.waits_for_person = self.state.is_resting() && (self.waits_for_person || is_for_person);
        self.may_go[HAND_ARM] &= !self.waits_for_person;
        let holds_both = HOLD_BOTH.into_iter().any(|condition| decision.found.contains(condition));
        self.may_go[TARGET_ARM] &= !(self.state.is_resting() && holds_both);
        if let Some(refusal) = decision.refused {
            self.say(now, refusal.to_string());
        }
        for condition in Condition::ALL {
            let is_found = decision.found.contains(condition);
            if is_found && !self.found[condition as usize] {
                self.say(now, format!("condition: {}", condition.key()));
            }
            self.found[condition as usize] = is_found;
        }
        self.catch_up(now);
        self.stepped_at = now;
    }

    /// Updates which arm may move after a change of state.
    fn follow(&mut self, transition: Transition, now: MonotonicTime) {
        self.lost_at = (transition.to == State::Lost).then_some(now);
        match transition.to {
            State::Approaching => {
                let by_word = matches!(transition.event, Event::Start | Event::Resume);
                if transition.event == Event::Start {
                    // A `start` means the target followed when it was given; the target may change before it arrives.
                    let said_at = self.go_at.filter(|_| self.scenario.has_person).unwrap_or(now);
                    let followed = self.followed.iter().rev().find(|(since, _)| *since <= said_at);
                    self.target = followed.map(|(_, target)| *target);
                }
                let go = self.go_at.filter(|at| *at >= self.not_before && now.seconds_since(*at) <= WORD_AGE_S);
                if by_word && (go.is_some() || !self.scenario.has_person) {
                    self.may_go = [true; 2];
                } else if !by_word && !self.was_told_to_rest && !self.waits_for_person {
                    self.may_go[HAND_ARM] = true;
                }
            }
            State::Stopped | State::Fault => self.must_rest(now, true),
            // Without an operator the arm with the target moves along its path from the beginning.
            State::Idle | State::Selecting => {
                self.target = None;
                self.must_rest(now, self.scenario.has_person);
            }
            State::Holding | State::Lost => self.not_before = now,
            State::Tracking => {}
        }
        if transition.event == Event::Reset {
            self.resets += 1;
            (self.reset_at, self.stopped_at) = (now, None);
        } else if transition.to.is_latched() && self.scenario.has_person {
            self.stopped_at.get_or_insert(now);
        }
    }

    fn must_rest(&mut self, now: MonotonicTime, both: bool) {
        self.not_before = now;
        self.may_go[HAND_ARM] = false;
        self.may_go[TARGET_ARM] &= !both;
    }

    /// The operator is present.
    pub fn heard(&mut self, at: MonotonicTime) {
        self.heard_at = Some(at);
    }

    /// The operator's command, which arrived now.
    pub fn told(&mut self, word: OperatorCommand, at: MonotonicTime, now: MonotonicTime) {
        self.say(now, format!("operator command: {}", word.name()));
        match word {
            OperatorCommand::Start | OperatorCommand::Resume => {
                self.go_at = Some(at);
                self.was_told_to_rest &= at < self.not_before;
            }
            OperatorCommand::Hold | OperatorCommand::HoldHand => {
                self.was_told_to_rest = true;
                self.must_rest(now, word == OperatorCommand::Hold);
            }
            OperatorCommand::Stop => self.must_rest(now, true),
            OperatorCommand::Select => {}
            OperatorCommand::Reset => self.resets_s.push(self.t_s(now)),
        }
    }

    /// A control step has failed: both arms are stopped for good.
    pub fn failed(&mut self, why: &anyhow::Error, now: MonotonicTime) {
        self.say(now, format!("{why:#}"));
        self.state = State::Stopped;
        self.stopped_at = Some(now);
        self.may_go = [false; 2];
    }

    /// The control loop has ended: both arms are stopped.
    pub fn ended(&mut self) {
        self.may_go = [false; 2];
    }

    /// Adds a line to the log.
    pub fn say(&mut self, at: MonotonicTime, text: String) {
        let t_s = self.t_s(at).max(0.0);
        self.noticed_s.push(t_s);
        self.truth.log.push(LogLine { t_millis: (t_s * 1e3) as u64, text });
    }

    /// Number of errors that links and gateways have counted.
    fn count(&self) -> u64 {
        let of_arm = |(monitor, end): &(ArmMonitor, VirtualEnd)| {
            let seen = monitor.snapshot();
            let (link, line) = (&seen.counters, &seen.line);
            let bus = end.look(|far| far.gateway.as_ref().map(Gateway::status));
            let of_bus = bus.map_or(0, |status| {
                let bus = status.bus;
                status.host_lost + status.host_stale + bus.lost + bus.late + bus.mismatched
            });
            let of_link = link.lost + link.late + link.damaged + link.mismatched;
            of_bus + of_link + line.crc_errors + line.header_errors + line.resyncs
        };
        self.arms.iter().map(of_arm).sum()
    }

    /// Records everything up to now.
    pub fn catch_up(&mut self, now: MonotonicTime) {
        self.look_for_latches(now);
        let counted = self.count();
        if counted > self.counted {
            self.noticed_s.push(self.t_s(now));
            self.counted = counted;
        }
        while self.begin.is_some() && self.next <= now {
            let at = self.next;
            let step = self.step_at(at);
            self.truth.steps.push(step);
            self.next = at + std::time::Duration::from_nanos(STEP_NANOS);
        }
    }

    fn look_for_latches(&mut self, now: MonotonicTime) {
        for (arm, name) in ARM_NAMES.into_iter().enumerate() {
            let (monitor, end) = &self.arms[arm];
            let seen = monitor.snapshot();
            let gateway = end.look(|far| far.gateway.as_ref().map(|gateway| gateway.status().state));
            let by_gateway = matches!(gateway, Some(GatewayState::Fault | GatewayState::EmergencyStop));
            let by_fault = self.stopped_by_fault(arm, now);
            let since = [seen.latched.map(|latched| latched.at), by_gateway.then_some(now), self.stopped_at, by_fault];
            let since = since.into_iter().flatten().min();
            self.latched_since[arm] = match (self.latched_since[arm], since) {
                (Some(before), Some(_)) => Some(before),
                (_, since) => since,
            };
            if let (Some(latched), false) = (seen.latched, self.was_latched[arm]) {
                self.say(latched.at, format!("{name}: {}", latched.trip));
            }
            self.was_latched[arm] = seen.latched.is_some();
        }
    }

    /// Time since which this arm must be latched because of a fault.
    fn stopped_by_fault(&self, arm: usize, now: MonotonicTime) -> Option<MonotonicTime> {
        let stops = |(index, fault): (usize, &Fault)| {
            let (lasts_s, within_s) = fault.kind.stops_after_s()?;
            let (began, ended) = (self.began_at[index].filter(|_| self.could_stop[index])?, self.ended_at[index]);
            let at = began + Duration::from_secs_f64(within_s);
            let is_about = fault.kind.arm().is_none_or(|about| about == arm);
            let lasts = ended.is_none_or(|ended| ended.seconds_since(began) >= lasts_s);
            (is_about && lasts && at <= now && at > self.reset_at).then_some(at)
        };
        self.scenario.faults.iter().enumerate().filter_map(stops).min()
    }

    /// Whether the operator has been silent for too long.
    fn is_alone(&self, at: MonotonicTime) -> bool {
        self.scenario.has_person && self.heard_at.is_none_or(|heard| at.seconds_since(heard) > SILENCE_S)
    }

    /// Exposure of the newest pose of the started target.
    fn exposed_at(&self) -> Option<MonotonicTime> {
        self.target.and_then(|target| self.exposed.get(&target).copied())
    }

    /// Whether the hand may search for the lost target.
    fn may_search(&self, at: MonotonicTime) -> bool {
        let is_early = self.lost_at.is_some_and(|lost| at.seconds_since(lost) <= SEARCH_MAX_S + SEARCH_END_S);
        self.scenario.searches && is_early && self.may_go[HAND_ARM] && !self.was_told_to_rest
    }

    fn step_at(&self, at: MonotonicTime) -> Step {
        let t_s = self.t_s(at);
        let arm = |index: usize| {
            let by_itself = self.by_itself(index, at);
            ArmTruth {
                latched_since_s: self.latched_since[index].filter(|since| *since <= at).map(|since| self.t_s(since)),
                obeys: by_itself.is_none(),
                by_itself: by_itself.filter(|(_, lasts)| *lasts).map(|(joint, _)| joint),
                may_go: self.may_go[index] && !self.is_alone(at),
                command_age_s: self.command_age_s(index, at),
                ..self.truth_of(index, at)
            }
        };
        Step {
            t_s,
            arms: [arm(HAND_ARM), arm(TARGET_ARM)],
            world_from_target: placement(&self.cell, at),
            pose_age_s: self.exposed_at().map_or(f64::INFINITY, |exposed| at.seconds_since(exposed)),
            may_search: self.may_search(at),
            resets: self.resets,
            state: self.state.name(),
            says_why: self.says_why,
        }
    }
}

/// Joints at a time within the history.
fn joints(mut plant: MutexGuard<'_, JointPlant>, at: MonotonicTime) -> ArmTruth {
    plant.advance_to(at);
    let (position_rad, velocity_rad_per_s) =
        plant.motion_at(at).map_or(([f64::NAN; 7], [f64::NAN; 7]), |(position, velocity)| {
            (Joints::from(position), Joints::from(velocity))
        });
    let modes = plant.modes();
    ArmTruth {
        velocity_rad_per_s,
        servo_on: modes.iter().all(|mode| matches!(mode, AxisMode::Servo | AxisMode::Driven { .. })),
        brakes_closed: modes.iter().all(|mode| *mode == AxisMode::Brake),
        ..ArmTruth::resting_at(position_rad)
    }
}

fn placement(cell: &SimulatedCell, at: MonotonicTime) -> Placement {
    let pose = cell.world_from_target_at(at);
    let rotation = pose.rotation().to_rotation_matrix();
    let translation = pose.translation_m();
    Placement {
        rotation: std::array::from_fn(|row| std::array::from_fn(|column| rotation[(row, column)])),
        translation_m: [translation.x, translation.y, translation.z],
    }
}
