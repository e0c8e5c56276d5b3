//! Records the true motion: joints from the simulated plants, latches from gateways and drivers, and log lines.

mod hosts;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_arm_pa10::driver::Latched;
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_arm_pa10_gateway::gateway::Gateway;
use pb3dp_arm_pa10_protocol::gateway_protocol::GatewayState;
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_cell::moving::StepRecord;
use pb3dp_cell::percept::Percept;
use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Condition, Confidence, Event, OperatorCommand, State};
use pb3dp_sim::joint_dynamics::{AxisMode, JointPlant};
use system_tests::safety::truth::{ARM_NAMES, ArmTruth, HAND_ARM, Joints, LogLine, Placement, Step, TARGET_ARM, Truth};
use system_tests::safety::who_may_move::{Command, Moment, Pair, WhoMayMove};

use self::hosts::permission_of;
use crate::faults::{Fault, Kind};
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

/// Largest uncertainty of a usable pose: root of the summed variances of position and orientation, metres and radians.
const SURE_M: f64 = 0.020;
const SURE_RAD: f64 = 6.0 * std::f64::consts::PI / 180.0;
/// Largest difference between the exposures of both cameras, seconds.
const TOGETHER_S: f64 = 0.005;

/// The state of one run in progress.
pub struct Recorder {
    /// The record.
    pub truth: Truth,
    scenario: Scenario,
    /// Time constants of the drives of both arms, seconds.
    lag_s: [f64; 2],
    cell: SimulatedCell,
    /// Far ends of the lines of both arms; an arm that is simulated in the process has none.
    ends: [Option<VirtualEnd>; 2],
    /// What the present host knows of these arms; nothing after it has died.
    monitors: [Option<ArmMonitor>; 2],
    begin: Option<MonotonicTime>,
    next: MonotonicTime,
    /// Last control step.
    stepped_at: MonotonicTime,
    /// By target: exposure time of the newest confident estimate of a new image that was delivered.
    exposed: BTreeMap<u64, MonotonicTime>,
    /// Number and exposure time of the newest delivered image.
    newest: Option<(u64, MonotonicTime)>,
    /// Images whose poses are worthless.
    spoiled: BTreeSet<u64>,
    /// Start and end of the scenario's faults, if they have occurred.
    began_at: Vec<Option<MonotonicTime>>,
    ended_at: Vec<Option<MonotonicTime>>,
    /// The last control step before each fault began.
    stepped_before: Vec<MonotonicTime>,
    /// When each arm was told to hold last.
    held_at: [Option<MonotonicTime>; 2],
    /// Which faults had an effect.
    touched: Vec<bool>,
    /// Which faults started while both arms were enabled and not yet stopped.
    could_stop: Vec<bool>,
    latched_since: [Option<MonotonicTime>; 2],
    was_latched: [bool; 2],
    /// Who may move, from the operator's commands and the conditions.
    permission: WhoMayMove,
    /// True time of the present control step, and the time that the clock of the control loop shows.
    step_begins: [MonotonicTime; 2],
    /// Since when the drives of each arm are disabled.
    disabled_since: [Option<MonotonicTime>; 2],
    /// When both arms were stopped for good: by the operator, by a silence, or by a control step that failed.
    stopped_at: Option<MonotonicTime>,
    has_failed: bool,
    /// The last reset of the operator that cleared a latch.
    reset_at: MonotonicTime,
    /// Resets before the present host began.
    resets_before: u32,
    /// From the death of a host to the first control step of the next one, seconds.
    pub absent_s: Option<(f64, f64)>,
    /// Times of the operator's resets, seconds.
    pub resets_s: Vec<f64>,
    /// Last sign of life of the operator, on the clock of the control loop.
    heartbeat_at: Option<MonotonicTime>,
    /// State of the supervisor: for the status line, and to excuse a fault that came after a stop.
    state: State,
    says_why: bool,
    /// From this time on the control loop moves no arm.
    ends_at: Option<MonotonicTime>,
    found: [bool; Condition::COUNT],
    /// Error counters of links and gateways at the last check; grows with each detected error.
    counted: u64,
    /// And when a fault began before the control loop.
    counted_before: Option<u64>,
    /// Times at which a fault was noticed, seconds.
    pub noticed_s: Vec<f64>,
    /// A fault while the arms were being enabled was noticed: it was refused, or an error counter rose.
    pub noticed_enabling: bool,
    /// Commands and conditions, for the trace of a run.
    pub notes: Vec<LogLine>,
}

