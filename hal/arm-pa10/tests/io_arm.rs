//! A real arm over real lines, with a gateway that answers and does not move.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

#[path = "common/far_end.rs"]
mod far_end;
#[allow(dead_code, reason = "each test file uses its part")]
#[path = "common/gateway.rs"]
mod gateway;
#[path = "common/patience.rs"]
mod patience;

use std::os::fd::BorrowedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use far_end::FarEnd;
use gateway::FakeGateway;
use patience::patiently;
use pb3dp_arm_pa10::codec::{ServoWord, WireFormat};
use pb3dp_arm_pa10::driver::{DriverConfig, DriverState, FaultCause, LimitsCheck, Trip};
use pb3dp_arm_pa10::gateway_protocol::{
    ArmId, ArmOperation, Control, Dialect, DriveMode, GatewayState, Geometry, HostMessage, StopCause,
};
use pb3dp_arm_pa10::io::arm::{ArmMonitor, ArmOpenError, Pa10Arm, Pa10ArmConfig, TripSeat, WishError, trip_line};
use pb3dp_arm_pa10::io::pty::Pty;
use pb3dp_arm_pa10::io::serial::SerialConfig;
use pb3dp_arm_pa10::io::tcp::{TcpConfig, TcpLink};
use pb3dp_arm_pa10::io::transport::{ByteLink, ConnectError, Connector, Symptom, Unplugged};
use pb3dp_arm_pa10::link::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_kinematics::JointVector;
use rustix::io::Errno;

const CYCLE: Duration = Duration::from_millis(10);
const FORMAT: WireFormat = WireFormat::BigEndian6x10;

fn config(arm: u8) -> Pa10ArmConfig {
    let limit = JointVector::repeat(3.0);
    let limits = LimitsCheck::Compare { lower_rad: -limit, upper_rad: limit, tolerance_rad: 1e-4 };
    let driver = DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) };
    let link = GatewayLinkConfig {
        arm: ArmId(arm),
        dialect: Dialect::GatewayV1,
        format: FORMAT,
        geometry: Geometry::SecondGeneration,
        cycle: CYCLE,
    };
    Pa10ArmConfig::new(&format!("arm-{arm}"), driver, link)
}

fn serial(pty: &Pty) -> SerialConfig {
    let path = pty.name().to_owned();
    SerialConfig { path, baud: 460_800, dialect: Dialect::GatewayV1, format: FORMAT, cycle: CYCLE }
}

fn seat() -> TripSeat {
    trip_line(1).unwrap().remove(0)
}

/// An arm over a pseudo-terminal with its gateway.
struct Rig {
    arm: Pa10Arm,
    far: FarEnd,
    _turn: Option<MutexGuard<'static, ()>>,
}

/// One test at a time: they want their threads to be run in time.
fn turn() -> Option<MutexGuard<'static, ()>> {
    static TURN: Mutex<()> = Mutex::new(());
    Some(TURN.lock().unwrap_or_else(PoisonError::into_inner))
}

fn open_at(pty: &Pty, arm: u8, seat: TripSeat) -> Result<Pa10Arm, ArmOpenError> {
    Pa10Arm::open(config(arm), Box::new(serial(pty)), Arc::new(SystemClock::new()), seat)
}

fn rig_with(arm: u8, seat: TripSeat, clock: Arc<SystemClock>, turn: Option<MutexGuard<'static, ()>>) -> Rig {
    let pty = Pty::open().unwrap();
    let connector = serial(&pty);
    let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(arm), FORMAT));
    let arm = Pa10Arm::open(config(arm), Box::new(connector), clock, seat);
    Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far, _turn: turn }
}

fn rig() -> Rig {
    rig_with(2, seat(), Arc::new(SystemClock::new()), turn())
}

fn velocity() -> JointCommand {
    JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]))
}

impl Rig {
    /// The same command for some cycles, at the arm's own pace. On a loaded machine answers may be late.
    fn exchange(&mut self, command: JointCommand, cycles: u32) {
        for _ in 0..cycles {
            match self.arm.exchange(command) {
                Err(error) if error.kind() != ArmErrorKind::Timeout => panic!("{error}"),
                _ => {}
            }
        }
    }

