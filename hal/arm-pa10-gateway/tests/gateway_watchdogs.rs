//! The watchdogs and the stop order of the gateway, in virtual time, as docs/arm-protocol.md specifies them.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig, GatewayConfigError};
use pb3dp_arm_pa10_protocol::codec::{AxisCommand, ControlMessage, Letter, SpeedCounts, WireFormat};
use pb3dp_arm_pa10_protocol::codec::{Signal, SignalSource};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, DriveMode, FaultReport, GatewayMessage, GatewayState, HostMessage, RejectReason, StopCause,
};
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_arm_pa10_test_support::gateway_bench as bench;
use pb3dp_arm_pa10_test_support::gateway_bench::{
    Bench, CYCLE, HOST_CYCLE, Sent, TICK, config, control, hello, ms, rejected, velocity,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

/// Moving at the given speeds.
fn moving() -> Bench {
    let plain = GatewayConfig { interpolates: false, ..config(WireFormat::BigEndian6x10) };
    let mut bench = Bench::greeted(plain);
    bench.lead_to(GatewayState::Moving);
    bench
}

/// Kind of a cyclic message: off, braked, rest or motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Off,
    Braked,
    Rest,
    Motion,
    Letter(Letter),
}

fn kind(sent: &Sent) -> Kind {
    let ControlMessage::Cyclic(command) = sent.message else { return Kind::Letter(sent.message.letter()) };
    match command.axes {
        axes if axes == [AxisCommand::Off; 7] => Kind::Off,
        axes if axes == [AxisCommand::Braked; 7] => Kind::Braked,
        axes if axes == [AxisCommand::Speed(SpeedCounts::ZERO); 7] => Kind::Rest,
        axes if axes.iter().all(|axis| matches!(axis, AxisCommand::Speed(_))) => Kind::Motion,
        axes => panic!("{axes:?}"),
    }
}

/// Sent messages, with runs of the same kind combined.
fn runs(sent: &[Sent]) -> Vec<(Kind, usize)> {
    let mut runs: Vec<(Kind, usize)> = Vec::new();
    for kind in sent.iter().map(kind) {
        match runs.last_mut() {
            Some((last, count)) if *last == kind => *count += 1,
            _ => runs.push((kind, 1)),
        }
    }
    runs
}

fn speed_of_axis_7(sent: &Sent) -> f64 {
    let ControlMessage::Cyclic(command) = sent.message else { panic!("{sent:?}") };
    command.axes[6].speed().to_rad_per_s()
}

fn faults(bench: &Bench) -> Vec<FaultReport> {
    let report =
        |message: &GatewayMessage| if let GatewayMessage::Fault(report) = message { Some(*report) } else { None };
    bench.messages.iter().filter_map(|(_, message)| report(message)).collect()
}

#[test]
fn a_command_whose_successor_stays_away_fades_and_stops() {
    let mut bench = moving();
    let command = bench.command(DriveMode::Follow, velocity());
    bench.ask(command);
    let stopped_at = bench.now;
    bench.sent.clear();
    bench.run(ms(400));
    for sent in bench.sent.iter().filter(|sent| sent.message.letter() == Letter::Cyclic) {
        let age = sent.at.saturating_since(stopped_at).as_secs_f64();
        let part = ((0.050 - age) / 0.030).clamp(0.0, 1.0);
        let got = if kind(sent) == Kind::Motion { speed_of_axis_7(sent) } else { 0.0 };
        assert!((got - 0.7 * part).abs() <= 1.01e-4, "{age} s: {got} instead of {}", 0.7 * part);
        if age < 0.050 {
            assert_eq!(sent.state, GatewayState::Moving);
        } else {
            assert_eq!((sent.state, kind(sent) != Kind::Motion), (GatewayState::Fault, true), "{age}");
        }
    }
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostSilent));
    let runs = runs(&bench.sent);
    assert_eq!(runs[1..], [(Kind::Rest, 5), (Kind::Braked, 101), (Kind::Off, 1), (Kind::Letter(Letter::End), 1)]);
    let reported =
        FaultReport { cause: StopCause::HostSilent, state_before: GatewayState::Moving, axis: None, word: 0 };
    assert_eq!(faults(&bench), [reported]);
}

