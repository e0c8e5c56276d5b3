//! The gateway between host and controller: faults of the arm, resets, operations, measurements, counters.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, Axis, AxisCommand, COUNTS_PER_TURN, CommAlarm, CommWord, ControlMessage, Letter, ServoAlarm,
    ServoWord, Signal, StatusSignals, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, DriveMode, FaultReport, GatewayMessage, GatewayState, Health, HostMessage, RejectReason,
    StopCause,
};
use pb3dp_arm_pa10_test_support::gateway_bench as bench;
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, config, control, hello, ms, rejected, velocity};
use pb3dp_kinematics::JointVector;

fn faults(bench: &Bench) -> Vec<FaultReport> {
    let report =
        |message: &GatewayMessage| if let GatewayMessage::Fault(report) = message { Some(*report) } else { None };
    bench.messages.iter().filter_map(|(_, message)| report(message)).collect()
}

#[test]
fn every_alarm_stops_the_arm_and_is_reported_once_with_axis_and_status_word() {
    use GatewayState::{EmergencyStop, Fault};
    let of_axis = ServoAlarm::LISTED.iter().map(|alarm| {
        let stops = matches!(alarm, ServoAlarm::EmergencyStop | ServoAlarm::DeadManOff | ServoAlarm::LimitSwitch);
        (Some(Axis::ALL[4]), u16::from(alarm.code()) << 4 | 1, stops)
    });
    let of_arm = CommAlarm::LISTED.iter().map(|alarm| {
        let stops = matches!(alarm, CommAlarm::EmergencyStop | CommAlarm::DeadManOff | CommAlarm::LimitSwitch);
        (None, u16::from(alarm.code()) << 4 | 4, stops)
    });
    for (axis, word, is_emergency_stop) in of_axis.chain(of_arm).chain([(Some(Axis::ALL[4]), 0x0550, false)]) {
        for state_before in [GatewayState::Started, GatewayState::Moving, GatewayState::Stopping] {
            let mut bench = Bench::new();
            bench.lead_to(state_before);
            match axis {
                Some(axis) => bench.controller.servo[axis.index()] = ServoWord(word),
                None => bench.controller.comm = CommWord(word),
            }
            bench.run(ms(5));
            let cause = match axis {
                _ if is_emergency_stop => StopCause::EmergencyStop,
                Some(_) => StopCause::ServoAlarm,
                None => StopCause::ControllerAlarm,
            };
            let state = if is_emergency_stop { EmergencyStop } else { Fault };
            assert_eq!((bench.state(), bench.cause()), (state, cause), "{word:04x} {state_before}");
            bench.run(ms(400));
            let report = FaultReport { cause, state_before, axis, word };
            assert_eq!((faults(&bench), bench.gateway.status().found), (vec![report], Some(report)));
            assert!(bench.gateway.is_at_rest());
            // A latched cause is not replaced by a later one.
            bench.controller.comm = CommWord(0x0030);
            bench.run(ms(10));
            assert_eq!((bench.cause(), bench.gateway.status().found), (cause, Some(report)));
            bench.controller.servo = [ServoWord(0); 7];
            bench.controller.comm = CommWord(1);
            bench.ask(control(ArmOperation::Reset));
            assert_eq!((bench.cause(), bench.gateway.status().found), (StopCause::None, None));
        }
    }
}

#[test]
fn a_fault_is_logged_with_axis_and_meaning_of_its_status_word() {
    let report = |cause, axis, word| FaultReport { cause, state_before: GatewayState::Moving, axis, word }.to_string();
    let e1 = Some(Axis::ALL[3]);
    for (found, text) in [
        (
            report(StopCause::ServoAlarm, e1, 0x00E0),
            "servo-alarm: axis 4 (E1), status word 0x00e0, alarm 0x0e (over-current)",
        ),
        (
            report(StopCause::AxisUncontrollable, e1, 0xC000),
            "axis-uncontrollable: axis 4 (E1), status word 0xc000, uncontrollable, power off",
        ),
        (
            report(StopCause::ControllerAlarm, None, 0x0065),
            "controller-alarm: controller, status word 0x0065, alarm 0x06 (temperature of the power supply)",
        ),
        (report(StopCause::EmergencyStop, None, 0x0009), "emergency-stop: controller, status word 0x0009"),
        (
            report(StopCause::AxisUncontrollable, None, 0xC000),
            "axis-uncontrollable: controller, status word 0xc000, uncontrollable",
        ),
        (report(StopCause::HostFault, None, 0), "host-fault"),
        (report(StopCause::HostSilent, None, 0), "host-silent"),
    ] {
        assert_eq!(found, text);
    }
}

