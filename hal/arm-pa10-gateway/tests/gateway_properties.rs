//! Invariants of a gateway for any behaviour of host, controller and clock.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, AxisCommand, CommWord, ControlMessage, ServoWord, SpeedCounts, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, DriveMode, GatewayMessage, GatewayState, HostMessage,
};
use pb3dp_arm_pa10_test_support::gateway_bench as bench;
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, Sent, config, control, hello, ms, velocity};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use proptest::prelude::*;

const BRAKE_TIME: Duration = Duration::from_millis(200);
const STOP_AFTER: Duration = Duration::from_millis(50);

/// An event for a gateway.
#[derive(Clone, Debug)]
enum Happening {
    Wait(u64),
    Hello,
    Heartbeat,
    Control(ArmOperation),
    ClearAlarm(usize),
    ReadLimits(usize),
    /// Commands of this mode and speed, this many, every 10 ms.
    Commands(DriveMode, i8, u32),
    Bytes(Vec<u8>),
    /// A frame on the bus with these bytes; if `true`, with a valid header of the controller.
    BusFrame(Vec<u8>, bool),
    HostGone,
    /// The sequence to motion.
    Up,
    DropReplies(u32),
    Deaf(bool),
    Servo(usize, u16),
    Comm(u16),
    Angle(i32),
    OtherFormat(bool),
    WrongNumbers(u8),
    SlowReplies(u64),
    /// The gateway is not polled for this time, ms.
    Stall(u64),
    Stop,
}

fn happening() -> impl Strategy<Value = Happening> {
    use ArmOperation::{Abort, End, Reset, Start, Stop};
    let mode = prop_oneof![Just(DriveMode::Off), Just(DriveMode::Braked), Just(DriveMode::Follow)];
    let words = prop_oneof![Just(0u16), Just(0x00E0), Just(0x0110), Just(0x4000), any::<u16>()];
    prop_oneof![
        4 => (0u64..300).prop_map(Happening::Wait),
        2 => Just(Happening::Hello),
        1 => Just(Happening::Heartbeat),
        3 => prop_oneof![Just(Start), Just(End), Just(Stop), Just(Reset), Just(Abort)].prop_map(Happening::Control),
        2 => Just(Happening::Control(Reset)),
        1 => (0usize..7).prop_map(Happening::ClearAlarm),
        1 => (0usize..7).prop_map(Happening::ReadLimits),
        4 => (mode, -3i8..4, 1u32..40).prop_map(|(mode, speed, count)| Happening::Commands(mode, speed, count)),
        1 => prop::collection::vec(any::<u8>(), 0..60).prop_map(Happening::Bytes),
        1 => (prop::collection::vec(any::<u8>(), 0..90), any::<bool>())
            .prop_map(|(bytes, sound)| Happening::BusFrame(bytes, sound)),
        1 => Just(Happening::HostGone),
        4 => Just(Happening::Up),
        1 => (1u32..6).prop_map(Happening::DropReplies),
        1 => any::<bool>().prop_map(Happening::Deaf),
        1 => (0usize..7, words.clone()).prop_map(|(axis, word)| Happening::Servo(axis, word)),
        1 => words.prop_map(Happening::Comm),
        1 => prop_oneof![Just(1000), any::<i32>()].prop_map(Happening::Angle),
        1 => any::<bool>().prop_map(Happening::OtherFormat),
        1 => (0u8..3).prop_map(Happening::WrongNumbers),
        1 => (0u64..4).prop_map(Happening::SlowReplies),
        1 => (1u64..120).prop_map(Happening::Stall),
        1 => Just(Happening::Stop),
    ]
}

/// A bench with the history that the checks need.
struct Watched {
    bench: Bench,
    /// Time of the last command, whether or not it was accepted.
    commanded: MonotonicTime,
    /// Frames that must get one answer each.
    reported: Vec<u16>,
    checked: usize,
    messages: usize,
    last: Option<Sent>,
    opened: [Option<MonotonicTime>; 7],
    latched: bool,
    /// Commands with open brakes since the latch.
    open_since_latch: u32,
}

impl Watched {
    fn new(format: WireFormat) -> Self {
        let bench = Bench::silent(config(format));
        let commanded = bench.now;
        Self {
            bench,
            commanded,
            reported: Vec::new(),
            checked: 0,
            messages: 0,
            last: None,
            opened: [None; 7],
            latched: false,
            open_since_latch: 0,
        }
    }

    fn tell(&mut self, message: HostMessage) {
        if matches!(message, HostMessage::Command(_)) {
            self.commanded = self.bench.now;
        }
        let sequence = self.bench.tell(message);
        self.reported.push(sequence);
    }