#[test]
fn a_host_that_comes_back_in_time_is_followed_again() {
    let mut bench = moving();
    bench.run(ms(38));
    assert_eq!(bench.state(), GatewayState::Moving);
    let command = bench.command(DriveMode::Follow, velocity());
    let GatewayMessage::State(state) = bench.ask(command) else { panic!() };
    assert!(state.is_ramping);
    bench.run(ms(12));
    assert!((speed_of_axis_7(bench.sent.last().unwrap()) - 0.7).abs() < 1e-9);
    let GatewayMessage::State(state) = bench.ask(command) else { panic!() };
    assert!(!state.is_ramping);
}

#[test]
fn holding_without_commands_is_a_silent_host_and_a_heartbeat_is_no_command() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Holding);
    for _ in 0..6 {
        bench.ask(HostMessage::Heartbeat);
        bench.run(ms(9));
    }
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostSilent));
}

#[test]
fn started_lasts_as_long_as_the_host_shows_that_it_is_there() {
    let mut bench = Bench::new();
    bench.start();
    for _ in 0..20 {
        bench.ask(HostMessage::Heartbeat);
        bench.run(ms(250));
    }
    assert_eq!(bench.state(), GatewayState::Started);
    // Damaged and repeated frames do not show that the host is alive, a refused valid message does.
    let repeated = HostMessage::Heartbeat.frame(bench::ARM, bench.sequence, 0);
    bench.run(ms(500));
    assert_eq!(rejected(bench.ask_frame(&repeated)).0, RejectReason::Stale);
    bench.bytes(&[0xA5, 0x5A, 1, 2, 4]);
    bench.run(ms(200));
    assert_eq!(rejected(bench.ask(bench.command(DriveMode::Follow, velocity()))).0, RejectReason::WrongState);
    bench.run(ms(990));
    assert_eq!(bench.state(), GatewayState::Started);
    bench.sent.clear();
    bench.run(ms(30));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
    assert_eq!(bench.letters().trim_start_matches('C'), "E");
    assert_eq!(rejected(bench.ask(HostMessage::Heartbeat)), (RejectReason::NotConnected, 0));
    assert_eq!(faults(&bench), []);
}

#[test]
fn two_lost_replies_are_tolerated_and_the_third_stops_the_arm() {
    for lost in 0..=2 {
        let mut bench = moving();
        bench.controller.drop_next = lost;
        bench.command_for(DriveMode::Follow, velocity(), ms(30));
        assert_eq!(bench.state(), GatewayState::Moving);
        assert_eq!(bench.gateway.status().bus.lost, u64::from(lost));
    }
    for (lost_from, state) in [(GatewayState::Started, 0), (GatewayState::Holding, 1), (GatewayState::Moving, 2)] {
        let mut bench = Bench::new();
        bench.lead_to(lost_from);
        bench.sent.clear();
        bench.controller.answers = false;
        while bench.sent.is_empty() {
            bench.tick();
        }
        let first = bench.sent[0].at;
        while bench.state() == lost_from {
            bench.tick();
        }
        let after = bench.now.saturating_since(first).saturating_sub(TICK);
        assert_eq!(after, CYCLE * 3, "{state}");
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::ControllerSilent));
        // The order advances by time until the brakes are closed: servos off and E need a controller that has received this.
        bench.run(ms(500));
        let count = |wanted: Kind| bench.sent.iter().filter(|sent| kind(sent) == wanted).count();
        let brakes_acknowledged = lost_from == GatewayState::Started;
        assert_eq!(count(Kind::Letter(Letter::End)), if brakes_acknowledged { 3 } else { 0 });
        assert_eq!(count(Kind::Off) > 0, brakes_acknowledged);
        assert_eq!(kind(bench.sent.last().unwrap()), Kind::Braked);
        assert!(!bench.gateway.is_at_rest() && bench.gateway.status().stop_unacknowledged);
        // The order is repeated until the controller answers, and the brake time counts from there.
        bench.sent.clear();
        bench.run(ms(5000));
        assert!(bench.sent.len() >= 2499 && bench.sent.iter().all(|sent| kind(sent) == Kind::Braked));
        bench.controller.answers = true;
        bench.sent.clear();
        bench.run(ms(220));
        assert_eq!(runs(&bench.sent)[1..], [(Kind::Off, 1), (Kind::Letter(Letter::End), 1)]);
        assert!((101..=102).contains(&runs(&bench.sent)[0].1), "{:?}", runs(&bench.sent));
        assert!(bench.gateway.is_at_rest() && !bench.gateway.status().stop_unacknowledged);
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::ControllerSilent));
    }
}

