//! The emulated arm in real time, over real lines, with the driver of a real arm at the other end. The limits of times are loose,
//! because they depend on the machine that runs the tests.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, trip_line};
use pb3dp_arm_pa10::driver::{DriverConfig, LimitsCheck};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, MockServerConfig, MockServerError};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockControllerConfig, Script, pa10_joints};
use pb3dp_arm_pa10_gateway::bus::{BusPort, FRAME_ROOM, FrameSocket};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_gateway::service::Access;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, Firmware, GatewayState, Geometry, HostLimits, MotionLimits, StopCause,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::world::{keyed, test_key};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig};
use pb3dp_test_support::{beside_each_other, in_real_time_beside_others};

const CYCLE: Duration = Duration::from_millis(10);
const FORMAT: WireFormat = WireFormat::BigEndian6x10;

/// Used where permitted; the priority is low because other tests run as well.
const REALTIME: Realtime = Realtime { priority: Some(5), locks_memory: false, cpu: None };

/// Load by other tests must not make this test fail.
const TIMEOUT: Duration = Duration::from_secs(10);

struct Rig {
    server: MockServer,
    plant: Arc<Mutex<JointPlant>>,
    clock: Arc<SystemClock>,
}

fn gateway() -> GatewayConfig {
    GatewayConfig::new(ArmId(2), FORMAT, Firmware::new("mock 1").unwrap(), MotionLimits::WIDEST)
}

fn access() -> Access {
    Access::from_this_computer(test_key())
}

fn start(face: MockFace, script: &str) -> Result<Rig, MockServerError> {
    let clock = Arc::new(SystemClock::new());
    let joints = JointPlantConfig { history: Duration::from_secs(20), ..pa10_joints().unwrap() };
    let home = JointVector::from([0.1, 0.3, -0.2, 0.8, 0.2, 0.5, 0.0]);
    let plant = Arc::new(Mutex::new(JointPlant::new(joints, home, clock.now()).unwrap()));
    let controller = MockControllerConfig::new(FORMAT);
    let config = MockServerConfig { controller, seed: 3, script: Script::parse(script).unwrap(), realtime: REALTIME };
    let server = MockServer::start(config, face, Arc::clone(&plant), Arc::clone(&clock) as Arc<dyn Clock>)?;
    Ok(Rig { server, plant, clock })
}

fn rig(face: MockFace) -> Rig {
    start(face, "").unwrap()
}

impl Rig {
    fn serial(&self) -> Box<dyn Connector> {
        let path = self.server.address();
        Box::new(SerialConfig { path, baud: 921_600, cycle: CYCLE })
    }

    /// An enabled arm that tolerates the delays of a loaded machine.
    fn enabled(&self, connector: Box<dyn Connector>) -> Pa10Arm {
        let limit = JointVector::from([177.0f64, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0].map(f64::to_radians));
        let limits = LimitsCheck::Compare { lower_rad: -limit, upper_rad: limit, tolerance_rad: 0.5f64.to_radians() };
        let driver = DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) };
        let link = GatewayLinkConfig {
            arm: ArmId(2),
            format: FORMAT,
            geometry: Geometry::Unknown,
            cycle: CYCLE,
            limits: HostLimits::WIDEST,
            signals: StatusSignals::ORCA,
        };
        let config = Pa10ArmConfig { realtime: REALTIME, ..Pa10ArmConfig::new("test", driver, link) };
        let clock = Arc::clone(&self.clock) as Arc<dyn Clock>;
        let seat = trip_line(1).unwrap().remove(0);
        let mut arm = Pa10Arm::open(config, connector, clock, seat).map_err(|error| error.to_string()).unwrap();
        let until = Instant::now() + TIMEOUT;
        while let Err(error) = arm.enable() {
            // The link was too slow for a moment, or this caused a fault.
            assert!(Instant::now() < until, "{error}");
            arm.reset().ok();
        }
        arm
    }

    fn fault(&self, line: &str) -> MonotonicTime {
        let at = self.clock.now();
        self.server.command_line(line).unwrap();
        at
    }

    fn angle(&self) -> f64 {
        self.server.report().position_rad[0]
    }

    /// Time of the last motion of the joints since `since`.
    fn last_motion(&self, since: MonotonicTime) -> Duration {
        let plant = self.plant.lock().unwrap();
        let (mut at, mut last) = (since, since);
        while at <= plant.now() {
            if plant.velocity_at(at).unwrap().amax() > 1e-3 {
                last = at;
            }
            at = at + Duration::from_millis(1);
        }
        last.saturating_since(since)
    }
}

