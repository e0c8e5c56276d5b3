//! The gateway between a scripted host and a scripted controller, in virtual time.

use std::time::Duration;

use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, AxisReply, AxisStatus, CommStatus, CommWord, ControlMessage, ControlPacket, Letter, Packet,
    ReplyMessage, ReplyPacket, ServoWord, SpeedCounts, TorqueCounts, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, DriveCommand, DriveMode, Firmware, Frame, FrameParser, GatewayMessage, GatewayState,
    Hello, HostMessage, MotionLimits, Received, Reject, RejectReason, StopCause,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

use crate::gateway::plausible_eeprom;

pub const ARM: ArmId = ArmId(2);
pub const CYCLE: Duration = Duration::from_millis(2);
pub const HOST_CYCLE: Duration = Duration::from_millis(10);
/// Step of the virtual time.
pub const TICK: Duration = Duration::from_micros(500);

pub const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

pub fn velocity() -> JointVector {
    JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7])
}

pub fn config(format: WireFormat) -> GatewayConfig {
    GatewayConfig::new(ARM, format, Firmware::new("test gateway 1").unwrap(), MotionLimits::WIDEST)
}

/// The servo controller on the bus: it answers each request as scripted.
#[derive(Clone, Debug)]
pub struct Controller {
    pub format: WireFormat,
    pub answers: bool,
    /// Letters that it does not support.
    pub deaf_to: Vec<Letter>,
    /// This many messages get no answer.
    pub drop_next: u32,
    pub delay: Duration,
    /// Added to the sequence numbers of replies.
    pub sequence_error: u8,
    pub servo: [ServoWord; 7],
    pub comm: CommWord,
    pub angle: AngleCounts,
    /// Speed of the fourth axis.
    pub speed: SpeedCounts,
    /// Replies in the other format.
    pub lies_about_format: bool,
}

/// One message on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sent {
    pub at: MonotonicTime,
    pub sequence: u8,
    pub message: ControlMessage,
    /// State of the gateway after the message.
    pub state: GatewayState,
}

#[derive(Clone, Debug)]
pub struct Bench {
    pub gateway: Gateway,
    pub controller: Controller,
    pub now: MonotonicTime,
    pub sent: Vec<Sent>,
    /// Messages from the gateway, in order.
    pub messages: Vec<(Frame, GatewayMessage)>,
    pub sequence: u16,
    /// The host's clock minus the gateway's, µs.
    pub host_clock_us: u64,
    parser: FrameParser,
    on_the_way: Vec<(MonotonicTime, arcnet::Frame)>,
}

impl Controller {
    pub fn new(format: WireFormat) -> Self {
        Self {
            format,
            answers: true,
            deaf_to: Vec::new(),
            drop_next: 0,
            delay: TICK,
            sequence_error: 0,
            servo: [ServoWord(0); 7],
            comm: CommWord(0x0001),
            angle: AngleCounts(1000),
            speed: SpeedCounts(3),
            lies_about_format: false,
        }
    }

    pub fn arm_reply(&self, format: WireFormat) -> ArmReply {
        let documented = format == WireFormat::BigEndian6x10;
        let axes = std::array::from_fn(|index| AxisReply {
            status: if documented {
                AxisStatus::Servo(self.servo[index])
            } else {
                AxisStatus::Undocumented(self.servo[index].0)
            },
            angle: AngleCounts(self.angle.0.saturating_mul(index as i32 + 1)),
            speed: documented.then_some(if index == 3 { self.speed } else { SpeedCounts(index as i16) }),
            torque: TorqueCounts(-3),
        });
        let comm = if documented { CommStatus::Comm(self.comm) } else { CommStatus::Undocumented(self.comm.0) };
        ArmReply { axes, comm }
    }

    fn reply(&mut self, asked: &ControlPacket) -> Option<Packet> {
        let letter = asked.message.letter();
        if self.drop_next > 0 {
            self.drop_next -= 1;
            return None;
        }
        if !self.answers || self.deaf_to.contains(&letter) {
            return None;
        }
        let [a, b] = WireFormat::ALL;
        let format = match self.format {
            format if !self.lies_about_format => format,
            format if format == a => b,
            _ => a,
        };
        let message = match asked.message {
            ControlMessage::Cyclic(_) => ReplyMessage::Cyclic(self.arm_reply(format)),
            ControlMessage::ReadEeprom(axis) => ReplyMessage::Eeprom(plausible_eeprom(axis)),
            _ => ReplyMessage::Done(letter),
        };
        let sequence = asked.sequence.wrapping_add(self.sequence_error);
        Some(ReplyPacket { sequence, message }.encode(format).unwrap())
    }
}

impl Bench {
    /// No host has sent anything, and the stop order at the start is complete.
    pub fn silent(config: GatewayConfig) -> Self {
        let now = MonotonicTime::from_nanos(3_000_000_000);
        let mut bench = Self {
            gateway: Gateway::new(config, now).unwrap(),
            controller: Controller::new(config.format),
            now,
            sent: Vec::new(),
            messages: Vec::new(),
            sequence: 40_000,
            host_clock_us: 777_000_000,
            parser: FrameParser::new(ARM),
            on_the_way: Vec::new(),
        };
        bench.run(config.brake_time + ms(20));
        assert_eq!((bench.letters().trim_start_matches('C'), bench.state()), ("EC", GatewayState::Idle));
        bench.sent.clear();
        bench
    }

    /// The host has sent HELLO.
    pub fn greeted(config: GatewayConfig) -> Self {
        let mut bench = Self::silent(config);
        assert!(matches!(bench.ask(hello()), GatewayMessage::HelloReply(_)));
        bench
    }