#[test]
fn replies_with_other_numbers_and_late_ones_are_counted_and_not_used() {
    let mut bench = moving();
    bench.controller.sequence_error = 64;
    bench.run(ms(10));
    assert_eq!(bench.cause(), StopCause::ControllerSilent);
    assert!(bench.gateway.status().bus.mismatched >= 3, "{:?}", bench.gateway.status().bus);

    let mut bench = moving();
    bench.controller.delay = ms(3);
    bench.run(ms(10));
    assert_eq!(bench.cause(), StopCause::ControllerSilent);
    let bus = bench.gateway.status().bus;
    assert!(bus.late >= 3 && bus.lost >= 3 && bus.mismatched == 0, "{bus:?}");
}

/// A number that is far away from the newest one is no late reply, wherever the numbers stand.
#[test]
fn a_reply_with_a_distant_number_is_never_counted_as_late() {
    for wait in [ms(0), ms(40), ms(80), ms(120)] {
        let mut bench = moving();
        bench.command_for(DriveMode::Follow, velocity(), wait);
        bench.controller.sequence_error = 64;
        bench.run(ms(10));
        let bus = bench.gateway.status().bus;
        assert!(bus.late == 0 && bus.mismatched >= 3, "{wait:?}: {bus:?}");
    }
}

/// A cycle that begins a little late does not move the next ones.
#[test]
fn cycles_keep_their_phase() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    let due = bench.gateway.next_deadline();
    bench.now = due + ms(1);
    let from = bench.sent.len();
    bench.run(ms(6));
    let times: Vec<_> = bench.sent[from..].iter().map(|sent| sent.at.saturating_since(due)).collect();
    assert_eq!(times, [ms(1), ms(2), ms(4), ms(6)]);
}

/// Missed cycles are skipped, not made up for.
#[test]
fn after_missed_cycles_the_next_one_comes_one_cycle_later() {
    let tolerant = GatewayConfig { lateness_allowed: ms(40), ..config(WireFormat::BigEndian6x10) };
    let mut bench = Bench::greeted(tolerant);
    bench.lead_to(GatewayState::Moving);
    bench.now = bench.gateway.next_deadline() + ms(15);
    let from = bench.sent.len();
    bench.run(ms(8));
    let sent = &bench.sent[from..];
    assert_eq!(sent.len(), 4);
    for pair in sent.windows(2) {
        assert_eq!(pair[1].at.saturating_since(pair[0].at), CYCLE);
    }
}

#[test]
fn a_cycle_that_begins_one_cycle_late_stops_the_arm() {
    for state in [GatewayState::Started, GatewayState::Holding, GatewayState::Moving, GatewayState::Stopping] {
        for (late_us, trips) in [(1_900, false), (2_000, true), (40_000, true)] {
            let mut bench = Bench::new();
            bench.lead_to(state);
            let overruns = bench.gateway.status().cycle.overruns;
            bench.now = bench.gateway.next_deadline() + Duration::from_micros(late_us);
            bench.tick();
            let status = bench.gateway.status();
            assert_eq!(status.cycle.overruns, overruns + 1);
            assert_eq!(status.cause == StopCause::CycleMissed, trips, "{state}, {late_us} us: {status:?}");
            assert!(status.cycle.worst >= Duration::from_micros(late_us));
        }
    }
    // Without a cycle nothing is late.
    let mut bench = Bench::new();
    bench.now = bench.now + ms(300);
    bench.tick();
    assert_eq!(bench.state(), GatewayState::Idle);
    // A machine without real time may be configured with a higher tolerance.
    let tolerant = GatewayConfig { lateness_allowed: ms(40), ..config(WireFormat::BigEndian6x10) };
    let mut bench = Bench::greeted(tolerant);
    bench.lead_to(GatewayState::Moving);
    bench.now = bench.gateway.next_deadline() + ms(15);
    bench.tick();
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Moving, StopCause::None));
}