#[test]
fn switches_count_as_the_configuration_says() {
    for (bits, expected) in [("unknown", StopCause::None), ("controller 0x0008 set", StopCause::EmergencyStop)] {
        let base_config = config(WireFormat::BigEndian6x10);
        let signals = base_config.signals.with(Signal::EmergencyStop, bits.parse().unwrap());
        let base_config = GatewayConfig { signals, ..base_config };
        let mut bench = Bench::greeted(base_config);
        bench.start();
        bench.controller.comm = CommWord(0x0009);
        bench.run(ms(5));
        assert_eq!(bench.cause(), expected);
    }
}

#[test]
fn an_axis_without_power_stops_the_arm_where_brakes_are_open() {
    for (state, word, expected) in [
        (GatewayState::Started, 0x8000, StopCause::None),
        (GatewayState::Holding, 0x8000, StopCause::AxisUncontrollable),
        (GatewayState::Moving, 0x4000, StopCause::AxisUncontrollable),
    ] {
        let mut bench = Bench::new();
        bench.lead_to(state);
        bench.controller.servo[6] = ServoWord(word);
        bench.run(ms(4));
        assert_eq!(bench.cause(), expected, "{state}");
        if expected != StopCause::None {
            assert_eq!(faults(&bench)[0].axis, Some(Axis::ALL[6]));
            assert_eq!(faults(&bench)[0].word, word);
        }
    }
}

/// The servo would not hold the axis when the brake opens; the controller may also report this of the whole arm.
#[test]
fn brakes_do_not_open_on_an_arm_that_is_uncontrollable() {
    let refused = (RejectReason::CausePresent, u32::from(StopCause::AxisUncontrollable.code()));
    let mut bench = Bench::greeted(config(WireFormat::BigEndian6x10));
    bench.start();
    bench.controller.servo[1] = ServoWord(0x8000);
    bench.run(ms(4));
    let open = bench.command(DriveMode::Follow, JointVector::zeros());
    assert_eq!(rejected(bench.ask(open)), refused);
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Started, StopCause::None));
    bench.controller.servo[1] = ServoWord(0);
    bench.controller.comm = CommWord(0x4001);
    bench.run(ms(4));
    assert_eq!(rejected(bench.ask(open)), refused);
    bench.controller.comm = CommWord(1);
    bench.run(ms(4));
    bench.ask(open);
    assert_eq!(bench.state(), GatewayState::Holding);
    bench.controller.comm = CommWord(0x4001);
    bench.run(ms(4));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::AxisUncontrollable));
    assert_eq!((faults(&bench)[0].axis, faults(&bench)[0].word), (None, 0x4001));
}

/// START is answered by the first measurement: until then no command is followed.
#[test]
fn brakes_do_not_open_on_an_arm_that_was_never_measured() {
    for format in WireFormat::ALL {
        let mut bench = Bench::greeted(config(format));
        // Once after the start of the gateway, and once with a measurement from before.
        for _ in 0..2 {
            bench.controller.servo[3] = ServoWord(0x8000);
            bench.sent.clear();
            bench.tell(control(ArmOperation::Start));
            while bench.state() != GatewayState::Started {
                bench.tick();
            }
            // No measurement comes before the command.
            bench.controller.drop_next = 1;
            let open = bench.command(DriveMode::Follow, JointVector::zeros());
            let started = u32::from(GatewayState::Started.code());
            assert_eq!(rejected(bench.ask(open)), (RejectReason::WrongState, started));
            bench.run(ms(10));
            let refused = (RejectReason::CausePresent, u32::from(StopCause::AxisUncontrollable.code()));
            assert_eq!(rejected(bench.ask(open)), refused);
            let opens = |sent: &bench::Sent| matches!(sent.message, ControlMessage::Cyclic(command) if matches!(command.axes[3], AxisCommand::Speed(_)));
            assert!(!bench.sent.iter().any(opens), "{:?}", bench.sent);
            bench.controller.servo[3] = ServoWord(0);
            bench.run(ms(6));
            bench.ask(open);
            assert_eq!(bench.state(), GatewayState::Holding);
            bench.tell(control(ArmOperation::Stop));
            bench.run(ms(500));
            assert_eq!(bench.state(), GatewayState::Idle);
        }
    }
}