/// Commands motion until the arm stops or the time ends, at the arm's own rate.
fn move_for(arm: &mut Pa10Arm, time: Duration) {
    let until = Instant::now() + time;
    while Instant::now() < until && arm.state() == ArmState::Enabled {
        match arm.exchange(JointCommand::Velocity(JointVector::repeat(0.1))) {
            Err(error) if error.kind() != ArmErrorKind::Timeout => break,
            _ => {}
        }
    }
}

/// Moves the arm, again after each stop that a loaded machine causes.
fn moved_by(rig: &Rig, arm: &mut Pa10Arm, angle_rad: f64) -> f64 {
    let (begin, until) = (rig.angle(), Instant::now() + TIMEOUT);
    while rig.angle() - begin < angle_rad && Instant::now() < until {
        move_for(arm, Duration::from_millis(300));
        if arm.state() != ArmState::Enabled {
            std::thread::sleep(Duration::from_millis(400));
            arm.reset().ok();
            arm.enable().ok();
        }
    }
    rig.angle() - begin
}

fn wait_for(mut condition: impl FnMut() -> bool) -> bool {
    let until = Instant::now() + TIMEOUT;
    while Instant::now() < until {
        if condition() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    false
}

#[test]
fn an_arm_moves_over_a_pseudo_terminal() {
    in_real_time_beside_others(|| {
        let rig = rig(MockFace::Pty(gateway()));
        assert!(rig.server.address().starts_with("/dev/"), "{}", rig.server.address());
        let mut arm = rig.enabled(rig.serial());
        let moved = moved_by(&rig, &mut arm, 0.05);
        assert!(moved >= 0.05, "{moved}");
        arm.stop().unwrap();
        assert!(wait_for(|| rig.server.report().is_braked));
        let report = rig.server.report();
        assert_eq!(report.mode, ControlMode::Adjustment);
        assert_eq!(
            [report.counters.forbidden, report.counters.malformed, report.counters.odd, report.counters.released],
            [0; 4]
        );
        let text = report.to_string();
        assert!(text.starts_with("controller: adjustment mode, all brakes closed\n  axis 1 (S1)"), "{text}");
        assert!(text.contains("gateway: idle"), "{text}");
    });
}

/// A fault as it is typed, its end, the resulting state, and whether a reset is refused until the fault has ended.
type Typed = (&'static str, &'static str, ArmState, bool);

/// The faults of the test set, distributed over the arms.
const TYPED: [&[Typed]; 4] = [
    &[
        ("e-stop press", "e-stop release", ArmState::EStop, true),
        ("drop 1000000", "drop 0", ArmState::Fault, false),
        ("line corrupt 1000000", "line corrupt 0", ArmState::Fault, false),
        ("time-out", "drop 0", ArmState::Fault, false),
        ("delay 1000000 40ms", "delay 0 0s", ArmState::Fault, false),
    ],
    &[
        ("alarm 4 0x0e", "alarm 4 off", ArmState::Fault, true),
        ("silence on", "silence off", ArmState::Fault, false),
        ("line truncate 1000000", "line truncate 0", ArmState::Fault, false),
        ("wrong-letter 1000000", "wrong-letter 0", ArmState::Fault, false),
        ("line slow 60ms", "line slow 0s", ArmState::Fault, false),
    ],
    &[
        ("power off", "power on", ArmState::Fault, true),
        ("truncate 1000000", "truncate 0", ArmState::Fault, false),
        ("line wrong-arm 1000000", "line wrong-arm 0", ArmState::Fault, false),
        ("wrong-sequence 1000000", "wrong-sequence 0", ArmState::Fault, false),
        ("line silence on", "line silence off", ArmState::Fault, false),
    ],
    &[
        ("limit-switch open", "limit-switch close", ArmState::EStop, true),
        ("wrong-node 1000000", "wrong-node 0", ArmState::Fault, false),
        ("line deaf on", "line deaf off", ArmState::Fault, false),
        ("line slow-reader 500B/s", "line slow-reader off", ArmState::Fault, false),
        ("controller-alarm 0x07 reported", "controller-alarm off", ArmState::Fault, true),
        ("deaf 1000000", "deaf 0", ArmState::Fault, false),
    ],
];

/// Typed while the arm moves: the arm stops, stays stopped, and can be reset after the cause is removed. Four arms at a time.
#[test]
fn faults_are_typed_while_the_arm_moves() {
    in_real_time_beside_others(|| beside_each_other(TYPED, suffer));
}

fn suffer(typed: &[Typed]) {
    let rig = rig(MockFace::Pty(gateway()));
    let mut arm = rig.enabled(rig.serial());
    for (line, end, state, keeps_cause) in typed {
        assert!(moved_by(&rig, &mut arm, 0.01) >= 0.01, "before {line}");
        let at = rig.fault(line);
        let until = Instant::now() + TIMEOUT;
        while arm.state() == ArmState::Enabled && Instant::now() < until {
            arm.exchange(JointCommand::Velocity(JointVector::repeat(0.1))).ok();
        }
        // A loaded machine may have stopped the arm just before.
        assert!(wait_for(|| arm.state() == *state), "{line}: {:?}", arm.state());
        std::thread::sleep(Duration::from_millis(400));
        let took = rig.last_motion(at);
        println!("{line}: at rest after {took:?}");
        assert!(took < Duration::from_millis(400), "{line}: {took:?}");
        assert!(!keeps_cause || arm.reset().is_err(), "{line}: the cause is there");
        rig.fault(end);
        std::thread::sleep(Duration::from_millis(250));
        let until = Instant::now() + TIMEOUT;
        while let Err(error) = arm.reset().and_then(|()| arm.enable()) {
            assert!(Instant::now() < until, "{line}: {error}");
        }
    }
    let counters = rig.server.report().counters;
    assert_eq!(counters.faults.values().sum::<u64>(), 2 * typed.len() as u64, "{:?}", counters.faults);
    let error = rig.server.command_line("e-stop pres").unwrap_err().to_string();
    assert!(error.contains("`pres`"), "{error}");
}

/// Clocks of host and gateway jump by hours in both directions: the arm follows its commands as before, or is stopped with a
/// cause and can be reset.
#[test]
fn clocks_that_jump_never_leave_an_arm_moving_by_itself() {
    in_real_time_beside_others(|| {
        let rig =
            start(MockFace::Pty(gateway()), "at 0s line host-clock 200000s\nat 0s line gateway-clock 200000s").unwrap();
        let mut arm = rig.enabled(rig.serial());
        for jump in ["host-clock -3600s", "host-clock 7200s", "gateway-clock -90000s", "gateway-clock 7200s"] {
            assert!(moved_by(&rig, &mut arm, 0.01) >= 0.01, "before {jump}");
            let at = rig.fault(&format!("line {jump}"));
            move_for(&mut arm, Duration::from_millis(500));
            let state = arm.state();
            if state == ArmState::Enabled {
                // The arm continues: then it also stops on request, or because of a loaded machine.
                arm.stop().ok();
            } else {
                let cause = arm.monitor().snapshot().latched;
                assert!(state == ArmState::Fault && cause.is_some(), "{jump}: {state:?}");
            }
            assert!(wait_for(|| rig.server.report().is_braked), "{jump}: {state:?}");
            println!("{jump}: {state:?}, at rest after {:?}", rig.last_motion(at));
            let until = Instant::now() + 2 * TIMEOUT;
            while let Err(error) = arm.reset().and_then(|()| arm.enable()) {
                assert!(Instant::now() < until, "{jump}: {error}");
            }
        }
    });
}

/// A link that can be opened once.
struct Once(Option<Box<dyn ByteLink>>);

impl Connector for Once {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        self.0.take().ok_or_else(|| "it was there once".into())
    }

    fn target(&self) -> String {
        "a link with little room".to_owned()
    }
}