    fn run(&mut self, time: Duration) {
        let end = self.bench.now + time;
        while self.bench.now < end {
            self.bench.tick();
            self.check();
        }
    }

    fn commands(&mut self, mode: DriveMode, velocity: JointVector, count: u32) {
        for _ in 0..count {
            let command = self.bench.command(mode, velocity);
            self.tell(command);
            self.check();
            self.run(ms(10));
        }
    }

    fn happen(&mut self, happening: &Happening) {
        match happening {
            Happening::Wait(millis) => self.run(ms(*millis)),
            Happening::Hello => self.tell(hello()),
            Happening::Heartbeat => self.tell(HostMessage::Heartbeat),
            Happening::Control(operation) => self.tell(control(*operation)),
            Happening::ClearAlarm(axis) => {
                self.tell(HostMessage::Control(Control::ClearAlarm(pb3dp_arm_pa10_protocol::codec::Axis::ALL[*axis])));
            }
            Happening::ReadLimits(axis) => {
                self.tell(HostMessage::Control(Control::ReadEeprom(pb3dp_arm_pa10_protocol::codec::Axis::ALL[*axis])));
            }
            Happening::Commands(mode, speed, count) => {
                self.commands(*mode, velocity() * f64::from(*speed), *count);
            }
            Happening::Bytes(bytes) => self.bench.bytes(bytes),
            Happening::BusFrame(bytes, sound) => {
                let pointer = 0u8.wrapping_sub(bytes.len() as u8);
                let header = if *sound { &[0xFE, 0xFF, pointer, 0xB7][..] } else { &[] };
                self.bench.gateway.handle_bus_frame(self.bench.now, &[header, bytes].concat());
            }
            Happening::HostGone => {
                self.bench.gateway.handle_host_gone(self.bench.now);
                // Pending answers have no receiver.
                self.reported.clear();
            }
            Happening::Up => self.go_up(),
            Happening::DropReplies(count) => self.bench.controller.drop_next = *count,
            Happening::Deaf(deaf) => self.bench.controller.answers = !deaf,
            Happening::Servo(axis, word) => self.bench.controller.servo[*axis] = ServoWord(*word),
            Happening::Comm(word) => self.bench.controller.comm = CommWord(*word),
            Happening::Angle(counts) => self.bench.controller.angle = AngleCounts(*counts),
            Happening::OtherFormat(lies) => self.bench.controller.lies_about_format = *lies,
            Happening::WrongNumbers(error) => self.bench.controller.sequence_error = *error,
            Happening::SlowReplies(millis) => self.bench.controller.delay = ms(*millis),
            Happening::Stall(millis) => self.bench.now = self.bench.now + ms(*millis),
            Happening::Stop => self.bench.gateway.stop(self.bench.now),
        }
        self.check();
    }

    /// With a controller that answers: HELLO, reset, start, open brakes, motion.
    fn go_up(&mut self) {
        self.heal();
        self.run(ms(450));
        self.tell(hello());
        self.tell(control(ArmOperation::Reset));
        self.run(ms(60));
        self.tell(control(ArmOperation::Start));
        self.run(ms(20));
        self.commands(DriveMode::Follow, JointVector::zeros(), 22);
        self.commands(DriveMode::Follow, velocity(), 3);
    }

    fn heal(&mut self) {
        let healthy = bench::Controller::new(self.bench.controller.format);
        self.bench.controller = healthy;
    }

    /// Checks all messages since the last call.
    fn check(&mut self) {
        while let Some(sent) = self.bench.sent.get(self.checked).copied() {
            self.checked += 1;
            self.check_sent(&sent);
        }
        let state = self.bench.state();
        let latched = matches!(state, GatewayState::Fault | GatewayState::EmergencyStop);
        let messages = &self.bench.messages[self.messages..];
        let was_reset = messages.iter().any(|(_, message)| {
            matches!(message, GatewayMessage::ControlReply(reply) if reply.control == Control::Arm(ArmOperation::Reset))
        });
        self.messages = self.bench.messages.len();
        match (self.latched, latched) {
            (false, true) => (self.latched, self.open_since_latch) = (true, 0),
            (true, false) => {
                assert!(was_reset, "the latch was left without a reset, to {state}");
                let controller = &self.bench.controller;
                assert!(controller.answers && controller.deaf_to.is_empty(), "reset without a controller");
                self.latched = false;
            }
            _ => {}
        }
    }