impl Recorder {
    /// An empty record.
    pub fn new(
        scenario: Scenario,
        cell: SimulatedCell,
        (monitors, ends): ([Option<ArmMonitor>; 2], [Option<VirtualEnd>; 2]),
    ) -> Self {
        Self {
            truth: Truth::default(),
            lag_s: scenario.workcell.rules().arms.map(|arm| arm.lag_s),
            cell,
            ends,
            monitors,
            begin: None,
            next: MonotonicTime::ZERO,
            stepped_at: MonotonicTime::ZERO,
            exposed: BTreeMap::new(),
            newest: None,
            spoiled: BTreeSet::new(),
            began_at: vec![None; scenario.faults.len()],
            ended_at: vec![None; scenario.faults.len()],
            stepped_before: vec![MonotonicTime::ZERO; scenario.faults.len()],
            held_at: [None; 2],
            touched: vec![false; scenario.faults.len()],
            could_stop: vec![false; scenario.faults.len()],
            latched_since: [None; 2],
            was_latched: [false; 2],
            permission: permission_of(&scenario),
            step_begins: [MonotonicTime::ZERO; 2],
            disabled_since: [None; 2],
            stopped_at: None,
            has_failed: false,
            reset_at: MonotonicTime::ZERO,
            resets_before: 0,
            absent_s: None,
            resets_s: Vec::new(),
            heartbeat_at: None,
            state: State::Idle,
            says_why: true,
            ends_at: None,
            found: [false; Condition::COUNT],
            counted: 0,
            counted_before: None,
            noticed_s: Vec::new(),
            noticed_enabling: false,
            notes: Vec::new(),
            scenario,
        }
    }