/// A gateway that reads nothing, and a line with room for few frames: the line is soon full, and the host does not block.
#[test]
fn a_line_that_is_full_holds_no_host_up() {
    in_real_time_beside_others(|| {
        let (host, far) = pb3dp_hal_platform::transport::pair("test").unwrap();
        rustix::net::sockopt::set_socket_send_buffer_size(host.fd().unwrap(), 1).unwrap();
        let rig = rig(MockFace::Link(gateway(), Box::new(far)));
        let mut arm = rig.enabled(Box::new(Once(Some(Box::new(host)))));
        assert!(moved_by(&rig, &mut arm, 0.01) >= 0.01);
        let at = rig.fault("line slow-reader 0B/s");
        move_for(&mut arm, TIMEOUT);
        assert_eq!(arm.state(), ArmState::Fault);
        assert!(wait_for(|| rig.server.report().is_braked));
        assert!(rig.last_motion(at) < Duration::from_millis(400), "{:?}", rig.last_motion(at));
        // Each try sends more, until the line is full.
        let full = wait_for(|| {
            let begin = Instant::now();
            assert!(arm.reset().is_err());
            assert!(begin.elapsed() < TIMEOUT / 2, "{:?}", begin.elapsed());
            arm.monitor().snapshot().frames_unsent > 0
        });
        assert!(full, "{:?}", arm.monitor().snapshot());
        assert!(arm.enable().is_err());
        rig.fault("line slow-reader off");
        let until = Instant::now() + TIMEOUT;
        while let Err(error) = arm.reset().and_then(|()| arm.enable()) {
            assert!(Instant::now() < until, "{error}");
        }
        assert!(moved_by(&rig, &mut arm, 0.01) >= 0.01);
    });
}

