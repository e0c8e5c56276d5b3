//! A real arm: motion, stops, and errors of the program.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{ArmOpenError, Direction, Pa10Arm, RequestError, trip_line};
use pb3dp_arm_pa10::driver::{DriverState, FaultCause, Trip};
use pb3dp_arm_pa10_protocol::codec::ServoWord;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, DriveMode, FrameParser, GatewayState, HostMessage, Received, StopCause,
};
use pb3dp_arm_pa10_test_support::arm_rig::{FORMAT, Rig, config, open_at, rig, rig_with, seat, serial, velocity};
use pb3dp_arm_pa10_test_support::far_end::FarEnd;
use pb3dp_arm_pa10_test_support::gateway::FakeGateway;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_kinematics::JointVector;
use pb3dp_test_support::in_real_time_beside_others;
use pb3dp_test_support::real_time::note_lateness_at;

#[test]
fn an_arm_is_opened_enabled_moved_and_stopped() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
        assert!(rig.arm.info().name.contains("arm-2 (pa10 at serial port /dev/pts/"), "{}", rig.arm.info().name);
        assert_eq!(rig.arm.exchange(velocity()).unwrap_err().kind(), ArmErrorKind::NotEnabled);
        rig.enable_and_move();
        assert_eq!(rig.arm.state(), ArmState::Enabled, "{:?}", rig.monitor().snapshot().latched);
        let speeds = rig.far.gateway.lock().unwrap().speeds;
        assert!((speeds[3] + 0.4).abs() < 2e-4, "{speeds:?}");
        let error = rig.arm.enable().unwrap_err();
        assert!(error.to_string().contains("Enable is not possible: the arm is moving"), "{error}");
        let mut wild = JointVector::zeros();
        wild[5] = f64::NAN;
        let error = rig.arm.exchange(JointCommand::Velocity(wild)).unwrap_err();
        assert_eq!((error.kind(), error.joint()), (ArmErrorKind::Rejected, Some(5)));
        rig.arm.stop().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
        assert_eq!(rig.far.gateway.lock().unwrap().state, GatewayState::Idle);
        assert!(rig.far.gateway.lock().unwrap().rejected.is_empty());
        let measured_jitter = rig.monitor().jitter();
        assert!(
            measured_jitter.cycles > 100
                && measured_jitter.p50 <= measured_jitter.p99
                && measured_jitter.p99 <= measured_jitter.max,
            "{measured_jitter:?}"
        );
        check_raw_bytes(&rig);
        let answers = rig.monitor().round_trips();
        assert!(answers.cycles > 100 && answers.max < 2 * rig.arm.info().cycle, "{answers:?}");
        println!(
            "lateness of {} cycles: {measured_jitter:?}; {:?}",
            measured_jitter.cycles,
            rig.monitor().snapshot().counters
        );
    });
}

#[test]
fn an_arm_is_looked_at_again_while_its_brakes_are_on() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        let before = rig.monitor().snapshot();
        for _ in 0..3 {
            rig.arm.look().unwrap();
        }
        let after = rig.monitor().snapshot();
        assert_eq!((after.state, after.samples), (DriverState::Connected, before.samples + 3));
        let measured_jitter = rig.monitor().control_trips();
        assert!(measured_jitter.cycles >= 4 * 9 && measured_jitter.p50 <= measured_jitter.max, "{measured_jitter:?}");
        rig.enable();
        let error = rig.arm.look().unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Rejected, "{error}");
        assert_eq!(rig.arm.state(), ArmState::Enabled, "{:?}", rig.monitor().snapshot().latched);
    });
}

#[test]
fn a_loop_that_keeps_the_pace_is_not_held_up() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let monitor = rig.monitor();
        let before = monitor.snapshot().samples;
        let begin = Instant::now();
        while monitor.snapshot().samples == before && begin.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(Duration::from_micros(100));
        }
        // Each of these exchanges is long before the next measurement.
        std::thread::sleep(Duration::from_millis(2));
        let (clock, cycle) = (SystemClock::new(), rig.arm.info().cycle);
        let (mut due, mut held_up) = (clock.now(), 0);
        for _ in 0..40 {
            let begin = clock.now();
            rig.arm.exchange(velocity()).unwrap_or_else(|error| panic!("{error}"));
            rig.arm.exchange(velocity()).unwrap_or_else(|error| panic!("{error}"));
            held_up += u32::from(clock.now().saturating_since(begin) > cycle / 4);
            due = due + cycle;
            clock.sleep_until(due);
        }
        assert!(held_up <= 20, "{held_up} of 40 (is the machine too loaded?)");
    });
}