    /// On a loaded machine the link may need more than one try to show that it is quick enough.
    fn enable(&mut self) {
        for _ in 0..20 {
            match self.arm.enable() {
                Ok(()) => return,
                Err(error) if error.to_string().contains("the brakes stay closed") => {}
                Err(error) => panic!("{error}"),
            }
        }
        panic!("the machine is too loaded to enable an arm");
    }

    fn enable_and_move(&mut self) {
        self.enable();
        self.exchange(velocity(), 10);
        assert_eq!(self.monitor().snapshot().state, DriverState::Moving);
    }

    fn monitor(&self) -> ArmMonitor {
        self.arm.monitor()
    }

    /// Until the arm is stopped; how long it took.
    fn wait_until_stopped(&mut self) -> Duration {
        let begin = Instant::now();
        while !self.monitor().snapshot().state.is_latched() {
            assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", self.monitor().snapshot());
            std::thread::sleep(Duration::from_micros(200));
        }
        begin.elapsed()
    }

    /// Commands motion until the arm is stopped.
    fn exchange_until_stopped(&mut self) -> ArmError {
        let begin = Instant::now();
        loop {
            match self.arm.exchange(velocity()) {
                Err(error) if error.kind() == ArmErrorKind::Fault => return error,
                _ => assert!(begin.elapsed() < Duration::from_secs(5)),
            }
        }
    }

    fn trip(&self) -> Trip {
        self.monitor().snapshot().latched.unwrap().trip
    }

    fn heard(&self) -> Vec<HostMessage> {
        self.far.gateway.lock().unwrap().heard.clone()
    }
}

#[test]
fn an_arm_is_opened_enabled_moved_and_stopped() {
    patiently(|| {
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
        rig.arm.stop().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
        assert_eq!(rig.far.gateway.lock().unwrap().state, GatewayState::Idle);
        assert!(rig.far.gateway.lock().unwrap().rejected.is_empty());
        let told = rig.monitor().jitter();
        assert!(told.cycles > 100 && told.p50 <= told.p99 && told.p99 <= told.max, "{told:?}");
        println!("lateness of {} cycles: {told:?}; {:?}", told.cycles, rig.monitor().snapshot().counters);
    });
}

#[test]
fn an_idle_arm_shows_that_it_is_there() {
    patiently(|| {
        let rig = rig();
        std::thread::sleep(Duration::from_millis(900));
        let heartbeats = rig.heard().iter().filter(|message| **message == HostMessage::Heartbeat).count();
        assert!((2..=4).contains(&heartbeats), "{heartbeats}");
        assert_eq!(rig.monitor().snapshot().state, DriverState::Connected);
    });
}

#[test]
fn a_gateway_that_falls_silent_while_nothing_moves_is_noticed() {
    patiently(|| {
        let mut rig = rig();
        rig.far.line.stalled.store(true, Ordering::SeqCst);
        rig.wait_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::LinkLost { misses: 4 })), "{:?}", rig.trip());
    });
}

#[test]
fn unplugging_in_motion_is_noticed_at_once_and_needs_a_reset() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let unplugged = rig.far.unplug();
        rig.wait_until_stopped();
        let noticed = unplugged.elapsed();
        println!("unplugged, noticed after {noticed:?}");
        // 20 ms are demanded; a loaded machine may hold this test itself up.
        assert!(noticed < Duration::from_millis(500), "{noticed:?}");
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
        for command in [velocity(), JointCommand::Hold] {
            assert_eq!(rig.arm.exchange(command).unwrap_err().kind(), ArmErrorKind::Disconnected);
        }
        for result in [rig.arm.enable(), rig.arm.stop(), rig.arm.reset()] {
            assert_eq!(result.unwrap_err().kind(), ArmErrorKind::Disconnected);
        }
        assert_eq!(rig.arm.state(), ArmState::Fault);
    });
}

