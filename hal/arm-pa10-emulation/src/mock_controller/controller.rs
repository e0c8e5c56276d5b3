//! The controller: messages in, replies out, brakes and joints in between.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pb3dp_arm_pa10_protocol::arcnet::{self, Frame, Route};
use pb3dp_arm_pa10_protocol::codec::{AngleCounts, ArmReply, Axis, CommAlarm, ServoAlarm};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{AxisMode, JointPlant};

use super::axis::{AxisDrive, Brake, BrakeTimes};
use super::config::{MockControllerConfig, MockControllerError};
use super::fault::{Fault, ReplyFault};
use super::line::Line;
use super::outbox::Outbox;
use super::panel::{Cause, Panel};
use super::random::Random;
use super::schedule::Schedule;
use super::script::{Script, ScriptLine};
use super::words::LineError;

/// Mode of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlMode {
    /// Brakes on, servos off: after power-up, E or a time-out.
    Adjustment,
    /// Between S and E: commands are executed.
    Control,
    /// Between T and E: brakes open, servos off; the arm falls.
    BrakeRelease,
}

/// Counters of an emulated controller.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MockCounters {
    /// Received frames.
    pub frames: u64,
    /// Messages that were answered.
    pub answered: u64,
    /// Letters that must never be sent, refused: M, W, P, and T without the feature.
    pub forbidden: u64,
    /// Frames without a message: a wrong length, an unknown letter, an invalid axis.
    pub malformed: u64,
    /// Commands that no correct driver sends: torques, undefined bits.
    pub odd: u64,
    /// Axes that were commanded to have neither brake nor servo.
    pub released: u64,
    /// Number of stops because no message came.
    pub watchdog_trips: u64,
    /// Faults, by their name in scripts.
    pub faults: BTreeMap<&'static str, u64>,
}

/// The servo controller of a PA-10 with its arm, byte for byte and without I/O: see the [module](super).
#[derive(Debug)]
pub struct MockController {
    pub(super) config: MockControllerConfig,
    pub(super) limits: [[AngleCounts; 2]; Axis::COUNT],
    pub(super) plant: Arc<Mutex<JointPlant>>,
    pub(super) axes: [AxisDrive; Axis::COUNT],
    pub(super) panel: Panel,
    pub(super) mode: ControlMode,
    powered: bool,
    /// In control mode: time of the last message.
    pub(super) last_message: MonotonicTime,
    pub(super) watches_dead_man: bool,
    pub(super) angle_offset_rad: JointVector,
    pub(super) torque_n_m: JointVector,
    pub(super) stale: Option<ArmReply>,
    deaf: u32,
    pub(super) outbox: Outbox,
    pub(super) line: Line,
    schedule: Schedule,
    pub(super) counters: MockCounters,
    now: MonotonicTime,
}

impl MockController {
    /// A controller after power-up, with these joints.
    ///
    /// # Errors
    /// If a number of the configuration is out of range.
    pub fn new(
        config: MockControllerConfig,
        plant: Arc<Mutex<JointPlant>>,
        seed: u64,
        now: MonotonicTime,
    ) -> Result<Self, MockControllerError> {
        if config.watchdog.is_some_and(|time| time.is_zero()) {
            return Err(MockControllerError::Watchdog);
        }
        let mut limits = [[AngleCounts(0); 2]; Axis::COUNT];
        for axis in Axis::ALL {
            limits[axis.index()] = config.limits(axis)?;
        }
        let mut controller = Self {
            config,
            limits,
            plant,
            axes: [AxisDrive::AT_REST; Axis::COUNT],
            panel: Panel::new(),
            mode: ControlMode::Adjustment,
            powered: true,
            last_message: now,
            watches_dead_man: false,
            angle_offset_rad: JointVector::zeros(),
            torque_n_m: JointVector::zeros(),
            stale: None,
            deaf: 0,
            outbox: Outbox::new(Random::new(seed)),
            line: Line::new(Random::new(seed.rotate_left(32))),
            schedule: Schedule::new(now, Random::new(!seed)),
            counters: MockCounters::default(),
            now,
        };
        controller.move_joints(now);
        Ok(controller)
    }

    /// The joints, to share with other observers of this arm.
    pub fn plant(&self) -> Arc<Mutex<JointPlant>> {
        Arc::clone(&self.plant)
    }

    /// Mode of the controller.
    pub fn mode(&self) -> ControlMode {
        self.mode
    }

    /// Whether it has power.
    pub fn is_powered(&self) -> bool {
        self.powered
    }

    /// Counters so far.
    pub fn counters(&self) -> &MockCounters {
        &self.counters
    }