#[test]
fn the_stop_order_ramps_rests_brakes_and_ends() {
    let mut bench = moving();
    bench.sent.clear();
    let answer = bench.ask(control(ArmOperation::Stop));
    assert!(matches!(answer, GatewayMessage::ControlReply(reply) if reply.state == GatewayState::Stopping));
    let stopped_at = bench.now;
    bench.run(ms(10));
    // A second stop order changes nothing.
    assert!(matches!(bench.ask(control(ArmOperation::Stop)), GatewayMessage::ControlReply(_)));
    bench.run(ms(390));
    for sent in bench.sent.iter().filter(|sent| sent.message.letter() == Letter::Cyclic) {
        let left = 1.0 - sent.at.saturating_since(stopped_at).as_secs_f64() / 0.030;
        let ControlMessage::Cyclic(command) = sent.message else { panic!() };
        let expected = velocity() * left.max(0.0);
        assert!((command.velocity_rad_per_s() - expected).amax() <= 1.01e-4, "{sent:?}");
    }
    let runs = runs(&bench.sent);
    assert_eq!(runs[0].0, Kind::Motion);
    assert!((14..=16).contains(&runs[0].1), "{runs:?}");
    assert_eq!(runs[1..], [(Kind::Rest, 5), (Kind::Braked, 101), (Kind::Off, 1), (Kind::Letter(Letter::End), 1)]);
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
}

#[test]
fn the_stop_order_begins_where_the_arm_is_and_never_opens_a_brake() {
    // Brakes that have been closed for long.
    let mut bench = Bench::new();
    bench.start();
    bench.sent.clear();
    bench.tell(control(ArmOperation::Stop));
    bench.run(ms(50));
    assert_eq!(runs(&bench.sent), [(Kind::Off, 1), (Kind::Letter(Letter::End), 1)]);
    // Brakes that were commanded to close a moment ago.
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Holding);
    bench.command_for(DriveMode::Braked, JointVector::zeros(), ms(20));
    assert_eq!(bench.state(), GatewayState::Started);
    bench.sent.clear();
    bench.tell(control(ArmOperation::Stop));
    bench.run(ms(300));
    let runs = runs(&bench.sent);
    assert_eq!(runs[1..], [(Kind::Off, 1), (Kind::Letter(Letter::End), 1)]);
    assert!(runs[0].0 == Kind::Braked && (85..100).contains(&runs[0].1), "{runs:?}");
}

#[test]
fn no_speed_of_a_stop_order_outlives_its_command() {
    let mut bench = moving();
    // The command is old when the stop begins.
    bench.run(ms(34));
    bench.sent.clear();
    bench.tell(control(ArmOperation::Stop));
    bench.run(ms(30));
    let moves = bench.sent.iter().filter(|sent| kind(sent) == Kind::Motion).count();
    assert!(moves <= 4, "{moves}");
}

#[test]
fn servos_do_not_let_go_before_the_brakes_hold() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Holding);
    bench.sent.clear();
    bench.command_for(DriveMode::Off, JointVector::zeros(), ms(300));
    let runs = runs(&bench.sent);
    assert_eq!((runs[0].0, runs[1].0, runs.len()), (Kind::Braked, Kind::Off, 2), "{runs:?}");
    assert!((99..=102).contains(&runs[0].1), "{runs:?}");
    // The same for E.
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Holding);
    bench.command_for(DriveMode::Off, JointVector::zeros(), ms(150));
    assert_eq!(rejected(bench.ask(control(ArmOperation::End))).0, RejectReason::WrongState);
    bench.command_for(DriveMode::Off, JointVector::zeros(), ms(100));
    assert!(matches!(bench.ask(control(ArmOperation::End)), GatewayMessage::ControlReply(_)));
    assert_eq!(bench.state(), GatewayState::Idle);
}

#[test]
fn speeds_wait_for_the_brakes() {
    let mut bench = Bench::new();
    bench.start();
    bench.command_for(DriveMode::Follow, JointVector::zeros(), ms(190));
    let command = bench.command(DriveMode::Follow, velocity());
    assert_eq!(rejected(bench.ask(command)), (RejectReason::WrongState, 2));
    bench.command_for(DriveMode::Follow, JointVector::zeros(), ms(20));
    assert!(matches!(bench.ask(command), GatewayMessage::State(_)));
}