    /// Control steps begin now.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        (self.begin, self.next, self.stepped_at) = (Some(begin), begin, begin);
        let counted = self.count();
        self.noticed_enabling |= self.counted_before.is_some_and(|before| before != counted);
        self.counted = counted;
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
        let may_be_logged =
            self.latched_since.iter().all(Option::is_none) && !self.permission.is_latched() && !self.state.is_latched();
        // Only a moving arm misses the next command at once.
        let misses = !matches!(self.scenario.faults[index].kind, Kind::Overrun(_)) || self.state.is_moving();
        // Nobody knows the alarms of format A (docs/safety.md).
        let kind = &self.scenario.faults[index].kind;
        let is_known = self.scenario.workcell.settings.wire_format == "B" || !kind.is_alarm();
        self.could_stop[index] = may_be_logged && misses && is_known && is_on(HAND_ARM) && is_on(TARGET_ARM);
        if self.begin.is_none() {
            self.counted_before = Some(self.count());
        }
        self.began_at[index] = Some(now);
        self.stepped_before[index] = self.stepped_at;
    }

    /// This fault of the scenario has ended.
    pub fn ceased(&mut self, index: usize, now: MonotonicTime) {
        self.ended_at[index] = Some(now);
    }

    /// True joint angles of both arms, radians.
    pub fn joints_rad(&self, at: MonotonicTime) -> [Joints; 2] {
        [HAND_ARM, TARGET_ARM].map(|arm| self.truth_of(arm, at).position_rad)
    }

    /// The true state of an arm.
    fn truth_of(&self, arm: usize, at: MonotonicTime) -> ArmTruth {
        let site = [&self.cell.vs, &self.cell.tc][arm];
        let plant = site.joints.simulated().map(|plant| plant.lock().unwrap_or_else(PoisonError::into_inner));
        plant.map_or(ArmTruth::resting_at([f64::NAN; 7]), |plant| joints(plant, at))
    }

    /// The joints of this arm that a fault moves or blocks, and those that do not obey: a joint that was driven away needs time to
    /// come to rest.
    fn disobedience(&self, arm: usize, at: MonotonicTime) -> [[bool; 7]; 2] {
        /// Time constants of a drive after which less than 0.3 % of a difference is left.
        const LAGS: f64 = 6.0;
        let back_s = LAGS * self.lag_s[arm];
        let times = self.began_at.iter().zip(&self.ended_at);
        let mut joints = [[false; 7]; 2];
        for (fault, (began, ended)) in self.scenario.faults.iter().zip(times) {
            let Some((_, joint)) = fault.kind.disobeys().filter(|(of, _)| *of == arm) else { continue };
            let since_s = ended.map_or(-1.0, |ended| at.seconds_since(ended));
            if began.is_some_and(|began| began <= at) && since_s < back_s {
                joints[0][joint] |= since_s < 0.0;
                joints[1][joint] = true;
            }
        }
        joints
    }

    /// Whether controller or gateway stop this arm, and the program may not know yet.
    fn stops_by_itself(&self, arm: usize, at: MonotonicTime) -> bool {
        let stops = |(fault, began): (&Fault, &Option<MonotonicTime>)| {
            let is_about = fault.kind.arm().is_none_or(|about| about == arm);
            let since_s = began.filter(|began| *began <= at).map(|began| at.seconds_since(began));
            is_about
                && fault
                    .kind
                    .stops_beyond_the_host_s()
                    .zip(since_s)
                    .is_some_and(|(within_s, since_s)| since_s <= within_s)
        };
        self.scenario.faults.iter().zip(&self.began_at).any(stops)
    }

    /// Whether commands to this arm may be lost or late.
    fn are_commands_disturbed(&self, arm: usize, at: MonotonicTime) -> bool {
        /// As long as the most messages of a fault (50 on the bus), and a window of the acceleration, seconds.
        const AFTER_S: f64 = 0.6;
        let times = self.began_at.iter().zip(&self.ended_at);
        self.scenario.faults.iter().zip(times).any(|(fault, (began, ended))| {
            let is_over = ended.is_some_and(|ended| at.seconds_since(ended) > AFTER_S);
            fault.kind.disturbs_commands_to(arm) && began.is_some_and(|began| began <= at) && !is_over
        })
    }

    /// Time since the last command that could reach the gateway of this arm, seconds.
    fn command_age_s(&self, arm: usize, at: MonotonicTime) -> f64 {
        let times = self.began_at.iter().zip(&self.ended_at).zip(&self.stepped_before);
        let kept_since = self.scenario.faults.iter().zip(times).filter_map(|(fault, ((began, ended), before))| {
            let is_on = began.is_some_and(|began| began <= at) && ended.is_none_or(|ended| ended > at);
            // The command of the step in which the fault begins does not arrive.
            (is_on && fault.kind.keeps_commands_from() == Some(arm)).then_some(*before)
        });
        kept_since.chain([self.stepped_at]).map(|since| at.seconds_since(since)).fold(0.0, f64::max)
    }

    /// Seconds since the run began; before it they are negative.
    fn seconds(&self, at: MonotonicTime) -> f64 {
        let begin = self.begin.unwrap_or(MonotonicTime::ZERO);
        if at >= begin { at.seconds_since(begin) } else { -begin.seconds_since(at) }
    }

    /// Delivers an estimate to the control loop. It counts if it is confident, of an image that is newer than all before
    /// by number and time, with synchronous exposures, of the started target, and with a small enough uncertainty.
    pub fn delivered(&mut self, percept: &Percept) {
        let Percept { frame, estimate, .. } = percept;
        let is_newest = self.newest.is_none_or(|(number, at)| frame.sequence > number && frame.at > at);
        if is_newest {
            self.newest = Some((frame.sequence, frame.at));
        }
        let sigma = |first: usize| {
            let variance =
                |covariance: nalgebra::Matrix6<f64>| (0..3).map(|i| covariance[(first + i, first + i)]).sum();
            estimate.covariance.map_or(0.0, |covariance| f64::sqrt(variance(covariance)))
        };
        self.permission.saw(Pair {
            number: frame.sequence,
            exposed_s: self.seconds(frame.at),
            skew_s: frame.skew_s,
            target: estimate.target,
            has_pose: estimate.confidence != Confidence::NoPose,
            is_confident: estimate.confidence == Confidence::Sure,
            sigma: [sigma(0), sigma(3)],
        });
        let is_sure = sigma(0) <= SURE_M && sigma(3) <= SURE_RAD && frame.skew_s.abs() <= TOGETHER_S;
        let is_right = !self.spoiled.contains(&frame.sequence);
        if estimate.confidence == Confidence::Sure && is_newest && is_sure && is_right {
            let exposed = self.exposed.entry(estimate.target).or_insert(frame.at);
            *exposed = frame.at.max(*exposed);
        }
    }

    /// A control step begins, due at `due`, for which the clock of the control loop shows another time.
    pub fn stepping(&mut self, [due, shown]: [MonotonicTime; 2], now: MonotonicTime) {
        self.catch_up(now);
        self.step_begins = [due, shown];
    }

    /// Records a control step. Of the decision only a refusal, the report of a stall and the status line count.
    pub fn moved(&mut self, step: &StepRecord, now: MonotonicTime) {
        let decision = &step.decision;
        if decision.refused.is_some() {
            self.permission.refused();
        }
        if let Some(transition) = decision.transition {
            self.permission.reported(transition.event == Event::StallFound);
        }
        let [true_at, shown_at] = self.step_begins;
        // In format A the state of the drives is not public: only the guard notices that a joint does not follow (docs/safety.md).
        let is_known = self.scenario.workcell.settings.wire_format == "B";
        let disabled_since = self.disabled_since.into_iter().flatten().min().filter(|_| is_known);
        let was_latched = self.permission.is_latched();
        self.permission.stepped(&Moment {
            now_s: self.seconds(shown_at),
            true_s: self.seconds(true_at),
            heartbeat_s: self.heartbeat_at.map(|heartbeat| self.seconds(heartbeat)),
            disabled_s: disabled_since.map_or(0.0, |since| true_at.seconds_since(since)),
        });
        if was_latched && !self.permission.is_latched() {
            (self.reset_at, self.stopped_at) = (now, None);
        } else if self.permission.is_latched() && !was_latched {
            self.stopped_at.get_or_insert(now);
        }
        if decision.transition.is_some() {
            self.says_why = !decision.why.to_string().is_empty();
        }
        self.state = decision.state;
        for condition in Condition::ALL {
            let is_found = decision.found.contains(condition);
            if is_found && !self.found[condition as usize] {
                self.note(now, format!("condition: {}", condition.key()));
            }
            self.found[condition as usize] = is_found;
        }
        for (held_at, arm) in self.held_at.iter_mut().zip(&step.arms) {
            *held_at = if arm.requested_rad_per_s.is_none() { Some(now) } else { *held_at };
        }
        self.catch_up(now);
        self.stepped_at = now;
    }

    /// The operator is present, at this time by the clock of the control loop.
    pub fn heartbeat(&mut self, shown: MonotonicTime) {
        self.heartbeat_at = Some(shown);
    }

    /// The operator's command, given at this time by the clock of the control loop, arrives now.
    pub fn commanded(&mut self, command: OperatorCommand, shown: MonotonicTime, now: MonotonicTime) {
        self.note(now, format!("operator command: {}", command.name()));
        self.permission.commanded(command_of(command), self.seconds(shown));
        if command == OperatorCommand::Reset {
            self.resets_s.push(self.t_s(now));
        }
    }

    /// The operator reads that a reset has failed.
    pub fn reset_failed(&mut self) {
        self.permission.refused();
    }

    /// The program says that the arms hold from now on.
    pub fn holds(&mut self, now: MonotonicTime) {
        self.held_at = [Some(now); 2];
    }

    /// A control step has failed: both arms are stopped for good.
    pub fn failed(&mut self, why: &anyhow::Error, now: MonotonicTime) {
        self.note(now, format!("{why:#}"));
        self.permission.latched();
        (self.has_failed, self.stopped_at) = (true, Some(now));
    }

    /// Adds a line to the trace, and counts it as noticed.
    pub fn note(&mut self, at: MonotonicTime, text: String) {
        let t_s = self.t_s(at).max(0.0);
        self.noticed_s.push(t_s);
        self.notes.push(LogLine { t_millis: (t_s * 1e3) as u64, text });
    }

    /// Number of errors that links and gateways have counted.
    fn count(&self) -> u64 {
        let of_arm = |(end, monitor): (&Option<VirtualEnd>, &Option<ArmMonitor>)| {
            let snapshot = monitor.as_ref().map(ArmMonitor::snapshot);
            let bus = end.as_ref().and_then(|end| end.look(|far| far.gateway.as_ref().map(Gateway::status)));
            let of_bus = bus.map_or(0, |status| {
                let bus = status.bus;
                status.host_lost + status.host_stale + bus.lost + bus.late + bus.mismatched
            });
            let of_link = snapshot.map_or(0, |snapshot| {
                let (link, line) = (&snapshot.counters, &snapshot.line);
                let of_line = line.crc_errors + line.header_errors + line.resyncs;
                link.lost + link.late + link.damaged + link.mismatched + of_line
            });
            of_bus + of_link
        };
        self.ends.iter().zip(&self.monitors).map(of_arm).sum()
    }

    /// Records everything up to now.
    pub fn catch_up(&mut self, now: MonotonicTime) {
        // What came before a latch is recorded without it.
        let latches =
            (0..2).filter(|arm| self.latched_since[*arm].is_none()).filter_map(|arm| self.latched_at(arm, now));
        if let Some(first) = latches.min() {
            self.record_before(first);
        }
        self.look_for_latches(now);
        let counted = self.count();
        if counted != self.counted {
            self.noticed_s.push(self.t_s(now));
            self.counted = counted;
        }
        self.record_before(now + Duration::from_nanos(1));
    }

    fn record_before(&mut self, end: MonotonicTime) {
        while self.begin.is_some() && self.next < end {
            let at = self.next;
            let step = self.step_at(at);
            self.truth.steps.push(step);
            self.next = at + Duration::from_nanos(STEP_NANOS);
        }
    }

    /// Time since which this arm is latched, wherever it latched first; none if it is not.
    fn latched_at(&self, arm: usize, now: MonotonicTime) -> Option<MonotonicTime> {
        let state = |end: &VirtualEnd| end.look(|far| far.gateway.as_ref().map(|gateway| gateway.status().state));
        let gateway = self.ends[arm].as_ref().and_then(state);
        let by_gateway = matches!(gateway, Some(GatewayState::Fault | GatewayState::EmergencyStop));
        let by_driver = self.latched_in_driver(arm).map(|latched| latched.at);
        let by_fault = self.stopped_by_fault(arm, now);
        [by_driver, by_gateway.then_some(now), self.stopped_at, by_fault].into_iter().flatten().min()
    }

    fn latched_in_driver(&self, arm: usize) -> Option<Latched> {
        self.monitors[arm].as_ref().and_then(|monitor| monitor.snapshot().latched)
    }

    fn look_for_latches(&mut self, now: MonotonicTime) {
        for (arm, name) in ARM_NAMES.into_iter().enumerate() {
            let latched = self.latched_in_driver(arm);
            let since = self.latched_at(arm, now);
            if self.latched_since[arm].is_none() && since.is_some() {
                self.permission.latched();
            }
            self.latched_since[arm] = since.map(|since| self.latched_since[arm].unwrap_or(since));
            self.was_latched[arm] = match latched {
                Some(latched) if !self.was_latched[arm] => {
                    self.note(latched.at, format!("{name}: {}", latched.trip));
                    true
                }
                latched => latched.is_some(),
            };
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

    /// Exposure of the newest pose of the started target.
    fn exposed_at(&self) -> Option<MonotonicTime> {
        self.permission.started().and_then(|target| self.exposed.get(&target).copied())
    }

    fn step_at(&mut self, at: MonotonicTime) -> Step {
        let (t_s, true_s) = (self.t_s(at), self.seconds(at));
        let is_over = self.has_failed || self.ends_at.is_some_and(|ends_at| at >= ends_at);
        let may_go = [self.permission.hand_may_go(), self.permission.target_may_go()].map(|may_go| may_go && !is_over);
        let arm = |index: usize| {
            let [by_itself, disobeys] = self.disobedience(index, at);
            ArmTruth {
                latched_since_s: self.latched_since[index].filter(|since| *since <= at).map(|since| self.t_s(since)),
                by_itself,
                disobeys,
                may_go: may_go[index],
                command_age_s: self.command_age_s(index, at),
                // From the largest speed of a joint, 1.2 rad/s at 2 rad/s^2 (3.77 at 5), to standstill, and the delay of the arm.
                // An arm without a line stops as soon as it may not move.
                ramps: self.held_at[index].is_some_and(|held| at.seconds_since(held) < 0.8)
                    || (!may_go[index] && self.ends[index].is_none()),
                stops_by_itself: self.stops_by_itself(index, at),
                commands_disturbed: self.are_commands_disturbed(index, at),
                ..self.truth_of(index, at)
            }
        };
        let step = Step {
            t_s,
            arms: [arm(HAND_ARM), arm(TARGET_ARM)],
            world_from_target: placement(&self.cell, at),
            pose_age_s: self.exposed_at().map_or(f64::INFINITY, |exposed| at.seconds_since(exposed)),
            may_search: self.permission.may_search(true_s) && !is_over,
            is_inhibited: self.permission.is_hand_inhibited(true_s),
            content_late_s: self.content_late_s(at),
            resets: self.resets_before + self.permission.resets(),
            state: self.state.name(),
            says_why: self.says_why,
        };
        for (since, arm) in self.disabled_since.iter_mut().zip(&step.arms) {
            *since = arm.brakes_closed.then(|| since.unwrap_or(at));
        }
        step
    }
}

/// The command as the model knows it.
fn command_of(command: OperatorCommand) -> Command {
    match command {
        OperatorCommand::Select => Command::Select,
        OperatorCommand::Start => Command::Start,
        OperatorCommand::Hold => Command::Hold,
        OperatorCommand::HoldHand => Command::HoldHand,
        OperatorCommand::Resume => Command::Resume,
        OperatorCommand::Realign => Command::Realign,
        OperatorCommand::Stop => Command::Stop,
        OperatorCommand::Reset => Command::Reset,
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
    let driven = modes.map(|mode| matches!(mode, AxisMode::Servo | AxisMode::Driven { .. }));
    ArmTruth {
        velocity_rad_per_s,
        servo_on: driven == [true; 7],
        driven,
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