    /// Whether no brake is open, opening or closing.
    pub fn is_braked(&self) -> bool {
        self.axes.iter().all(|axis| axis.brake == Brake::Closed)
    }

    /// Brake or servo that holds each joint.
    pub fn axis_modes(&self) -> [AxisMode; Axis::COUNT] {
        self.axes.map(|axis| axis.mode())
    }

    /// True angles (rad) and speeds (rad/s) of the joints.
    pub fn true_joints(&self) -> (JointVector, JointVector) {
        let joints = self.joints();
        // The present is always known.
        joints.motion_at(joints.now()).unwrap_or_else(|| (JointVector::zeros(), JointVector::zeros()))
    }

    /// Command of each servo, rad/s.
    pub fn commanded_rad_per_s(&self) -> JointVector {
        JointVector::from(self.axes.map(|axis| axis.velocity_rad_per_s))
    }

    /// Receives a frame from the bus. Frames for other nodes are ignored.
    pub fn handle_frame(&mut self, now: MonotonicTime, frame: &[u8]) {
        self.advance(now);
        let Ok(packet) = arcnet::decode(Route::TO_CONTROLLER, frame) else {
            let foreign = frame.first_chunk().is_some_and(|&[_, receiver]| receiver != arcnet::CONTROLLER_NODE);
            self.counters.malformed += u64::from(!foreign);
            return;
        };
        if !self.powered {
            return;
        }
        if self.deaf > 0 {
            self.deaf -= 1;
            return;
        }
        for fault in self.schedule.roll() {
            self.inject(now, fault);
        }
        if !self.powered || self.deaf > 0 {
            self.deaf = self.deaf.saturating_sub(1);
            return;
        }
        self.counters.frames += 1;
        self.handle_packet(now, packet);
        self.move_joints(now);
    }

    /// A reply that has arrived at the host.
    pub fn poll_frame(&mut self, now: MonotonicTime) -> Option<Frame> {
        self.advance(now);
        self.outbox.poll(now)
    }