#[test]
fn unknown_status_words_are_passed_on_and_no_brake_opens() {
    let base_config = GatewayConfig { signals: StatusSignals::UNKNOWN, ..config(WireFormat::LittleEndian5x8) };
    let mut bench = Bench::greeted(base_config);
    bench.start();
    bench.controller.servo[2] = ServoWord(0x0110);
    bench.controller.comm = CommWord(0xFFFF);
    bench.run(ms(20));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Started, StopCause::None));
    if let GatewayMessage::State(state) = bench.ask(bench.command(DriveMode::Off, JointVector::zeros())) {
        assert_eq!((state.axes[2].status, state.comm), (0x0110, 0xFFFF));
        assert!(!state.has_speeds && !state.has_documented_status);
    }
    let open = bench.command(DriveMode::Follow, JointVector::zeros());
    let refused = (RejectReason::CausePresent, u32::from(StopCause::AxisUncontrollable.code()));
    assert_eq!(rejected(bench.ask(open)), refused);
}

#[test]
fn known_bits_of_format_a_stop_the_arm() {
    for (comm, servo, cause, shown) in [
        (0x0009, 0, StopCause::EmergencyStop, (None, 0x0009)),
        (0x2001, 0, StopCause::EmergencyStop, (None, 0x2001)),
        (0x0010, 0, StopCause::EmergencyStop, (None, 0x0010)),
        (0x0001, 0x8000, StopCause::AxisUncontrollable, (Some(Axis::ALL[2]), 0x8000)),
    ] {
        let mut bench = Bench::greeted(config(WireFormat::LittleEndian5x8));
        bench.lead_to(GatewayState::Moving);
        (bench.controller.servo[2], bench.controller.comm) = (ServoWord(servo), CommWord(comm));
        bench.run(ms(4));
        assert_eq!(bench.cause(), cause, "0x{comm:04x}");
        assert_eq!((faults(&bench)[0].axis, faults(&bench)[0].word), shown);
    }
}

#[test]
fn a_reply_that_makes_no_sense_stops_the_arm() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    bench.controller.lies_about_format = true;
    bench.run(ms(4));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::ReplyUnusable));
    let GatewayMessage::HelloReply(reply) = bench.ask(hello()) else { panic!() };
    assert_eq!(reply.wire_format, Some(WireFormat::LittleEndian5x8));

    // Two turns are accepted, one count more is not. The angle of the seventh axis is seven times that of the first.
    for (counts, expected) in [(2 * COUNTS_PER_TURN / 7, StopCause::None), (i32::MIN, StopCause::ReplyUnusable)] {
        let mut bench = Bench::new();
        bench.start();
        bench.controller.angle = AngleCounts(counts);
        bench.run(ms(5));
        assert_eq!(bench.cause(), expected, "{counts}");
    }
}