#[test]
fn a_line_that_is_plugged_in_again_works_after_a_reset() {
    patiently(|| {
        let turn = turn();
        // A listener stays where a pseudo-terminal does not.
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let serve = move || {
            let link = TcpLink::from_stream(listener.accept().unwrap().0).unwrap();
            (FarEnd::serve(Box::new(link), FakeGateway::new(ArmId(2), FORMAT)), listener)
        };
        let first = std::thread::spawn(serve);
        let arm = Pa10Arm::open(config(2), Box::new(TcpConfig { address }), Arc::new(SystemClock::new()), seat());
        let (far, listener) = first.join().unwrap();
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far, _turn: turn };
        rig.enable_and_move();
        rig.far.unplug();
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
        let again = std::thread::spawn(move || {
            let link = TcpLink::from_stream(listener.accept().unwrap().0).unwrap();
            FarEnd::serve(Box::new(link), FakeGateway::new(ArmId(2), FORMAT))
        });
        assert_eq!(rig.arm.state(), ArmState::Fault, "nothing comes back by itself");
        rig.arm.reset().unwrap();
        rig.far = again.join().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
        rig.enable_and_move();
    });
}

/// A port with an error that passes: it stays where it is.
struct Flaky {
    port: SerialConfig,
    breaks: Arc<AtomicBool>,
}

struct FlakyLink {
    link: Box<dyn ByteLink>,
    breaks: Arc<AtomicBool>,
}

impl Connector for Flaky {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(FlakyLink { link: self.port.connect()?, breaks: Arc::clone(&self.breaks) }))
    }

    fn target(&self) -> String {
        self.port.target()
    }
}

impl ByteLink for FlakyLink {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        if self.breaks.swap(false, Ordering::SeqCst) {
            return Err(Unplugged { symptom: Symptom::Os(Errno::IO) });
        }
        self.link.try_read(buffer)
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.link.try_write(bytes)
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.link.fd()
    }
}

#[test]
fn a_port_that_failed_once_is_let_go_of_and_had_again_by_a_reset() {
    patiently(|| {
        let turn = turn();
        let pty = Pty::open().unwrap();
        let breaks = Arc::new(AtomicBool::new(false));
        let connector = Flaky { port: serial(&pty), breaks: Arc::clone(&breaks) };
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far, _turn: turn };
        rig.enable_and_move();
        breaks.store(true, Ordering::SeqCst);
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
        // What stood between host and arm has stopped it.
        rig.far.gateway.lock().unwrap().latch(StopCause::HostSilent);
        rig.arm.reset().unwrap();
        rig.enable_and_move();
    });
}

#[test]
fn the_gateway_of_another_arm_is_refused() {
    patiently(|| {
        let _turn = turn();
        let pty = Pty::open().unwrap();
        let connector = serial(&pty);
        let _far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(3), FORMAT));
        let error = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat()).err().unwrap();
        assert!(matches!(error, ArmOpenError::Connect { source: WishError::NoGateway, .. }), "{error:?}");
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains("the number of the arm"), "{source}");
    });
}

#[test]
fn a_sound_frame_of_another_arm_stops_this_one() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let stray = FakeGateway::new(ArmId(9), FORMAT);
        let report = pb3dp_arm_pa10::gateway_protocol::GatewayMessage::ControlReply(
            pb3dp_arm_pa10::gateway_protocol::ControlReply {
                control: Control::Arm(ArmOperation::Start),
                state: GatewayState::Started,
            },
        );
        rig.far.line.noise.lock().unwrap().extend_from_slice(&stray.frame(&report, 0).encode());
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::WrongArm { got: 9 }));
        let error = rig.arm.exchange(velocity()).unwrap_err();
        assert!(error.to_string().contains("a reply came from arm 9"), "{error}");
    });
}

#[test]
fn garbage_on_the_line_is_counted_and_costs_no_answer() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let lost = rig.monitor().snapshot().counters.lost;
        for round in 0..20u8 {
            rig.far.line.noise.lock().unwrap().extend_from_slice(&[0xA5, 0x5A, round, 0xFF, 0xA5, 0x00, 0x5A]);
            rig.exchange(velocity(), 1);
        }
        let after = rig.monitor().snapshot();
        assert_eq!(after.state, DriverState::Moving, "{after:?}");
        assert!(after.line.resyncs >= 15 && after.line.skipped_bytes >= 100, "{after:?}");
        println!("lost by garbage: {}", after.counters.lost - lost);
        assert!(after.counters.lost - lost <= 5, "{after:?}");
    });
}