    /// Time of the next event: a reply arrives, a brake has moved, the watchdog expires, a fault comes.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        [self.next_event(), self.outbox.next_arrival()].into_iter().flatten().min()
    }

    fn next_event(&self) -> Option<MonotonicTime> {
        let mut next = [self.watchdog_deadline(), self.schedule.next()].into_iter().flatten().min();
        // Called several times in each cycle, mostly without a moving brake.
        for at in self.axes.iter().filter_map(AxisDrive::next_change) {
            next = Some(next.map_or(at, |next| next.min(at)));
        }
        next
    }

    fn watchdog_deadline(&self) -> Option<MonotonicTime> {
        let watches = self.mode != ControlMode::Adjustment;
        self.config.watchdog.filter(|_| watches).map(|time| self.last_message + time)
    }

    /// Advances the time; all events happen at their own times and in order. A past time does nothing.
    pub fn advance(&mut self, now: MonotonicTime) {
        while let Some(at) = self.next_event().filter(|at| *at <= now) {
            let at = at.max(self.now);
            self.now = at;
            self.axes.iter_mut().for_each(|axis| axis.advance(at));
            if self.watchdog_deadline().is_some_and(|deadline| deadline <= at) {
                self.counters.watchdog_trips += 1;
                self.time_out(at);
            }
            while let Some(fault) = self.schedule.pop(at) {
                self.inject(at, fault);
            }
            self.move_joints(at);
        }
        self.now = self.now.max(now);
        self.joints().advance_to(self.now);
    }

    /// Schedules the lines of a script, relative to the creation of the controller.
    pub fn play(&mut self, now: MonotonicTime, script: &Script) {
        script.lines.iter().for_each(|line| self.schedule.add(now, line));
    }

    /// Executes one line of a script.
    ///
    /// # Errors
    /// Names the wrong word and the allowed ones; nothing happens then.
    pub fn command_line(&mut self, now: MonotonicTime, line: &str) -> Result<(), LineError> {
        if let Some(line) = ScriptLine::parse(line)? {
            self.schedule.add(now, &line);
            self.advance(now);
        }
        Ok(())
    }

    /// Starts or ends a fault at once.
    pub fn inject(&mut self, now: MonotonicTime, fault: Fault) {
        *self.counters.faults.entry(fault.name()).or_default() += 1;
        let times = self.brake_times();
        match fault {
            Fault::Reply { kind, count } => {
                self.stale = (kind == ReplyFault::Stale).then(|| self.measure()).or(self.stale.take());
                self.outbox.spoil(kind, count);
            }
            Fault::Delay { count, by } => self.outbox.delay(count, by),
            Fault::Deaf { count } => self.deaf = count,
            Fault::Silence(on) => self.outbox.silent = on,
            Fault::Slow(by) => self.outbox.slow = by,
            Fault::ServoAlarm { axis, alarm, only_reported } => {
                let memory = &mut self.panel.servo[axis.index()];
                if only_reported {
                    memory.set_reported_cause(alarm)
                } else {
                    memory.set_cause(Cause::Other, alarm)
                }
                if alarm.is_some() && !only_reported {
                    self.axes[axis.index()].cut(now, times);
                }
            }
            Fault::ControllerAlarm { alarm, only_reported } => {
                let memory = &mut self.panel.comm;
                if only_reported {
                    memory.set_reported_cause(alarm)
                } else {
                    memory.set_cause(Cause::Other, alarm)
                }
                if alarm.is_some() && !only_reported {
                    self.stop(now);
                }
            }
            Fault::EmergencyStop { pressed } => {
                self.panel.press_e_stop(pressed);
                if pressed {
                    self.cut_power(now);
                }
            }
            Fault::DeadMan { held } => {
                self.panel.dead_man_held = held;
                self.watch_dead_man(now);
            }
            Fault::LimitSwitch { open } => {
                self.panel.limit_switch_open = open;
                self.panel.comm.set_cause(Cause::LimitSwitch, open.then_some(CommAlarm::LimitSwitch));
                if open {
                    self.stop(now);
                }
            }
            Fault::TeachingSwitch { on } => self.panel.teaching = on,
            Fault::PowerTemperature { high } => self.panel.power_too_warm = high,
            Fault::ServoPower { on } => self.set_servo_power(now, on),
            Fault::Power { on } => self.set_power(now, on),
            Fault::TimeOut => self.time_out(now),
            Fault::Stuck { axis, on } => self.axes[axis.index()].stuck = on,
            Fault::Runaway { axis, velocity_rad_per_s } => {
                self.axes[axis.index()].runaway_rad_per_s = velocity_rad_per_s;
            }
            Fault::Jump { axis, by_rad } => self.angle_offset_rad[axis.index()] += by_rad,
            Fault::Torque { axis, torque_n_m } => self.torque_n_m[axis.index()] = torque_n_m,
            Fault::Line(fault) => self.line.inject(fault),
        }
        self.move_joints(now);
    }

    pub(super) fn brake_times(&self) -> BrakeTimes {
        BrakeTimes { open: self.config.brake_open, close: self.config.brake_close }
    }

    /// Stops, closes the brakes, leaves the control mode.
    pub(super) fn stop(&mut self, now: MonotonicTime) {
        self.mode = ControlMode::Adjustment;
        let times = self.brake_times();
        self.axes.iter_mut().for_each(|axis| axis.stop(now, times));
    }

    fn time_out(&mut self, now: MonotonicTime) {
        self.panel.raise_everywhere(ServoAlarm::CommunicationTimeout, CommAlarm::HostTimeout);
        self.stop(now);
    }

    fn cut_power(&mut self, now: MonotonicTime) {
        self.mode = ControlMode::Adjustment;
        let times = self.brake_times();
        self.axes.iter_mut().for_each(|axis| axis.cut(now, times));
    }

    fn set_servo_power(&mut self, now: MonotonicTime, on: bool) {
        self.panel.servo_power = on;
        if !on {
            self.cut_power(now);
        }
    }

    fn set_power(&mut self, now: MonotonicTime, on: bool) {
        if on && !self.powered {
            self.panel.clear_all();
        }
        if !on {
            self.cut_power(now);
            self.outbox.clear();
        }
        self.powered = on;
    }

    /// Stops if the dead-man switch is released while commands request its supervision.
    pub(super) fn watch_dead_man(&mut self, now: MonotonicTime) {
        let released = self.watches_dead_man && self.mode == ControlMode::Control && !self.panel.dead_man_held;
        let cause = released.then_some((ServoAlarm::DeadManOff, CommAlarm::DeadManOff));
        if let Some((servo, comm)) = cause {
            self.panel.raise_everywhere(servo, comm);
            self.stop(now);
        }
    }

    pub(super) fn joints(&self) -> MutexGuard<'_, JointPlant> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Applies brakes and servos to the joints.
    fn move_joints(&mut self, now: MonotonicTime) {
        let (modes, velocity) = (self.axis_modes(), self.commanded_rad_per_s());
        let mut plant = self.joints();
        plant.advance_to(now);
        if *plant.commanded_rad_per_s() != velocity {
            // Speeds are counts of the wire times a constant, or finite numbers of a script.
            plant.command(now, velocity).ok();
        }
        if *plant.modes() != modes {
            plant.set_modes(now, modes).ok();
        }
    }
}