#[test]
fn a_reset_needs_a_controller_that_shows_that_the_cause_is_gone() {
    for state in [GatewayState::Fault, GatewayState::EmergencyStop] {
        let mut bench = Bench::new();
        bench.lead_to(state);
        let cause = bench.cause();
        // The same cause or another one is present.
        for (servo, comm, found) in [
            (0x00E0, 0, StopCause::ServoAlarm),
            (0, 0x0110, StopCause::EmergencyStop),
            (0, 0x0030, StopCause::ControllerAlarm),
        ] {
            (bench.controller.servo[0], bench.controller.comm) = (ServoWord(servo), CommWord(comm));
            bench.sent.clear();
            let answer = bench.ask(control(ArmOperation::Reset));
            assert_eq!(rejected(answer), (RejectReason::CausePresent, found.code().into()));
            assert_eq!((bench.state(), bench.cause(), bench.letters().as_str()), (state, cause, "SCE"));
        }
        (bench.controller.servo[0], bench.controller.comm) = (ServoWord(0), CommWord(1));
        // A controller that does not answer one of the three letters, and one with another format.
        for letter in [Letter::Start, Letter::Cyclic, Letter::End] {
            bench.controller.deaf_to = vec![letter];
            let asked = bench.now;
            assert_eq!(rejected(bench.ask(control(ArmOperation::Reset))), (RejectReason::NoAnswer, 0), "{letter:?}");
            assert!(bench.now.saturating_since(asked) <= ms(50));
            assert_eq!((bench.state(), bench.cause()), (state, cause));
            bench.sent.clear();
            bench.run(ms(60));
            let rest = bench.letters().trim_start_matches('E').to_owned();
            assert_eq!(rest.is_empty(), letter != Letter::End, "E is sent whatever failed: {rest}");
            // An E without an answer may not have arrived.
            assert!(bench.sent.iter().all(|sent| match sent.message {
                ControlMessage::Cyclic(command) => command.axes == [AxisCommand::Braked; 7],
                message => message == ControlMessage::End,
            }));
        }
        bench.controller.deaf_to.clear();
        bench.run(ms(220));
        assert!(bench.gateway.is_at_rest());
        bench.controller.lies_about_format = true;
        let found = StopCause::ReplyUnusable.code().into();
        assert_eq!(rejected(bench.ask(control(ArmOperation::Reset))), (RejectReason::CausePresent, found));
        bench.controller.lies_about_format = false;
        assert!(matches!(bench.ask(control(ArmOperation::Reset)), GatewayMessage::ControlReply(_)));
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
        bench.lead_to(GatewayState::Moving);
    }
}

#[test]
fn before_the_stop_order_is_done_nothing_is_reset_or_read() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    bench.gateway.handle_host_gone(bench.now);
    bench.ask(hello());
    let axis = Axis::ALL[0];
    for asked in [control(ArmOperation::Reset), HostMessage::Control(Control::ClearAlarm(axis))] {
        assert_eq!(rejected(bench.ask(asked)), (RejectReason::WrongState, GatewayState::Fault.code().into()));
    }
    assert!(matches!(bench.ask(control(ArmOperation::Stop)), GatewayMessage::ControlReply(_)));
    bench.run(ms(400));
    assert!(matches!(bench.ask(control(ArmOperation::Reset)), GatewayMessage::ControlReply(_)));
}

#[test]
fn a_stop_cuts_short_what_is_under_way() {
    // While S is in progress.
    let mut bench = Bench::new();
    bench.controller.delay = ms(4);
    let start = bench.tell(control(ArmOperation::Start));
    bench.run(ms(2));
    let stop = bench.tell(control(ArmOperation::Stop));
    bench.run(ms(60));
    assert_eq!((bench.state(), bench.letters().as_str()), (GatewayState::Idle, "SE"));
    let answers = bench.messages.iter().rev().take(2).map(|(frame, message)| (frame.sequence, *message));
    let answers = answers.collect::<Vec<_>>();
    assert_eq!((answers[1].0, answers[0].0), (start, stop));
    assert_eq!(rejected(answers[1].1), (RejectReason::WrongState, GatewayState::Stopping.code().into()));
    // While a reset checks the arm.
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Fault);
    bench.sent.clear();
    let reset = bench.tell(control(ArmOperation::Reset));
    bench.run(ms(2));
    assert!(matches!(bench.ask(control(ArmOperation::Stop)), GatewayMessage::ControlReply(_)));
    bench.run(ms(60));
    assert_eq!((bench.state(), bench.letters().as_str()), (GatewayState::Fault, "SE"));
    let answer = bench.messages.iter().find(|(frame, _)| frame.sequence == reset).unwrap();
    assert_eq!(rejected(answer.1).0, RejectReason::WrongState);
}

#[test]
fn a_start_that_nobody_answers_is_ended() {
    let mut bench = Bench::new();
    bench.controller.deaf_to = vec![Letter::Start];
    assert_eq!(rejected(bench.ask(control(ArmOperation::Start))), (RejectReason::NoAnswer, 0));
    bench.run(ms(10));
    assert_eq!((bench.state(), bench.letters().as_str()), (GatewayState::Idle, "SE"));
    assert!(bench.gateway.is_at_rest());
    // A letter that the controller does not support is not a fault.
    bench.controller.deaf_to = vec![Letter::ClearAlarm];
    let asked = bench.ask(HostMessage::Control(Control::ClearAlarm(Axis::ALL[1])));
    assert_eq!(rejected(asked), (RejectReason::NoAnswer, 0));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
    // An end without an answer means that the controller is silent.
    bench.start();
    bench.controller.deaf_to = vec![Letter::End];
    assert_eq!(rejected(bench.ask(control(ArmOperation::End))), (RejectReason::NoAnswer, 0));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::ControllerSilent));
}