/// After unplugging, the host detects the loss and the gateway brakes the arm by itself; the next terminal has another path.
#[test]
fn a_pulled_cable_stops_the_arm() {
    in_real_time_beside_others(|| {
        let rig = rig(MockFace::Pty(gateway()));
        let mut arm = rig.enabled(rig.serial());
        assert!(moved_by(&rig, &mut arm, 0.01) >= 0.01);
        let (at, before) = (rig.clock.now(), rig.server.address());
        rig.server.unplug();
        assert!(wait_for(|| arm.state() == ArmState::Fault));
        assert!(wait_for(|| rig.server.report().is_braked));
        let gateway = rig.server.report().gateway.unwrap();
        assert_eq!((gateway.state, gateway.cause), (GatewayState::Fault, StopCause::HostSilent));
        assert!(rig.last_motion(at) < Duration::from_millis(500));
        assert!(!Path::new(&before).exists() || rig.server.address() == before);
        rig.server.plug();
        drop(arm);
        assert!(wait_for(|| Path::new(&rig.server.address()).exists()));
        std::thread::sleep(Duration::from_millis(300));
        let mut arm = rig.enabled(rig.serial());
        assert!(moved_by(&rig, &mut arm, 0.01) >= 0.01);
    });
}

/// The terminal has another path when the cable is plugged in again, because another program uses the old one.
#[test]
fn an_arm_is_found_again_wherever_its_terminal_is() {
    in_real_time_beside_others(|| {
        let rig = rig(MockFace::Pty(gateway()));
        let path = rig.server.address();
        let config = SerialConfig { path, baud: 921_600, cycle: CYCLE };
        let mut arm = rig.enabled(Box::new(rig.server.port(config)));
        let before = rig.server.address();
        rig.server.unplug();
        assert!(wait_for(|| arm.state() == ArmState::Fault));
        let mut others = Vec::new();
        assert!(wait_for(|| {
            others.push(Pty::open().unwrap());
            others.last().unwrap().path() == Path::new(&before)
        }));
        rig.server.plug();
        assert!(wait_for(|| rig.server.address() != before));
        assert!(wait_for(|| arm.reset().is_ok()));
        assert!(wait_for(|| arm.enable().is_ok()));
    });
}

