//! A driver with a scripted arm, in virtual time.

use std::time::Duration;

use pb3dp_arm_pa10::driver::{
    Activity, ArmCondition, AxisLimits, Driver, DriverConfig, DriverState, Reply, Request, Sample, Transmit,
};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, AxisCommand, AxisReply, AxisStatus, CommStatus, CommWord, ControlMessage, Letter, ServoWord,
    SpeedCounts, TorqueCounts,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

pub const CYCLE: Duration = Duration::from_millis(10);

/// Step of the virtual time.
const TICK: Duration = Duration::from_micros(500);

/// A velocity within all limits of the wire format, different on each axis.
pub fn velocity() -> JointVector {
    JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7])
}

/// The arm at the other end: it answers each message after a delay, or not.
#[derive(Clone, Debug)]
pub struct Peer {
    pub answers: bool,
    pub knows_clear_alarm: bool,
    pub delay: Duration,
    /// This many of the next messages get no answer.
    pub drop_next: u32,
    pub servo: [ServoWord; 7],
    pub comm: CommWord,
    pub documented: bool,
    pub position_rad: JointVector,
    pub torque_n_m: JointVector,
    /// Limits of all axes, lower and upper, rad.
    pub limits_rad: [f64; 2],
}

/// A driver, its peer and what was sent.
#[derive(Clone, Debug)]
pub struct Bench {
    pub driver: Driver,
    pub now: MonotonicTime,
    pub peer: Peer,
    pub sent: Vec<(MonotonicTime, ControlMessage)>,
    pending: Option<(MonotonicTime, Reply)>,
}

/// Kind of message, for comparing sequences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Start,
    End,
    Clear,
    Limits,
    Off,
    Braked,
    Rest,
    Motion,
    Other,
}

pub fn kind(message: &ControlMessage) -> Kind {
    match message {
        ControlMessage::Start => Kind::Start,
        ControlMessage::End => Kind::End,
        ControlMessage::ClearAlarm(_) => Kind::Clear,
        ControlMessage::ReadEeprom(_) => Kind::Limits,
        ControlMessage::Cyclic(command) => match command.axes {
            axes if axes == [AxisCommand::Off; 7] => Kind::Off,
            axes if axes == [AxisCommand::Braked; 7] => Kind::Braked,
            axes if axes == [AxisCommand::Speed(SpeedCounts::ZERO); 7] => Kind::Rest,
            axes if axes.iter().all(|axis| matches!(axis, AxisCommand::Speed(_))) => Kind::Motion,
            _ => Kind::Other,
        },
        #[cfg(feature = "brake-release")]
        ControlMessage::ReleaseBrakes => Kind::Other,
    }
}

impl Peer {
    fn new() -> Self {
        Self {
            answers: true,
            knows_clear_alarm: true,
            delay: Duration::from_millis(3),
            drop_next: 0,
            servo: [ServoWord(0); 7],
            comm: CommWord(1),
            documented: true,
            position_rad: JointVector::from([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]),
            torque_n_m: JointVector::zeros(),
            limits_rad: [-3.0, 3.0],
        }
    }

    pub fn sample(&self) -> Sample {
        let (axes, comm) = if self.documented {
            (self.servo.map(AxisStatus::Servo), CommStatus::Comm(self.comm))
        } else {
            (self.servo.map(|word| AxisStatus::Undocumented(word.0)), CommStatus::Undocumented(self.comm.0))
        };
        Sample {
            age: Duration::ZERO,
            position_rad: self.position_rad,
            velocity_rad_per_s: self.documented.then(JointVector::zeros),
            torque_n_m: self.torque_n_m,
            condition: ArmCondition { axes, comm, gateway: None },
        }
    }

    fn reply(&mut self, message: &ControlMessage) -> Option<Reply> {
        if self.drop_next > 0 {
            self.drop_next -= 1;
            return None;
        }
        if !self.answers || (message.letter() == Letter::ClearAlarm && !self.knows_clear_alarm) {
            return None;
        }
        Some(match message {
            ControlMessage::Cyclic(_) => Reply::Sample(self.sample()),
            ControlMessage::ReadEeprom(axis) => {
                let [lower_rad, upper_rad] = self.limits_rad;
                Reply::Limits(AxisLimits { axis: *axis, lower_rad, upper_rad })
            }
            _ => Reply::Done,
        })
    }
}