#[test]
fn one_operation_at_a_time() {
    let mut bench = Bench::new();
    bench.controller.delay = ms(5);
    let first = bench.tell(control(ArmOperation::Start));
    bench.run(ms(2));
    for other in [control(ArmOperation::Start), HostMessage::Control(Control::ReadEeprom(Axis::ALL[0]))] {
        assert_eq!(rejected(bench.ask(other)), (RejectReason::WrongState, 0));
    }
    bench.controller.delay = ms(1);
    bench.run(ms(30));
    let answer = bench.messages.iter().find(|(frame, _)| frame.sequence == first).unwrap().1;
    assert!(matches!(answer, GatewayMessage::ControlReply(reply) if reply.state == GatewayState::Started));
}

#[test]
fn a_command_before_the_first_measurement_is_not_answered_with_an_old_one() {
    let mut bench = Bench::new();
    bench.start();
    assert!(matches!(bench.ask(control(ArmOperation::End)), GatewayMessage::ControlReply(_)));
    bench.controller.deaf_to = vec![Letter::Cyclic];
    let start = bench.tell(control(ArmOperation::Start));
    bench.run(ms(3));
    assert_eq!(bench.state(), GatewayState::Started);
    let command = bench.command(DriveMode::Off, JointVector::zeros());
    assert_eq!(rejected(bench.ask(command)).0, RejectReason::WrongState);
    bench.run(ms(10));
    assert_eq!(bench.cause(), StopCause::ControllerSilent);
    let answer = bench.messages.iter().find(|(frame, _)| frame.sequence == start).unwrap().1;
    assert_eq!(rejected(answer), (RejectReason::NoAnswer, 0));
    assert_eq!(rejected(bench.ask(command)), (RejectReason::NoAnswer, 0));
}

#[test]
fn a_state_carries_what_was_measured_and_when() {
    let mut bench = Bench::new();
    bench.start();
    bench.controller.angle = AngleCounts(102_400);
    bench.controller.servo[1] = ServoWord(0x0002);
    bench.run(ms(4));
    while bench.gateway.next_deadline() > bench.now + ms(1) {
        bench.tick();
    }
    let GatewayMessage::State(state) = bench.ask(bench.command(DriveMode::Off, JointVector::zeros())) else { panic!() };
    assert_eq!(state.axes[0].angle_urad, 785_398);
    assert_eq!(state.axes[2].angle_urad, 2_356_194);
    assert_eq!((state.axes[1].status, state.axes[3].speed_urad_per_s), (0x0002, 600));
    // -3 counts of 50 * 4.64 / 4096 N m.
    assert_eq!(state.axes[0].torque_mn_m, -170);
    assert!((500..=1500).contains(&state.sample_age_us), "{}", state.sample_age_us);
    // The age grows while the message waits in the output.
    let frame = bench.frame_of(&bench.command(DriveMode::Off, JointVector::zeros()));
    bench.gateway.handle_host_bytes(bench.now, &frame.encode());
    bench.now = bench.now + ms(7);
    bench.tick();
    let answer = bench.messages.iter().find(|(answer, _)| answer.sequence == frame.sequence).unwrap();
    let GatewayMessage::State(later) = answer.1 else { panic!() };
    assert!((7000..=8500).contains(&later.sample_age_us), "{}", later.sample_age_us);
}

#[test]
fn speeds_go_on_a_straight_line_within_one_cycle_of_the_host() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Holding);
    let command = bench.command(DriveMode::Follow, velocity());
    bench.sent.clear();
    bench.ask(command);
    let stopped_at = bench.now;
    bench.run(ms(18));
    for sent in &bench.sent {
        let ControlMessage::Cyclic(command) = sent.message else { panic!() };
        let part = (sent.at.saturating_since(stopped_at).as_secs_f64() / 0.010).min(1.0);
        assert!((command.velocity_rad_per_s() - velocity() * part).amax() <= 1.01e-4, "{sent:?}");
    }
}

