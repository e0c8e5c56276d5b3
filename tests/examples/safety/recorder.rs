//! Writes down what truly happens: joints from the simulated plants, latches from gateways and drivers, and what is said.

use std::sync::{MutexGuard, PoisonError};

use pb3dp_arm_pa10::gateway::Gateway;
use pb3dp_arm_pa10::gateway_protocol::GatewayState;
use pb3dp_arm_pa10::io::arm::{ArmMonitor, VirtualEnd};
use pb3dp_geometry::MonotonicTime;
use pb3dp_orchestrator::run::cell::SimulatedCell;
use pb3dp_orchestrator::run::moving::Moved;
use pb3dp_servo::supervisor::{Condition, State};
use pb3dp_sim::joint_dynamics::{AxisMode, JointPlant};
use system_tests::safety::truth::{ARM_NAMES, ArmTruth, HAND_ARM, Joints, LogLine, Placement, Step, TARGET_ARM, Truth};

use crate::scenario::Scenario;

/// Time between two steps of the record.
const STEP_NANOS: u64 = 10_000_000;

/// What is known of one run while it goes on.
pub struct Recorder {
    /// What was written down.
    pub truth: Truth,
    scenario: Scenario,
    cell: SimulatedCell,
    arms: [(ArmMonitor, VirtualEnd); 2],
    begin: Option<MonotonicTime>,
    next: MonotonicTime,
    /// Exposure of the newest confident estimate of a new picture that was delivered.
    exposed: Option<MonotonicTime>,
    latched_since: [Option<MonotonicTime>; 2],
    was_latched: [bool; 2],
    state: State,
    stopped_at: Option<MonotonicTime>,
    says_why: bool,
    may_go: [bool; 2],
    found: [bool; Condition::COUNT],
    /// What the links and gateways counted, at the last look: grows with each harm that was noticed.
    counted: u64,
    /// When something was noticed, seconds.
    pub noticed_s: Vec<f64>,
}

impl Recorder {
    /// Nothing has happened yet.
    pub fn new(scenario: Scenario, cell: SimulatedCell, arms: [(ArmMonitor, VirtualEnd); 2]) -> Self {
        Self {
            truth: Truth::default(),
            scenario,
            cell,
            arms,
            begin: None,
            next: MonotonicTime::ZERO,
            exposed: None,
            latched_since: [None; 2],
            was_latched: [false; 2],
            state: State::Idle,
            stopped_at: None,
            says_why: true,
            may_go: [false; 2],
            found: [false; Condition::COUNT],
            counted: 0,
            noticed_s: Vec::new(),
        }
    }

    /// Control steps begin now.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        (self.begin, self.next) = (Some(begin), begin);
        self.may_go[TARGET_ARM] = true;
        self.counted = self.count();
    }

    /// Seconds since the run began.
    pub fn t_s(&self, at: MonotonicTime) -> f64 {
        self.begin.map_or(0.0, |begin| at.seconds_since(begin))
    }

    /// A confident estimate of a new picture comes to those who move.
    pub fn delivered(&mut self, exposed: MonotonicTime) {
        self.exposed = Some(self.exposed.map_or(exposed, |before| before.max(exposed)));
    }

    /// A control step was done.
    pub fn moved(&mut self, step: &Moved, now: MonotonicTime) {
        let decision = &step.decision;
        if let Some(transition) = decision.transition {
            let why = decision.why.to_string();
            self.says_why = !why.is_empty();
            self.say(now, format!("{} {}: {why}", transition.event.name(), transition.to.name()));
            match transition.to {
                State::Approaching => self.may_go[HAND_ARM] = true,
                State::Stopped | State::Fault | State::Idle | State::Selecting => self.may_go[HAND_ARM] = false,
                _ => {}
            }
        }
        self.state = decision.state;
        for condition in Condition::ALL {
            let is_found = decision.found.contains(condition);
            if is_found && !self.found[condition as usize] {
                self.say(now, format!("found: {}", condition.key()));
            }
            self.found[condition as usize] = is_found;
        }
        self.catch_up(now);
    }

    /// A control step has failed: both arms are stopped for good.
    pub fn failed(&mut self, why: &anyhow::Error, now: MonotonicTime) {
        self.say(now, format!("{why:#}"));
        self.state = State::Stopped;
        self.stopped_at = Some(now);
        self.may_go = [false; 2];
    }

    /// The control loop has come to its end: both arms are stopped.
    pub fn ended(&mut self) {
        self.may_go = [false; 2];
    }

    fn say(&mut self, at: MonotonicTime, text: String) {
        let t_s = self.t_s(at).max(0.0);
        self.noticed_s.push(t_s);
        self.truth.log.push(LogLine { t_millis: (t_s * 1e3) as u64, text });
    }

    /// Harm that links and gateways have counted.
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

    /// Writes down what happened until now.
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
            let since = [seen.latched.map(|latched| latched.at), by_gateway.then_some(now), self.stopped_at];
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

    fn step_at(&self, at: MonotonicTime) -> Step {
        let t_s = self.t_s(at);
        let arm = |index: usize| {
            let site = [&self.cell.vs, &self.cell.tc][index];
            let plant = site.joints.simulated().map(|plant| plant.lock().unwrap_or_else(PoisonError::into_inner));
            let obeys = !self.scenario.faults.iter().any(|fault| {
                // A joint that was driven away takes its time to come back to rest.
                fault.kind.disobeys() == Some(index) && (fault.from_s..fault.until_s() + 0.1).contains(&t_s)
            });
            ArmTruth {
                latched_since_s: self.latched_since[index].filter(|since| *since <= at).map(|since| self.t_s(since)),
                obeys,
                may_go: self.may_go[index],
                ..plant.map_or(ArmTruth::resting_at([f64::NAN; 7]), |plant| joints(plant, at))
            }
        };
        Step {
            t_s,
            arms: [arm(HAND_ARM), arm(TARGET_ARM)],
            world_from_target: placement(&self.cell, at),
            pose_age_s: self.exposed.map_or(f64::INFINITY, |exposed| at.seconds_since(exposed)),
            resets: 0,
            state: self.state.name(),
            says_why: self.says_why,
        }
    }
}

/// Joints at a time of the last seconds.
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
