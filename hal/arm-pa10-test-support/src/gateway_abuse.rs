//! Properties of a gateway for any behaviour of host, controller and time: shared by a fuzz target in `tests/fuzz` and the test
//! with random bytes.
//!
//! The bytes are a scenario: each byte selects the next event. The checks are in `World::take_frame` and `World::fall_silent`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "what fails here is found by it")]

use std::time::Duration;

use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmCommand, ArmReply, Axis, AxisCommand, AxisReply, AxisStatus, CommStatus, CommWord, ControlMessage,
    ControlPacket, ReplyMessage, ReplyPacket, ServoWord, SpeedCounts, Supervision, TorqueCounts, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, AxisMotionLimits, Control, DriveCommand, DriveMode, Firmware, Frame, FrameParser,
    GatewayMessage, GatewayState, Hello, HostMessage, MotionLimits, PAYLOAD_LENGTH_MAX, Payload, Received,
};
use pb3dp_geometry::MonotonicTime;

use crate::gateway::plausible_eeprom;

const ARM: ArmId = ArmId(1);

/// Quicker than real brakes, so that a scenario is short.
const BRAKE_TIME: Duration = Duration::from_millis(20);

/// The longest time until the arm is stopped: a silent host in `started`, the stop order, and letters without an answer.
const REST_MAX: Duration = Duration::from_millis(1500);

/// Interval of the checks whether the arm is stopped.
const REST_PIECE: Duration = Duration::from_millis(20);

/// Maximum events in a scenario.
const STEPS_MAX: usize = 200;

/// Maximum answers that a gateway may have pending for its host.
const ANSWERS_MAX: usize = 64;

struct World {
    gateway: Gateway,
    config: GatewayConfig,
    now: MonotonicTime,
    /// Behaviour of the controller.
    answers: bool,
    servo: u16,
    comm: u16,
    asked: Option<ControlPacket>,
    /// Sequence number of the host's next message.
    sequence: u16,
    /// Parses the host's bytes, as the gateway does.
    host_ear: FrameParser,
    own_ear: FrameParser,
    received_from_host: MonotonicTime,
    /// The highest speed requested so far, on each axis.
    speed_max: [u16; Axis::COUNT],
    /// Time since when each brake is commanded closed.
    closed_since: [Option<MonotonicTime>; Axis::COUNT],
}

/// Runs a scenario of random bytes.
pub fn gateway_core_survives(bytes: &[u8]) {
    let [choice, rest @ ..] = bytes else { return };
    let mut world = World::new(*choice);
    let mut play = rest;
    for _ in 0..STEPS_MAX {
        let [what, tail @ ..] = play else { break };
        play = world.act(*what, tail);
    }
    world.fall_silent();
}

/// Limits that most commands of a scenario exceed.
fn tight_limits() -> MotionLimits {
    let axis = AxisMotionLimits { speed: 500, acceleration: 2000, jerk: 5000, lower: -40, upper: 9000 };
    MotionLimits { axes: [axis; Axis::COUNT] }
}

/// Splits off this many bytes; returns them and the rest.
fn split(bytes: &[u8], most: usize) -> (&[u8], &[u8]) {
    bytes.split_at(bytes.len().min(most))
}

impl World {
    fn new(choice: u8) -> Self {
        let format = WireFormat::ALL[usize::from(choice & 1)];
        let firmware = Firmware::new("fuzz").unwrap();
        let config = GatewayConfig {
            brake_time: BRAKE_TIME,
            interpolates: choice & 2 == 0,
            ..GatewayConfig::new(
                ARM,
                format,
                firmware,
                if choice & 8 == 0 { MotionLimits::WIDEST } else { tight_limits() },
            )
        };
        let now = MonotonicTime::from_nanos(5_000_000_000);
        Self {
            gateway: Gateway::new(config, now).unwrap(),
            config,
            now,
            answers: choice & 4 == 0,
            servo: 0,
            comm: 1,
            asked: None,
            sequence: u16::from(choice) << 8,
            host_ear: FrameParser::new(ARM),
            own_ear: FrameParser::new(ARM),
            received_from_host: now,
            speed_max: [0; Axis::COUNT],
            closed_since: [None; Axis::COUNT],
        }
    }