#[test]
fn a_lost_answer_is_borne_and_three_are_a_fault() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.far.line.drop_answers.store(1, Ordering::SeqCst);
        std::thread::sleep(2 * CYCLE);
        rig.exchange(velocity(), 5);
        assert!(rig.monitor().snapshot().counters.lost >= 1);
        rig.far.line.drop_answers.store(u32::MAX, Ordering::SeqCst);
        let error = rig.exchange_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::LinkLost { misses: 3 })), "{:?}", rig.trip());
        assert!(error.to_string().contains("3 exchanges in a row without a usable reply"), "{error}");
    });
}

#[test]
fn a_peer_that_stalls_holds_nothing_up() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.far.line.stalled.store(true, Ordering::SeqCst);
        let begin = Instant::now();
        rig.exchange_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::LinkLost { misses: 3 })), "{:?}", rig.trip());
        // The stop order ends by time, and a reset fails in bounded time.
        let error = rig.arm.reset().unwrap_err();
        assert!(error.to_string().contains("no gateway answers"), "{error}");
        assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
        rig.far.line.stalled.store(false, Ordering::SeqCst);
        rig.far.gateway.lock().unwrap().latch(StopCause::HostSilent);
        rig.arm.reset().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
    });
}

#[test]
fn a_control_loop_that_stays_away_stops_the_arm() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.wait_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::CommandTimeout { .. })), "{:?}", rig.trip());
        let error = rig.arm.exchange(velocity()).unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Fault);
        assert!(error.to_string().contains("no velocity for"), "{error}");
        // It may be looked at, and reset.
        rig.arm.exchange(JointCommand::Hold).unwrap();
        rig.arm.reset().unwrap();
        rig.enable_and_move();
    });
}

#[test]
fn a_held_arm_may_be_left_alone() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.exchange(JointCommand::Hold, 1);
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(rig.arm.state(), ArmState::Enabled, "{:?}", rig.monitor().snapshot().latched);
    });
}

/// Whether the gateway was led through the stop order: no speed, brakes, servos off, end.
fn was_stopped_in_order(heard: &[HostMessage]) -> bool {
    let find = |from: usize, wanted: &dyn Fn(&HostMessage) -> bool| {
        heard[from..].iter().position(wanted).map(|index| from + index)
    };
    let is_mode = |mode: DriveMode| move |message: &HostMessage| matches!(message, HostMessage::Command(command) if command.mode == mode);
    let last_motion = heard.iter().rposition(|message| {
        matches!(message, HostMessage::Command(command) if command.velocity_rad_per_s() != JointVector::zeros())
    });
    let Some(last_motion) = last_motion else { return false };
    let Some(braked) = find(last_motion, &is_mode(DriveMode::Braked)) else { return false };
    let at_rest = braked - last_motion - 1;
    let Some(off) = find(braked, &is_mode(DriveMode::Off)) else { return false };
    at_rest >= 5 && find(off, &|message| *message == HostMessage::Control(Control::Arm(ArmOperation::End))).is_some()
}

#[test]
fn a_panic_in_the_control_thread_stops_the_arm() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let Rig { mut arm, far, _turn } = rig;
        let control = std::thread::spawn(move || {
            arm.exchange(velocity()).unwrap();
            panic!("a mistake in the control loop");
        });
        assert!(control.join().is_err());
        let gateway = far.gateway.lock().unwrap();
        assert_eq!(gateway.state, GatewayState::Idle);
        assert!(was_stopped_in_order(&gateway.heard));
    });
}

/// A clock that breaks the arm's own thread once.
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
fn a_panic_in_the_arm_s_own_thread_stops_the_arm() {
    patiently(|| {
        let turn = turn();
        let pty = Pty::open().unwrap();
        let connector = serial(&pty);
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let clock = Arc::new(BreakingClock { clock: SystemClock::new(), breaks: AtomicBool::new(false) });
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::clone(&clock) as Arc<_>, seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far, _turn: turn };
        rig.enable_and_move();
        clock.breaks.store(true, Ordering::SeqCst);
        let error = rig.exchange_until_stopped();
        assert!(error.to_string().contains("the thread that watches the arm failed"), "{error}");
        assert_eq!(rig.arm.state(), ArmState::Fault);
        for result in [rig.arm.enable(), rig.arm.reset(), rig.arm.stop()] {
            assert_eq!(result.unwrap_err().kind(), ArmErrorKind::Fault);
        }
        let gateway = rig.far.gateway.lock().unwrap();
        assert_eq!(gateway.state, GatewayState::Idle);
        assert!(was_stopped_in_order(&gateway.heard));
    });
}