    fn check_sent(&mut self, sent: &Sent) {
        let ControlMessage::Cyclic(command) = &sent.message else { return };
        if self.latched && command.axes.iter().any(|axis| matches!(axis, AxisCommand::Speed(_))) {
            self.open_since_latch += 1;
            // 30 ms of ramp and five cycles at speed 0; a stall adds none.
            assert!(self.open_since_latch <= 15 + 5 + 1, "brakes stay open after the latch: {sent:?}");
        }
        for (index, axis) in command.axes.iter().enumerate() {
            let before = self.last.map(|last| match last.message {
                ControlMessage::Cyclic(command) => command.axes[index],
                _ => AxisCommand::Off,
            });
            let what = format!("axis {index} {axis:?} after {before:?} in {}: {sent:?}", sent.state);
            let moving_before = before.is_some_and(|before| before.speed() != SpeedCounts::ZERO);
            let AxisCommand::Speed(speed) = axis else {
                assert!(!moving_before, "a brake closes on a moving axis: {what}");
                self.opened[index] = None;
                continue;
            };
            use GatewayState::{EmergencyStop, Fault, Holding, Moving, Stopping};
            assert!(matches!(sent.state, Holding | Moving | Stopping | Fault | EmergencyStop), "brakes open: {what}");
            let opened = *self.opened[index].get_or_insert(sent.at);
            if speed.0 != 0 {
                let open = sent.at.saturating_since(opened);
                assert!(open >= BRAKE_TIME, "a speed against a brake that opened {open:?} ago: {what}");
                let age = sent.at.saturating_since(self.commanded);
                assert!(age < STOP_AFTER, "a speed {age:?} after the last command: {what}");
            }
        }
        self.last = Some(*sent);
    }

    /// Ends with a silent host: brakes closed, control mode off, every frame answered once.
    fn finish(&mut self) {
        self.heal();
        self.run(ms(1600));
        let state = self.bench.state();
        use GatewayState::{EmergencyStop, Fault, Idle};
        assert!(matches!(state, Idle | Fault | EmergencyStop), "{state} after a long silence");
        assert!(self.bench.gateway.is_at_rest());
        if let Some(Sent { message: ControlMessage::Cyclic(command), .. }) = self.last {
            assert!(command.axes.iter().all(|axis| !matches!(axis, AxisCommand::Speed(_))), "{command:?}");
        }
        for sequence in &self.reported {
            let answers =
                self.bench.messages.iter().filter(|(frame, message)| {
                    frame.sequence == *sequence && !matches!(message, GatewayMessage::Fault(_))
                });
            assert_eq!(answers.count(), 1, "answers to frame {sequence}");
        }
        assert_eq!(self.bench.gateway.status().answers_dropped, 0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(400) })]

    #[test]
    fn nothing_forbidden_happens(
        format in prop_oneof![Just(WireFormat::LittleEndian5x8), Just(WireFormat::BigEndian6x10)],
        happenings in prop::collection::vec(happening(), 1..25),
    ) {
        let mut watched = Watched::new(format);
        for happening in &happenings {
            watched.happen(happening);
        }
        watched.finish();
    }

    /// A moving gateway that receives only random bytes, damaged frames and repetitions of good ones, stops.
    #[test]
    fn noise_in_the_place_of_commands_stops_the_arm(
        noise in prop::collection::vec((prop::collection::vec(any::<u8>(), 0..200), any::<bool>()), 1..30),
    ) {
        let mut bench = Bench::new();
        bench.lead_to(GatewayState::Moving);
        let from = bench.now;
        let command = bench.command(DriveMode::Follow, velocity());
        let frame = command.frame(bench::ARM, bench.sequence, 0).encode();
        bench.sent.clear();
        for (bytes, repeat) in &noise {
            bench.bytes(bytes);
            if *repeat {
                bench.bytes(&frame);
            }
            bench.run(ms(5));
        }
        bench.run(ms(400));
        prop_assert_eq!(bench.state(), GatewayState::Fault);
        for sent in &bench.sent {
            if let ControlMessage::Cyclic(command) = sent.message {
                let age = sent.at.saturating_since(from);
                let rests = command.axes.iter().all(|axis| axis.speed() == SpeedCounts::ZERO);
                prop_assert!(rests || age < STOP_AFTER, "{:?}", sent);
            }
        }
    }
}

#[test]
fn the_properties_are_tried_on_arms_that_move() {
    // The events above reach motion: otherwise the properties would prove nothing.
    let mut watched = Watched::new(WireFormat::BigEndian6x10);
    watched.happen(&Happening::Up);
    assert_eq!(watched.bench.state(), GatewayState::Moving);
    assert!(watched.last.is_some_and(
        |sent| matches!(sent.message, ControlMessage::Cyclic(command) if command.axes[6].speed().0 > 3000)
    ));
}