fn command_of(bench: &Bench, velocity: JointVector) -> HostMessage {
    bench.command(DriveMode::Follow, velocity)
}

#[test]
fn speeds_are_rounded_to_the_nearest_count_and_neither_clamped_nor_wrapped() {
    let plain = GatewayConfig { interpolates: false, ..config(WireFormat::LittleEndian5x8) };
    let mut bench = Bench::greeted(plain);
    bench.lead_to(GatewayState::Holding);
    let speeds = [-6.5536, 6.5534, 0.00009, 0.00011, -0.00029, -0.00031, 0.2];
    bench.tell(command_of(&bench, JointVector::from(speeds)));
    bench.run(ms(3));
    let ControlMessage::Cyclic(command) = bench.sent.last().unwrap().message else { panic!() };
    let counts = command.axes.map(|axis| axis.speed().0);
    assert_eq!(counts, [i16::MIN, i16::MAX, 0, 1, -1, -2, 1000]);
}

#[test]
fn health_counts_what_happened() {
    let mut bench = Bench::silent(config(WireFormat::BigEndian6x10));
    assert!(matches!(bench.ask(hello()), GatewayMessage::HelloReply(_)));
    bench.lead_to(GatewayState::Moving);
    bench.controller.drop_next = 1;
    bench.run(ms(2));
    bench.controller.sequence_error = 50;
    bench.run(ms(2));
    bench.controller.sequence_error = 0;
    bench.command_for(DriveMode::Follow, velocity(), ms(10));
    bench.bytes(&[0xA5, 0x5A, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7]);
    bench.sequence += 3;
    bench.ask(HostMessage::Heartbeat);
    let repeated = HostMessage::Heartbeat.frame(bench::ARM, bench.sequence, 0);
    bench.ask_frame(&repeated);
    bench.now = bench.gateway.next_deadline() + ms(1);
    bench.tick();
    let GatewayMessage::Health(health) = bench.ask(HostMessage::Heartbeat) else { panic!() };
    let expected = Health {
        state: GatewayState::Moving,
        cause: StopCause::None,
        exchanges: health.exchanges,
        replies_lost: 2,
        replies_late: 0,
        replies_mismatched: 1,
        overruns: 1,
        worst_cycle_us: 3000,
        host_damaged: 1,
        host_lost: 3,
        host_stale: 1,
    };
    assert_eq!(health, expected);
    assert!(u64::from(health.exchanges) >= 100 && u64::from(health.exchanges) == bench.gateway.status().bus.exchanges);
    // The longest cycle since the last HEALTH.
    bench.command_for(DriveMode::Follow, velocity(), ms(10));
    let GatewayMessage::Health(health) = bench.ask(HostMessage::Heartbeat) else { panic!() };
    assert_eq!((health.worst_cycle_us, health.overruns), (2000, 1));
}

#[test]
fn numbers_of_the_bus_count_up_by_one() {
    use pb3dp_arm_pa10_protocol::codec::SequenceModulus::{Modulo128, Modulo256};
    for (modulus, last) in [(Modulo128, 0x7F), (Modulo256, 0xFF)] {
        let counting = GatewayConfig { modulus, ..config(WireFormat::BigEndian6x10) };
        let mut bench = Bench::greeted(counting);
        bench.lead_to(GatewayState::Fault);
        assert!(bench.sent.len() > 200);
        for pair in bench.sent.windows(2) {
            let expected = if pair[0].sequence == last { 0 } else { pair[0].sequence + 1 };
            assert_eq!(pair[1].sequence, expected);
        }
    }
}

#[test]
fn brakes_wait_until_the_speeds_that_are_sent_are_0() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    bench.ask(bench.command(DriveMode::Follow, JointVector::zeros()));
    assert_eq!(bench.state(), GatewayState::Holding);
    bench.run(ms(4));
    for mode in [DriveMode::Off, DriveMode::Braked] {
        assert_eq!(rejected(bench.ask(bench.command(mode, JointVector::zeros()))), (RejectReason::WrongState, 2));
    }
    bench.run(ms(8));
    assert!(matches!(bench.ask(bench.command(DriveMode::Braked, JointVector::zeros())), GatewayMessage::State(_)));
    assert_eq!(bench.state(), GatewayState::Started);
}