/// A host that ends without a message: the next one finds a stopped arm.
#[test]
fn an_arm_moves_over_tcp_and_stops_with_its_connection() {
    in_real_time_beside_others(|| {
        let rig = rig(MockFace::Tcp(gateway(), "127.0.0.1:0".parse().unwrap(), access()));
        let address = rig.server.address().parse().unwrap();
        let mut arm = rig.enabled(Box::new(keyed(address)));
        assert!(moved_by(&rig, &mut arm, 0.02) >= 0.02);
        let taken = start(MockFace::Tcp(gateway(), address, access()), "").err().unwrap().to_string();
        assert!(taken.contains(&format!("cannot listen at {address}")), "{taken}");
        drop(arm);
        assert!(wait_for(|| rig.server.report().is_braked));
        let again = rig.enabled(Box::new(keyed(address)));
        assert_eq!(again.state(), ArmState::Enabled);
    });
}

/// The controller alone: one frame in, one frame out, and the time-out of a controller without commands.
#[test]
fn a_socket_stands_in_the_place_of_the_bus() {
    in_real_time_beside_others(|| {
        let folder = std::env::temp_dir().join(format!("pb3dp-mock-bus-{}", std::process::id()));
        let rig = start(MockFace::BusSocket(folder.clone()), "at 0s jump 2 0.1rad").unwrap();
        let mut bus = FrameSocket::connect(&folder).unwrap();
        assert!(bus.try_send(&[0xFF, 0xFE, 254, 0xB7, 7, b'S']).unwrap());
        let mut buffer = [0; FRAME_ROOM];
        let mut length = None;
        assert!(wait_for(|| {
            length = bus.try_receive(&mut buffer).unwrap();
            length.is_some()
        }));
        assert_eq!(&buffer[..length.unwrap()], [0xFE, 0xFF, 254, 0xB7, 7, b'S']);
        assert!(wait_for(|| rig.server.report().counters.watchdog_trips == 1));
        let report = rig.server.report();
        assert_eq!((report.mode, report.gateway), (ControlMode::Adjustment, None));
        assert_eq!(report.counters.faults["jump"], 1);
        // Another host may connect after this one.
        drop(bus);
        assert!(wait_for(|| {
            let mut bus = FrameSocket::connect(&folder).unwrap();
            let sent = bus.try_send(&[0xFF, 0xFE, 254, 0xB7, 8, b'E']);
            std::thread::sleep(Duration::from_millis(30));
            sent == Ok(true) && matches!(bus.try_receive(&mut buffer), Ok(Some(6)))
        }));
        drop(rig);
        assert!(!folder.exists(), "the socket goes with the server");
    });
}

/// A host that writes and never reads: the arm continues, and memory does not grow.
#[test]
fn answers_that_nobody_reads_are_dropped() {
    in_real_time_beside_others(|| {
        let (mut host, far) = pb3dp_hal_platform::transport::pair("test").unwrap();
        let rig = rig(MockFace::Link(gateway(), Box::new(far)));
        let hello = [
            0xa5, 0x5a, 0x01, 0x02, 0x01, 0x05, 0x00, 0x00, 0x60, 0xe3, 0x16, 0x00, 0x00, 0x00, 0x00, 0x00, 0x58, 0x02,
            0x10, 0x27, 0x00, 0x00, 0x48, 0x6a,
        ];
        let flooded = wait_for(|| {
            for _ in 0..50 {
                pb3dp_hal_platform::transport::ByteLink::try_write(&mut host, &hello).unwrap();
            }
            rig.server.report().unread > 0
        });
        assert!(flooded);
        drop(host);
        assert!(wait_for(|| !rig.server.report().gateway.unwrap().has_host));
    });
}