/// Each sent frame and its answer, as on the line.
fn check_raw_bytes(rig: &Rig) {
    let kept = rig.monitor().raw_bytes();
    let stream =
        |way| kept.iter().filter(|raw| raw.way == way).flat_map(|raw| raw.bytes().to_vec()).collect::<Vec<_>>();
    let (mut frames, mut parser) = (Vec::new(), FrameParser::new(ArmId(2)));
    parser.feed(&stream(Direction::Out), |received| frames.push(received));
    let messages = rig.messages();
    assert_eq!(frames.len(), messages.len());
    for (received, messages) in frames.iter().zip(&messages) {
        let Received::Frame(frame) = received else { panic!("{received:?}") };
        assert_eq!(HostMessage::decode(frame).unwrap(), *messages);
    }
    let (mut answers, mut parser) = (0, FrameParser::new(ArmId(2)));
    parser.feed(&stream(Direction::In), |_| answers += 1);
    assert_eq!(answers, messages.len());
    assert!(kept.is_sorted_by_key(|raw| raw.at));
}

#[test]
fn an_idle_arm_shows_that_it_is_there() {
    in_real_time_beside_others(|| {
        let rig = rig();
        std::thread::sleep(Duration::from_millis(900));
        let heartbeats = rig.messages().iter().filter(|message| **message == HostMessage::Heartbeat).count();
        assert!((2..=4).contains(&heartbeats), "{heartbeats}");
        assert_eq!(rig.monitor().snapshot().state, DriverState::Connected);
    });
}

#[test]
fn a_gateway_that_falls_silent_while_nothing_moves_is_noticed() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.far.line.stalled.store(true, Ordering::SeqCst);
        rig.wait_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::LinkLost { misses: 4 })), "{:?}", rig.trip());
    });
}

#[test]
fn a_control_loop_that_stays_away_stops_the_arm() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.wait_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::CommandTimeout { .. })), "{:?}", rig.trip());
        let error = rig.arm.exchange(velocity()).unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Fault);
        assert!(error.to_string().contains("no velocity for"), "{error}");
        // The arm can be measured and reset.
        rig.arm.exchange(JointCommand::Hold).unwrap();
        rig.arm.reset().unwrap();
        rig.enable_and_move();
    });
}

#[test]
fn a_held_arm_may_be_left_alone() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.exchange(JointCommand::Hold, 1);
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(rig.arm.state(), ArmState::Enabled, "{:?}", rig.monitor().snapshot().latched);
    });
}

/// Whether the gateway went through the stop order: speed 0, brakes, servos off, end.
fn was_stopped_in_order(messages: &[HostMessage]) -> bool {
    let find = |from: usize, wanted: &dyn Fn(&HostMessage) -> bool| {
        messages[from..].iter().position(wanted).map(|index| from + index)
    };
    let is_mode = |mode: DriveMode| move |message: &HostMessage| matches!(message, HostMessage::Command(command) if command.mode == mode);
    let last_motion = messages.iter().rposition(|message| {
        matches!(message, HostMessage::Command(command) if command.velocity_rad_per_s() != JointVector::zeros())
    });
    let Some(last_motion) = last_motion else { return false };
    let Some(braked) = find(last_motion, &is_mode(DriveMode::Braked)) else { return false };
    let at_rest = braked - last_motion - 1;
    let Some(off) = find(braked, &is_mode(DriveMode::Off)) else { return false };
    at_rest >= 5 && find(off, &|message| *message == HostMessage::Control(Control::Arm(ArmOperation::End))).is_some()
}

#[test]
fn a_panic_in_the_control_thread_stops_the_arm_and_latches() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let Rig { mut arm, far } = rig;
        let control = std::thread::spawn(move || {
            arm.exchange(velocity()).unwrap();
            panic!("a mistake in the control loop");
        });
        assert!(control.join().is_err());
        let gateway = far.gateway.lock().unwrap();
        assert_eq!((gateway.state, gateway.cause), (GatewayState::Fault, StopCause::HostFault));
        assert!(was_stopped_in_order(&gateway.messages));
    });
}

/// A clock that makes the arm's thread panic once.
struct BreakingClock {
    clock: SystemClock,
    breaks: AtomicBool,
}

impl Clock for BreakingClock {
    fn now(&self) -> MonotonicTime {
        let is_arm = std::thread::current().name().is_some_and(|name| name.starts_with("arm "));
        assert!(!(is_arm && self.breaks.swap(false, Ordering::SeqCst)), "a mistake in the arm's thread");
        self.clock.now()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.clock.sleep_until(deadline);
    }
}

#[test]
fn a_panic_in_the_arm_s_own_thread_stops_the_arm_and_latches() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let connector = serial(&pty);
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let clock = Arc::new(BreakingClock { clock: SystemClock::new(), breaks: AtomicBool::new(false) });
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::clone(&clock) as Arc<_>, seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far };
        rig.enable_and_move();
        clock.breaks.store(true, Ordering::SeqCst);
        let error = rig.exchange_until_stopped();
        assert!(error.to_string().contains("the thread that monitors the arm failed"), "{error}");
        assert_eq!(rig.arm.state(), ArmState::Fault);
        for result in [rig.arm.enable(), rig.arm.reset(), rig.arm.stop()] {
            assert_eq!(result.unwrap_err().kind(), ArmErrorKind::Fault);
        }
        let gateway = rig.far.gateway.lock().unwrap();
        assert_eq!((gateway.state, gateway.cause), (GatewayState::Fault, StopCause::HostFault));
        assert!(was_stopped_in_order(&gateway.messages));
    });
}