#[test]
fn a_command_that_waited_in_a_buffer_is_refused_and_feeds_no_watchdog() {
    let mut bench = moving();
    let command = bench.command(DriveMode::Follow, velocity());
    for _ in 0..4 {
        let frame = bench.frame_of(&command);
        let late =
            pb3dp_arm_pa10_protocol::gateway_protocol::Frame { timestamp_us: frame.timestamp_us - 25_000, ..frame };
        let (reason, delay) = rejected(bench.ask_frame(&late));
        assert_eq!(reason, RejectReason::Stale);
        assert!((24_000..=25_500).contains(&delay), "{delay}");
        bench.run(HOST_CYCLE);
    }
    bench.run(ms(10));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostSilent));
    assert_eq!(bench.gateway.status().host_stale, 4);
}

#[test]
fn another_host_has_another_clock() {
    for clock_us in [0, 77, 10_000_000_000] {
        let mut bench = Bench::new();
        bench.start();
        bench.gateway.handle_host_gone(bench.now);
        bench.run(ms(20));
        (bench.host_clock_us, bench.sequence) = (clock_us, 5);
        assert!(matches!(bench.ask(hello()), GatewayMessage::HelloReply(_)));
        bench.lead_to(GatewayState::Moving);
    }
}

#[test]
fn a_host_that_is_gone_is_silent_at_once() {
    for state in [GatewayState::Holding, GatewayState::Moving] {
        let mut bench = Bench::new();
        bench.lead_to(state);
        bench.sent.clear();
        bench.gateway.handle_host_gone(bench.now);
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostSilent));
        bench.run(ms(400));
        let runs = runs(&bench.sent);
        let ramps = usize::from(state == GatewayState::Moving);
        assert_eq!(runs.len(), 4 + ramps, "{runs:?}");
        assert_eq!(runs[ramps], (Kind::Rest, 5));
        // No host received the fault, and the next host receives only answers.
        assert_eq!(faults(&bench), []);
        assert_eq!(rejected(bench.ask(control(ArmOperation::Reset))), (RejectReason::NotConnected, 0));
        let GatewayMessage::HelloReply(reply) = bench.ask(hello()) else { panic!() };
        assert_eq!((reply.state, reply.cause), (GatewayState::Fault, StopCause::HostSilent));
    }
    let mut bench = Bench::new();
    bench.start();
    bench.sent.clear();
    bench.gateway.handle_host_gone(bench.now);
    bench.run(ms(20));
    assert_eq!((bench.state(), bench.letters().as_str()), (GatewayState::Idle, "E"));
    // While S is in progress.
    let mut bench = Bench::new();
    bench.controller.delay = ms(3);
    bench.tell(control(ArmOperation::Start));
    bench.run(ms(2));
    bench.gateway.handle_host_gone(bench.now);
    bench.run(ms(30));
    assert_eq!((bench.state(), bench.letters().as_str()), (GatewayState::Idle, "SE"));
    assert!(bench.gateway.is_at_rest());
}

/// An axis falls if E disables its servo before its brake holds.
#[test]
fn a_host_that_goes_while_the_brakes_close_does_not_end_the_control_mode_before_they_hold() {
    // The line is lost, with the closing time that every gateway assumes; and silence, with slower brakes.
    for (brake_time, is_gone) in [(ms(200), true), (ms(1500), false)] {
        let mut bench = Bench::greeted(GatewayConfig { brake_time, ..config(WireFormat::BigEndian6x10) });
        bench.start();
        bench.command_for(DriveMode::Follow, JointVector::zeros(), ms(210));
        bench.ask(bench.command(DriveMode::Braked, JointVector::zeros()));
        bench.run(ms(10));
        assert_eq!(bench.state(), GatewayState::Started);
        bench.sent.clear();
        if is_gone {
            bench.gateway.handle_host_gone(bench.now);
            assert_eq!(bench.state(), GatewayState::Stopping);
        }
        bench.run(ms(2000));
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
        let runs = runs(&bench.sent);
        assert_eq!(runs[1..], [(Kind::Off, 1), (Kind::Letter(Letter::End), 1)], "{runs:?}");
        let cycles = (brake_time.as_millis() / CYCLE.as_millis()) as usize;
        assert!(runs[0].0 == Kind::Braked && (cycles - 15..cycles).contains(&runs[0].1), "{runs:?}");
        assert_eq!(rejected(bench.ask(control(ArmOperation::Start))), (RejectReason::NotConnected, 0));
    }
}