    /// With format B.
    pub fn new() -> Self {
        Self::greeted(config(WireFormat::BigEndian6x10))
    }

    /// In this state, after the normal sequence.
    pub fn lead_to(&mut self, state: GatewayState) {
        use GatewayState::{EmergencyStop, Fault, Holding, Idle, Moving, Stopping};
        if state != Idle {
            self.start();
        }
        if matches!(state, Holding | Moving | Stopping | Fault | EmergencyStop) {
            self.command_for(DriveMode::Follow, JointVector::zeros(), ms(210));
        }
        if matches!(state, Moving | Stopping | Fault | EmergencyStop) {
            self.command_for(DriveMode::Follow, velocity(), ms(30));
        }
        match state {
            Stopping => {
                self.tell(control(ArmOperation::Stop));
                self.run(ms(2));
            }
            Fault => {
                self.controller.servo[3] = ServoWord(0x00E0);
                self.run(ms(3));
                self.controller.servo[3] = ServoWord(0);
                self.run(ms(400));
            }
            EmergencyStop => {
                self.controller.comm = CommWord(0x0110);
                self.run(ms(3));
                self.controller.comm = CommWord(1);
                self.run(ms(400));
            }
            _ => {}
        }
        assert_eq!(self.state(), state);
    }

    pub fn start(&mut self) {
        let answer = self.ask(control(ArmOperation::Start));
        assert!(!matches!(answer, GatewayMessage::Reject(_)), "{answer:?}");
        self.run(ms(4));
        assert_eq!(self.state(), GatewayState::Started);
    }

    pub fn state(&self) -> GatewayState {
        self.gateway.status().state
    }

    pub fn cause(&self) -> StopCause {
        self.gateway.status().cause
    }

    /// Repeats a command for a while.
    pub fn command_for(&mut self, mode: DriveMode, velocity: JointVector, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            let answer = self.ask(self.command(mode, velocity));
            assert!(!matches!(answer, GatewayMessage::Reject(_)), "{answer:?}");
            let next = self.now + HOST_CYCLE;
            while self.now < next {
                self.tick();
            }
        }
    }

    /// A command.
    pub fn command(&self, mode: DriveMode, velocity: JointVector) -> HostMessage {
        HostMessage::Command(match mode {
            DriveMode::Follow => DriveCommand::follow(&velocity).unwrap(),
            other => DriveCommand::at_rest(other),
        })
    }

    pub fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.tick();
        }
    }

    pub fn tick(&mut self) {
        let now = self.now;
        let arrived = self.on_the_way.extract_if(.., |(at, _)| *at <= now).collect::<Vec<_>>();
        for (_, frame) in arrived {
            self.gateway.handle_bus_frame(now, &frame);
        }
        if let Some(frame) = self.gateway.poll_bus_frame(now) {
            let packet = arcnet::decode(Route::TO_CONTROLLER, &frame).unwrap();
            let asked = ControlPacket::decode(self.controller.format, packet).unwrap();
            let state = self.gateway.status().state;
            self.sent.push(Sent { at: now, sequence: asked.sequence, message: asked.message, state });
            if let Some(reply) = self.controller.reply(&asked) {
                self.on_the_way.push((now + self.controller.delay, arcnet::encode(Route::TO_HOST, &reply).unwrap()));
            }
        }
        self.listen();
        self.now = now + TICK;
    }

    /// Sends bytes as the host, and reads the immediate answers.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.gateway.handle_host_bytes(self.now, bytes);
        self.listen();
    }

    pub fn frame_of(&mut self, message: &HostMessage) -> Frame {
        self.sequence = self.sequence.wrapping_add(1);
        message.frame(ARM, self.sequence, self.now.as_nanos() / 1000 + self.host_clock_us)
    }

    /// Sends a message, and does not wait for the answer.
    pub fn tell(&mut self, message: HostMessage) -> u16 {
        let frame = self.frame_of(&message);
        self.bytes(&frame.encode());
        frame.sequence
    }

    /// Sends a message, and waits for its answer: at most 60 ms.
    pub fn ask(&mut self, message: HostMessage) -> GatewayMessage {
        let frame = self.frame_of(&message);
        self.ask_frame(&frame)
    }

    pub fn ask_frame(&mut self, frame: &Frame) -> GatewayMessage {
        let from = self.messages.len();
        self.bytes(&frame.encode());
        for _ in 0..120 {
            let answer = self.messages[from..].iter().find(|(answer, message)| {
                answer.sequence == frame.sequence && !matches!(message, GatewayMessage::Fault(_))
            });
            if let Some((_, message)) = answer {
                return *message;
            }
            self.tick();
        }
        panic!("no answer to {frame:?}: {:?}", &self.messages[from..]);
    }

    /// The letters sent on the bus.
    pub fn letters(&self) -> String {
        self.sent.iter().map(|sent| char::from(sent.message.letter().byte())).collect()
    }

    fn listen(&mut self) {
        while let Some(bytes) = self.gateway.poll_host_output(self.now) {
            let messages = &mut self.messages;
            self.parser.feed(&bytes, |received| {
                let Received::Frame(frame) = received else { panic!("{received:?}") };
                messages.push((frame, GatewayMessage::decode(&frame).unwrap()));
            });
        }
    }
}

pub fn hello() -> HostMessage {
    HostMessage::Hello(Hello { cycle_us: 10_000, limits: MotionLimits::WIDEST })
}

pub fn control(operation: ArmOperation) -> HostMessage {
    HostMessage::Control(Control::Arm(operation))
}

pub fn rejected(answer: GatewayMessage) -> (RejectReason, u32) {
    let GatewayMessage::Reject(Reject { reason, detail, .. }) = answer else { panic!("{answer:?}") };
    (reason, detail)
}