impl Bench {
    pub fn new() -> Self {
        Self::with_config(DriverConfig::with_cycle(CYCLE))
    }

    pub fn with_config(config: DriverConfig) -> Self {
        let mut driver = Driver::new(config).unwrap();
        driver.note_watchdog(config.watchdog.stop_after());
        Self {
            driver,
            now: MonotonicTime::from_nanos(1_000_000_000),
            peer: Peer::new(),
            sent: Vec::new(),
            pending: None,
        }
    }

    /// In this state, after the normal sequence.
    pub fn in_state(state: DriverState) -> Self {
        let mut bench = Self::new();
        bench.lead_to(state);
        bench
    }

    pub fn lead_to(&mut self, state: DriverState) {
        let steps: &[Request] = match state {
            DriverState::Disconnected => &[],
            DriverState::Connected => &[Request::Connect],
            DriverState::Enabled => &[Request::Connect, Request::Enable],
            DriverState::Holding | DriverState::Fault | DriverState::EStop => {
                &[Request::Connect, Request::Enable, Request::ReleaseBrakes]
            }
            DriverState::Moving => {
                &[Request::Connect, Request::Enable, Request::ReleaseBrakes, Request::Move(velocity())]
            }
        };
        for request in steps {
            self.request(*request);
            self.settle();
        }
        match state {
            DriverState::Fault => self.alarm(0x0E0),
            DriverState::EStop => self.alarm(0x110),
            _ => {}
        }
        assert_eq!((self.driver.state(), self.driver.activity()), (state, Activity::None));
    }

    /// An alarm is raised, stops the arm and disappears.
    fn alarm(&mut self, word: u16) {
        self.peer.servo[3] = ServoWord(word);
        self.run(CYCLE * 2);
        self.peer.servo[3] = ServoWord(0);
        self.settle();
    }

    pub fn request(&mut self, request: Request) {
        self.driver.handle_request(self.now, request).unwrap();
    }

    /// Runs until no activity is in progress.
    pub fn settle(&mut self) {
        for _ in 0..40_000 {
            if self.driver.activity() == Activity::None {
                return;
            }
            self.tick();
        }
        assert_eq!(self.driver.activity(), Activity::None, "{:?}", self.driver);
    }

    pub fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.tick();
        }
    }

    /// Runs with a velocity command in every cycle.
    pub fn run_moving(&mut self, time: Duration) {
        let end = self.now + time;
        let moves = |driver: &Driver| (driver.state(), driver.activity()) == (DriverState::Moving, Activity::None);
        while self.now < end && moves(&self.driver) {
            if self.driver.handle_request(self.now, Request::Move(velocity())).is_err() {
                return;
            }
            self.run(CYCLE);
        }
    }

    fn tick(&mut self) {
        if let Some((at, reply)) = self.pending
            && self.now >= at
        {
            self.pending = None;
            self.driver.handle_reply(self.now, &reply);
        }
        if let Some(Transmit { message, .. }) = self.driver.poll_transmit(self.now) {
            self.sent.push((self.now, message));
            // Like a link that checks sequence numbers: an answer to an earlier message does not count.
            self.pending = self.peer.reply(&message).map(|reply| (self.now + self.peer.delay, reply));
        }
        self.now = self.now + TICK;
    }

    /// Sent messages from an index on, with runs of the same kind combined.
    pub fn kinds_since(&self, from: usize) -> Vec<(Kind, usize)> {
        let mut runs: Vec<(Kind, usize)> = Vec::new();
        for (_, message) in &self.sent[from..] {
            let kind = kind(message);
            match runs.last_mut() {
                Some((last, count)) if *last == kind => *count += 1,
                _ => runs.push((kind, 1)),
            }
        }
        runs
    }

    pub fn only_kinds_since(&self, from: usize) -> Vec<Kind> {
        self.kinds_since(from).into_iter().map(|(kind, _)| kind).collect()
    }
}

/// Format B, stationary, without an alarm.
pub fn arm_reply() -> ArmReply {
    let axis = AxisReply {
        status: AxisStatus::Servo(ServoWord(0)),
        angle: AngleCounts(580_267),
        speed: Some(SpeedCounts(-500)),
        torque: TorqueCounts(7),
    };
    ArmReply { axes: [axis; 7], comm: CommStatus::Comm(CommWord(0x0001)) }
}