#[test]
fn an_arm_that_is_dropped_in_motion_is_stopped() {
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let Rig { arm, far, _turn } = rig;
        let begin = Instant::now();
        drop(arm);
        let took = begin.elapsed();
        println!("dropped in motion, stopped and ended after {took:?}");
        assert!(took < Duration::from_secs(2), "{took:?}");
        let gateway = far.gateway.lock().unwrap();
        assert_eq!(gateway.state, GatewayState::Idle);
        assert!(was_stopped_in_order(&gateway.heard));
    });
}

#[test]
fn a_second_owner_is_refused() {
    patiently(|| {
        let turn = turn();
        let pty = Pty::open().unwrap();
        let again = serial(&pty);
        let connector = serial(&pty);
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far, _turn: turn };
        let error = Pa10Arm::open(config(2), Box::new(again), Arc::new(SystemClock::new()), seat()).err().unwrap();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains("in use by another program or arm"), "{source}");
        rig.enable_and_move();
    });
}

#[test]
fn an_arm_stops_the_other_one_of_its_cell() {
    patiently(|| {
        let clock = Arc::new(SystemClock::new());
        let mut seats = trip_line(2).unwrap();
        let mut second = rig_with(5, seats.pop().unwrap(), Arc::clone(&clock), turn());
        let mut first = rig_with(4, seats.pop().unwrap(), clock, None);
        first.enable();
        second.enable();
        for _ in 0..10 {
            first.exchange(velocity(), 1);
            second.exchange(velocity(), 1);
        }
        first.far.gateway.lock().unwrap().servo[3] = ServoWord(0x00E0);
        first.wait_until_stopped();
        second.wait_until_stopped();
        let stopped = first.monitor().snapshot().latched.unwrap();
        assert!(matches!(stopped.trip, Trip::Fault(FaultCause::ServoAlarm { .. })), "{stopped:?}");
        assert_eq!(second.trip(), Trip::Fault(FaultCause::OtherArm { arm: 4 }));
        let after = second.monitor().snapshot().latched.unwrap().at.saturating_since(stopped.at);
        println!("the other arm was stopped {after:?} later");
        // One cycle is demanded; a loaded machine may hold its thread up.
        assert!(after < Duration::from_millis(500), "{after:?}");
        assert!(second.arm.exchange(velocity()).unwrap_err().to_string().contains("arm 4 of the same cell stopped"));
        // Each is reset by itself, and only where its cause is gone.
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
    patiently(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let trip = rig.arm.trip_handle();
        std::thread::spawn(move || trip.trip()).join().unwrap();
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Supervisor));
    });
}

#[test]
fn a_gateway_that_stopped_the_arm_before_is_told_and_reset() {
    patiently(|| {
        let turn = turn();
        let pty = Pty::open().unwrap();
        let mut gateway = FakeGateway::new(ArmId(2), FORMAT);
        gateway.latch(StopCause::HostSilent);
        let connector = serial(&pty);
        let far = FarEnd::serve(Box::new(pty), gateway);
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far, _turn: turn };
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
    patiently(|| {
        let _turn = turn();
        let pty = Pty::open().unwrap();
        let mut other = config(2);
        other.link.cycle = Duration::from_millis(5);
        let error = Pa10Arm::open(other, Box::new(serial(&pty)), Arc::new(SystemClock::new()), seat()).err().unwrap();
        assert!(error.to_string().contains("a cycle of 10ms in the driver and of 5ms in the link"), "{error}");
        let mut none = config(2);
        none.driver.warm_up_exchanges = 0;
        let error = Pa10Arm::open(none, Box::new(serial(&pty)), Arc::new(SystemClock::new()), seat()).err().unwrap();
        assert!(matches!(error, ArmOpenError::Config { .. }), "{error:?}");
        // Nobody answers.
        let error = open_at(&pty, 2, seat()).err().unwrap();
        assert!(matches!(error, ArmOpenError::Connect { source: WishError::NoGateway, .. }), "{error:?}");
    });
}