    /// Executes the event of the first byte, which takes its parameters from the other bytes; returns the rest.
    fn act<'a>(&mut self, what: u8, bytes: &'a [u8]) -> &'a [u8] {
        let (first, rest) = match bytes {
            [first, rest @ ..] => (*first, rest),
            [] => (0, bytes),
        };
        match what % 14 {
            0 | 1 => self.run(Duration::from_micros(u64::from(first) * 500)),
            2 => self.say(&HostMessage::Hello(Hello {
                cycle_us: 2000 + u32::from(first) * 30,
                limits: if first & 2 == 0 { self.config.limits } else { MotionLimits::WIDEST },
            })),
            3 | 4 => return self.command(first, rest),
            5 => self.say(&HostMessage::Control(control(first))),
            6 => self.tell_frame(&Frame {
                arm: ARM,
                frame_type: 0x05,
                sequence: self.sequence,
                timestamp_us: self.now.as_nanos() / 1000,
                payload: Payload::EMPTY,
            }),
            7 => self.say(&HostMessage::Heartbeat),
            8 => {
                let (body, later) = split(rest, usize::from(first));
                self.tell(body);
                return later;
            }
            9 => {
                let (body, later) = split(rest, usize::from(first).min(PAYLOAD_LENGTH_MAX));
                let payload = Payload::from_slice(body).unwrap();
                self.tell_frame(&Frame {
                    arm: ARM,
                    frame_type: what,
                    sequence: self.sequence,
                    timestamp_us: 5,
                    payload,
                });
                return later;
            }
            10 => {
                let (body, later) = split(rest, usize::from(first));
                self.gateway.handle_bus_frame(self.now, body);
                return later;
            }
            11 => match first % 6 {
                0 => self.answers = !self.answers,
                1 => self.servo = u16::from(first) << 4,
                2 => self.comm = u16::from(first) << 4,
                3 => (self.servo, self.comm) = (0, 0),
                4 => self.servo = u16::from(first) << 8,
                _ => self.comm = u16::from(first) << 8,
            },
            12 => match first % 3 {
                0 => self.gateway.handle_host_gone(self.now),
                1 => self.gateway.stop(self.now),
                _ => self.now = self.now + Duration::from_millis(u64::from(first)),
            },
            _ => {
                // Commands at the host's rate.
                for _ in 0..first % 16 {
                    self.command(what.wrapping_mul(first), rest);
                    self.run(Duration::from_millis(10));
                }
            }
        }
        self.listen();
        rest
    }

    fn command<'a>(&mut self, choice: u8, bytes: &'a [u8]) -> &'a [u8] {
        let (speeds, later) = split(bytes, Axis::COUNT);
        let mode = [DriveMode::Off, DriveMode::Braked, DriveMode::Follow, DriveMode::Follow][usize::from(choice % 4)];
        let mut command = DriveCommand::at_rest(mode);
        if choice & 4 == 0 {
            for (to, speed) in command.speed_urad_per_s.iter_mut().zip(speeds) {
                *to = i32::from(*speed as i8) * 51_000;
            }
        }
        self.say(&HostMessage::Command(command));
        later
    }

    fn say(&mut self, message: &HostMessage) {
        let frame = message.frame(ARM, self.sequence, self.now.as_nanos() / 1000);
        self.tell_frame(&frame);
    }

    fn tell_frame(&mut self, frame: &Frame) {
        self.sequence = self.sequence.wrapping_add(1);
        self.tell(&frame.encode());
    }

    fn tell(&mut self, bytes: &[u8]) {
        let speed_max = &mut self.speed_max;
        self.host_ear.feed(bytes, |received| {
            let Received::Frame(frame) = received else { return };
            note_speeds(speed_max, &frame);
        });
        self.received_from_host = self.now;
        self.gateway.handle_host_bytes(self.now, bytes);
        self.listen();
    }

    fn run(&mut self, time: Duration) {
        let end = self.now + time;
        loop {
            let due = self.gateway.next_deadline();
            if due > end {
                break;
            }
            self.now = self.now.max(due);
            self.answer();
            if let Some(frame) = self.gateway.poll_bus_frame(self.now) {
                self.take_frame(&frame);
            }
            self.listen();
            if self.now >= end {
                break;
            }
        }
        self.now = self.now.max(end);
    }

    /// The controller's reply to the last message.
    fn answer(&mut self) {
        let Some(asked) = self.asked.take().filter(|_| self.answers) else { return };
        let message = match asked.message {
            ControlMessage::Cyclic(_) => ReplyMessage::Cyclic(self.reply()),
            ControlMessage::ReadEeprom(axis) => ReplyMessage::Eeprom(plausible_eeprom(axis)),
            other => ReplyMessage::Done(other.letter()),
        };
        let packet = ReplyPacket { sequence: asked.sequence, message }.encode(self.config.format).unwrap();
        let frame = arcnet::encode(Route::TO_HOST, &packet).unwrap();
        self.gateway.handle_bus_frame(self.now, &frame);
    }

    fn reply(&self) -> ArmReply {
        let documented = self.config.format == WireFormat::BigEndian6x10;
        let axes = std::array::from_fn(|index| {
            let word = if index == 3 { self.servo } else { 0 };
            AxisReply {
                status: if documented { AxisStatus::Servo(ServoWord(word)) } else { AxisStatus::Undocumented(word) },
                angle: AngleCounts(1000),
                speed: documented.then_some(SpeedCounts(0)),
                torque: TorqueCounts(0),
            }
        });
        let comm = if documented { CommStatus::Comm(CommWord(self.comm)) } else { CommStatus::Undocumented(self.comm) };
        ArmReply { axes, comm }
    }

    /// Checks a message: it is valid, its letter is S, C, E, A or R, no speed exceeds its limit or the requested one, or outlives its command,
    /// and no servo is off before its brake holds.
    fn take_frame(&mut self, frame: &[u8]) {
        let packet = arcnet::decode(Route::TO_CONTROLLER, frame).unwrap();
        assert!(b"SCEAR".contains(&packet[1]), "letter {}", packet[1]);
        let packet = ControlPacket::decode(self.config.format, packet).unwrap();
        self.asked = Some(packet);
        let holds = |since: &Option<MonotonicTime>| since.is_some_and(|at| self.now.saturating_since(at) >= BRAKE_TIME);
        match packet.message {
            ControlMessage::Cyclic(command) => {
                let silent_for = self.now.saturating_since(self.received_from_host);
                for (axis, commanded) in command.axes.iter().enumerate() {
                    let speed = commanded.speed().0.unsigned_abs();
                    assert!(speed <= self.speed_max[axis], "axis {axis}: {speed}, {} asked for", self.speed_max[axis]);
                    assert!(speed <= self.config.limits.axes[axis].speed, "axis {axis}: {speed} is beyond its limit");
                    assert!(
                        speed == 0 || silent_for <= self.config.watchdog.stop_after(),
                        "{speed} after {silent_for:?}"
                    );
                    assert!(*commanded != AxisCommand::Off || holds(&self.closed_since[axis]), "axis {axis} falls");
                    let is_open = matches!(commanded, AxisCommand::Speed(_));
                    let since = self.closed_since[axis].or((!is_open).then_some(self.now));
                    self.closed_since[axis] = since.filter(|_| !is_open);
                }
            }
            ControlMessage::End => assert!(self.closed_since.iter().all(holds), "E, and the brakes do not hold"),
            _ => {}
        }
    }

    /// Reads the output of the gateway, which is valid and bounded.
    fn listen(&mut self) {
        let mut count = 0;
        while let Some(bytes) = self.gateway.poll_host_output(self.now) {
            self.own_ear.feed(&bytes, |received| {
                let Received::Frame(frame) = received else { panic!("{received:?}") };
                GatewayMessage::decode(&frame).unwrap();
            });
            count += 1;
            assert!(count <= ANSWERS_MAX, "it does not stop talking");
        }
        assert!(!self.own_ear.is_within_frame());
    }

    fn run_to_rest(&mut self) {
        let end = self.now + REST_MAX;
        while !self.gateway.is_at_rest() && self.now < end {
            self.run(REST_PIECE);
        }
    }

    /// Nobody sends anything any more: the arm stops with closed brakes and stays stopped. A controller that does not answer gets
    /// the stop order again until it answers.
    fn fall_silent(&mut self) {
        self.run_to_rest();
        if !self.answers && !self.gateway.is_at_rest() {
            assert!(self.gateway.status().stop_unacknowledged, "{:?}", self.gateway.status());
            assert!(self.closed_since.iter().all(Option::is_some));
            self.answers = true;
            self.run_to_rest();
        }
        let status = self.gateway.status();
        assert!(self.gateway.is_at_rest(), "{status:?}");
        assert!(
            matches!(status.state, GatewayState::Idle | GatewayState::Fault | GatewayState::EmergencyStop),
            "{status:?}"
        );
        assert!(self.closed_since.iter().all(Option::is_some));
        self.asked = None;
        self.run(Duration::from_millis(20));
        assert_eq!(self.asked, None);
    }
}

fn control(choice: u8) -> Control {
    let axis = Axis::ALL[usize::from(choice / 8) % Axis::COUNT];
    match choice % 8 {
        0 | 1 => Control::Arm(ArmOperation::Start),
        2 => Control::Arm(ArmOperation::Abort),
        3 => Control::Arm(ArmOperation::End),
        4 => Control::Arm(ArmOperation::Stop),
        5 => Control::Arm(ArmOperation::Reset),
        6 => Control::ClearAlarm(axis),
        _ => Control::ReadEeprom(axis),
    }
}

/// Records the speeds of a host command, whether or not the gateway accepts it.
fn note_speeds(speed_max: &mut [u16; Axis::COUNT], frame: &Frame) {
    let counts = match HostMessage::decode(frame) {
        Ok(HostMessage::Command(command)) => {
            let asked = ArmCommand::velocities(&command.velocity_rad_per_s(), Supervision::default());
            asked.map(|asked| asked.axes.map(|axis| axis.speed().0.unsigned_abs()))
        }
        _ => return,
    };
    for (most, speed) in speed_max.iter_mut().zip(counts.into_iter().flatten()) {
        *most = (*most).max(speed);
    }
}