#[test]
fn an_arm_that_is_dropped_in_motion_is_stopped_and_latched() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let Rig { arm, far } = rig;
        let begin = Instant::now();
        drop(arm);
        let took = begin.elapsed();
        println!("dropped in motion, stopped and ended after {took:?}");
        assert!(took < Duration::from_secs(2), "{took:?}");
        let gateway = far.gateway.lock().unwrap();
        assert_eq!((gateway.state, gateway.cause), (GatewayState::Fault, StopCause::HostFault));
        assert!(was_stopped_in_order(&gateway.messages));
    });
}

#[test]
fn an_arm_stops_the_other_one_of_its_cell() {
    in_real_time_beside_others(|| {
        let clock = Arc::new(SystemClock::new());
        let mut seats = trip_line(2).unwrap();
        let mut second = rig_with(5, seats.pop().unwrap(), Arc::clone(&clock));
        let mut first = rig_with(4, seats.pop().unwrap(), Arc::clone(&clock));
        first.enable();
        second.enable();
        for _ in 0..10 {
            first.exchange(velocity(), 1);
            let _ = second.arm.exchange(velocity());
        }
        first.far.gateway.lock().unwrap().servo[3] = ServoWord(0x00E0);
        first.wait_until_stopped();
        second.wait_until_stopped();
        let stopped = first.monitor().snapshot().latched.unwrap();
        assert!(matches!(stopped.trip, Trip::Fault(FaultCause::ServoAlarm { .. })), "{stopped:?}");
        assert_eq!(second.trip(), Trip::Fault(FaultCause::OtherArm { arm: 4 }));
        let measured_jitter = second.monitor().snapshot().latched.unwrap().at;
        let after = measured_jitter.saturating_since(stopped.at);
        println!("the other arm was stopped {after:?} later");
        // The thread checks the trip line once per cycle; a delay of more than half a cycle is caused by the machine, if a
        // witness was equally late at the same time.
        let cycle = second.arm.info().cycle;
        if after > cycle {
            let ago = clock.now().saturating_since(measured_jitter);
            note_lateness_at(Instant::now().checked_sub(ago).unwrap(), after.saturating_sub(cycle));
        }
        assert!(after < cycle * 3 / 2, "{after:?} in cycles of {cycle:?}");
        assert!(second.arm.exchange(velocity()).unwrap_err().to_string().contains("arm 4 of the same cell stopped"));
        // Each arm is reset separately, and only after its cause is removed.
        second.arm.reset().unwrap();
        assert_eq!((first.arm.state(), second.arm.state()), (ArmState::Fault, ArmState::Disabled));
        assert!(first.arm.reset().is_err());
        first.far.gateway.lock().unwrap().servo[3] = ServoWord(0);
        first.arm.reset().unwrap();
        second.enable_and_move();
    });
}

#[test]
fn an_arm_is_stopped_from_anywhere() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let trip = rig.arm.trip_handle();
        std::thread::spawn(move || trip.trip()).join().unwrap();
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Supervisor));
    });
}

#[test]
fn a_gateway_that_stopped_the_arm_before_is_reported_and_reset() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let mut gateway = FakeGateway::new(ArmId(2), FORMAT);
        gateway.latch(StopCause::HostSilent);
        let connector = serial(&pty);
        let far = FarEnd::serve(Box::new(pty), gateway);
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far };
        assert_eq!(rig.arm.state(), ArmState::Fault);
        let error = rig.arm.enable().unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Fault);
        assert!(error.to_string().contains("the gateway stopped the arm"), "{error}");
        rig.arm.reset().unwrap();
        rig.enable_and_move();
    });
}

#[test]
fn configurations_that_contradict_themselves_are_refused() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let mut other = config(2);
        other.link.cycle = Duration::from_millis(5);
        let error = Pa10Arm::open(other, Box::new(serial(&pty)), Arc::new(SystemClock::new()), seat()).err().unwrap();
        assert!(error.to_string().contains("the driver has a cycle of 10ms, the link one of 5ms"), "{error}");
        let mut none = config(2);
        none.driver.warm_up_exchanges = 0;
        let error = Pa10Arm::open(none, Box::new(serial(&pty)), Arc::new(SystemClock::new()), seat()).err().unwrap();
        assert!(matches!(error, ArmOpenError::Config { .. }), "{error:?}");
        // No gateway answers.
        let error = open_at(&pty, 2, seat()).err().unwrap();
        assert!(matches!(error, ArmOpenError::Connect { source: RequestError::NoGateway, .. }), "{error:?}");
    });
}