#[test]
fn a_configuration_that_leaves_less_than_required_is_refused_by_name() {
    let good = config(WireFormat::LittleEndian5x8);
    let refused = |config: GatewayConfig| Gateway::new(config, MonotonicTime::ZERO).unwrap_err();
    let watchdog = |ramp, stop| CommandWatchdog::new(ms(ramp), ms(stop)).unwrap();
    assert_eq!(refused(GatewayConfig { cycle: ms(11), ..good }), GatewayConfigError::Cycle { got: ms(11) });
    for got in [ms(0), ms(5001)] {
        assert_eq!(refused(GatewayConfig { brake_time: got, ..good }), GatewayConfigError::BrakeTime { got });
    }
    for got in [ms(1), ms(50)] {
        let expected = GatewayConfigError::Lateness { got, cycle: ms(2), stop_after: ms(50) };
        assert_eq!(refused(GatewayConfig { lateness_allowed: got, ..good }), expected);
    }
    let expected = GatewayConfigError::Watchdog { got: ms(10) };
    assert_eq!(refused(GatewayConfig { watchdog: watchdog(10, 50), ..good }), expected);
    let supervision = pb3dp_arm_pa10_protocol::codec::Supervision { dead_man: true, ..Default::default() };
    assert_eq!(refused(GatewayConfig { supervision, ..good }), GatewayConfigError::Supervision);
    let signals = good.signals.with(Signal::EmergencyStop, SignalSource::Wired);
    let expected = GatewayConfigError::Wired { got: Signal::EmergencyStop };
    assert_eq!(refused(GatewayConfig { signals, ..good }), expected, "this gateway has no inputs");
    let signals = good.signals.with(Signal::Power, SignalSource::Absent);
    assert_eq!(refused(GatewayConfig { signals, ..good }), GatewayConfigError::Absent { got: Signal::Power });
}

#[test]
fn losses_count_in_a_row_only() {
    let mut bench = moving();
    for _ in 0..20 {
        bench.controller.drop_next = 2;
        bench.command_for(DriveMode::Follow, velocity(), ms(10));
    }
    assert_eq!((bench.state(), bench.gateway.status().bus.lost), (GatewayState::Moving, 40));
}

#[test]
fn what_ran_out_is_not_revived_by_a_command_that_comes_before_the_cycle() {
    let mut bench = moving();
    bench.now = bench.now + ms(60);
    let GatewayMessage::State(state) = bench.ask(bench.command(DriveMode::Follow, velocity())) else { panic!() };
    assert_eq!((state.gateway, state.cause), (GatewayState::Fault, StopCause::HostSilent));
}

#[test]
fn a_controller_that_is_off_is_no_fault_at_the_start() {
    let mut bench = Bench::silent(config(WireFormat::BigEndian6x10));
    bench.gateway = Gateway::new(config(WireFormat::BigEndian6x10), bench.now).unwrap();
    bench.controller.answers = false;
    bench.run(ms(190));
    bench.ask(hello());
    let stopping = (RejectReason::WrongState, u32::from(GatewayState::Stopping.code()));
    assert_eq!(rejected(bench.ask(control(ArmOperation::Start))), stopping);
    bench.run(ms(60));
    assert_eq!(bench.letters().trim_matches('C'), "EEE");
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
    // A start is still answered in time, and nothing is started.
    let asked = bench.now;
    bench.sent.clear();
    assert_eq!(rejected(bench.ask(control(ArmOperation::Start))), (RejectReason::NoAnswer, 0));
    assert!(bench.now.saturating_since(asked) <= ms(50));
    assert_eq!(bench.letters().trim_matches('C'), "E");
    assert!(bench.gateway.status().stop_unacknowledged);
    // The controller is powered on.
    bench.controller.answers = true;
    bench.run(ms(10));
    assert_eq!(bench.state(), GatewayState::Stopping);
    assert_eq!(rejected(bench.ask(control(ArmOperation::Start))), stopping);
    bench.run(ms(220));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
    assert!(bench.gateway.is_at_rest());
    bench.lead_to(GatewayState::Moving);
}
