//! A host program that is killed, frozen or panics while its arm moves: the arm is stopped, and does not move again before a
//! reset.
//!
//! The host is this program in a separate process: `alone host PTY`, with a further argument for a panic.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, trip_line};
use pb3dp_arm_pa10::driver::DriverConfig;
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, GatewayState, Geometry, HostLimits, StopCause};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::cell_end::{Cell, CellEnd};
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink;
use pb3dp_kinematics::JointVector;
use rustix::process::{Pid, Signal, kill_process};

const CYCLE: Duration = Duration::from_millis(10);
const LONG: Duration = Duration::from_secs(30);
/// A hundred times the time in which the gateway brakes an arm with a silent host; a test waits no longer.
const BRAKED_WITHIN: Duration = Duration::from_secs(5);

fn velocity() -> JointCommand {
    JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.15, 0.25, -0.1, 0.2]))
}

fn open(path: &str) -> Pa10Arm {
    let serial = SerialConfig { path: path.to_owned(), baud: 921_600, cycle: CYCLE };
    let link = GatewayLinkConfig {
        arm: ArmId(6),
        format: WireFormat::BigEndian6x10,
        geometry: Geometry::Unknown,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    };
    let config = Pa10ArmConfig::new("arm-6", DriverConfig::with_cycle(CYCLE), link);
    let seat = trip_line(1).unwrap().remove(0);
    let arm = Pa10Arm::open(config, Box::new(serial), Arc::new(SystemClock::new()), seat);
    arm.unwrap_or_else(|error| panic!("{error}: {:?}", std::error::Error::source(&error)))
}

/// Causes of a stop on a machine that is late.
const LATE: [&str; 2] = ["in a row without a usable reply", "the newest measurement is"];

/// On a loaded machine the link may pass the warm-up only after several tries.
fn enable(arm: &mut Pa10Arm) {
    for _ in 0..20 {
        match arm.enable() {
            Ok(()) => return,
            Err(error) if error.to_string().contains("the brakes stay closed") => {}
            Err(error) if LATE.iter().any(|mark| error.to_string().contains(mark)) => arm.reset().unwrap(),
            Err(error) => panic!("{error}"),
        }
    }
    panic!("the machine is too loaded to enable an arm");
}

/// The host: moves until the arm is stopped, prints the reason, and tries to continue without a reset; or panics in the control
/// loop.
pub fn host(path: &str, panics: bool) {
    let mut arm = open(path);
    enable(&mut arm);
    let mut moved = 0u32;
    let error = loop {
        std::thread::sleep(CYCLE);
        match arm.exchange(velocity()) {
            Ok(_) => {
                moved += 1;
                if moved == 30 {
                    println!("moving");
                }
                assert!(!(panics && moved == 60), "a mistake in the control loop");
            }
            Err(error) if error.kind() == ArmErrorKind::Timeout => {}
            Err(error) => break error,
        }
    };
    println!("stopped: {error}");
    println!("enabled again: {:?}", arm.enable().is_ok());
    println!("moved again: {:?}", arm.exchange(velocity()).is_ok());
    println!("state: {:?}", arm.state());
}

/// A host in its own process, its output, and its arm.
struct Scene {
    host: Child,
    lines: Receiver<String>,
    end: CellEnd,
    path: String,
}

impl Scene {
    /// With a moving arm.
    fn new() -> Self {
        Self::of(&["host"])
    }

    fn of(mode: &[&str]) -> Self {
        let pty = Pty::open().unwrap();
        let path = pty.name().to_owned();
        let home = JointVector::from([0.2, -0.5, 0.3, 1.1, 0.4, 0.9, 0.1]);
        let end = CellEnd::serve(Box::new(pty), Cell::new(ArmId(6), WireFormat::BigEndian6x10, home));
        let program = std::env::current_exe().unwrap();
        let [first, more @ ..] = mode else { panic!("{mode:?}") };
        let arguments = [&[*first, path.as_str()], more].concat();
        let mut host = Command::new(program).args(arguments).stdout(Stdio::piped()).spawn().unwrap();
        let output = BufReader::new(host.stdout.take().unwrap());
        let (out, lines) = channel();
        std::thread::spawn(move || {
            for line in output.lines() {
                let Ok(line) = line else { break };
                if out.send(line).is_err() {
                    break;
                }
            }
        });
        let scene = Self { host, lines, end, path };
        assert_eq!(scene.line(), "moving");
        assert_eq!(scene.end.state(), GatewayState::Moving);
        scene
    }

    fn line(&self) -> String {
        // The reason of its end is in the output above.
        self.lines
            .recv_timeout(LONG)
            .unwrap_or_else(|error| panic!("the host is gone ({error}): is the machine too loaded?"))
    }

    fn signal(&self, signal: Signal) -> Instant {
        kill_process(Pid::from_child(&self.host), signal).unwrap();
        Instant::now()
    }

    /// Waits until the brakes are closed and the stop order is complete, without the host.
    fn wait_until_braked(&self, cause: StopCause) {
        let begin = Instant::now();
        while !(self.end.cell().controller.is_braked() && self.end.state() == GatewayState::Fault) {
            assert!(begin.elapsed() < BRAKED_WITHIN, "not braked: {:?}", self.end.status());
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(self.end.status().cause, cause);
    }

    /// The next program is refused until it sends a reset; then the arm moves. Returns the message of the refusal.
    fn check_next_start(&self) -> String {
        self.check_still(Duration::from_millis(100));
        let mut arm = open(&self.path);
        assert_eq!(arm.state(), ArmState::Fault);
        let error = arm.enable().unwrap_err();
        assert_eq!(arm.exchange(velocity()).unwrap_err().kind(), ArmErrorKind::Fault);
        self.check_still(Duration::from_millis(100));
        arm.reset().unwrap();
        enable(&mut arm);
        for _ in 0..20 {
            std::thread::sleep(CYCLE);
            let _ = arm.exchange(velocity());
        }
        assert_eq!(self.end.state(), GatewayState::Moving);
        arm.stop().unwrap();
        error.to_string()
    }

    /// The true joints are stationary.
    fn check_still(&self, time: Duration) {
        let before = self.end.cell().position();
        std::thread::sleep(time);
        let moved = (self.end.cell().position() - before).amax();
        assert!(moved < 1e-6 && self.end.cell().controller.is_braked(), "moved by {moved} rad");
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        let _ = self.host.kill();
        let _ = self.host.wait();
    }
}

/// With kill -9: no code of the host runs any more that could stop the arm.
pub fn killed() {
    let mut scene = Scene::new();
    let before = scene.end.cell().position();
    let killed = scene.signal(Signal::KILL);
    scene.host.wait().unwrap();
    scene.wait_until_braked(StopCause::HostSilent);
    println!("killed: braked after {:?}", killed.elapsed());
    let moved = (scene.end.cell().position() - before).amax();
    // 50 ms at the full speed of 0.3 rad/s and the braking distance, with a margin for a loaded machine.
    assert!(moved < 0.1, "{moved} rad");
    let messages = scene.check_next_start();
    assert!(
        messages.contains("the gateway stopped the arm: host-silent; the program that drove the arm ended, hung"),
        "{messages}"
    );
}

/// A panic of the program on a good line: it stops its arm while it ends, and the gateway records this.
pub fn panicked() {
    let mut scene = Scene::of(&["host", "panic"]);
    assert!(!scene.host.wait().unwrap().success());
    scene.wait_until_braked(StopCause::HostFault);
    let messages = scene.check_next_start();
    assert!(
        messages.contains("the gateway stopped the arm: host-fault; the program that drove the arm found a fault"),
        "{messages}"
    );
}

/// A host that connects at once after the killed one waits until the gateway has stopped the arm.
pub fn killed_and_reset_at_once() {
    let mut scene = Scene::new();
    scene.signal(Signal::KILL);
    scene.host.wait().unwrap();
    let mut arm = open(&scene.path);
    assert_eq!(arm.state(), ArmState::Fault);
    arm.reset().unwrap();
    assert_eq!(arm.state(), ArmState::Disabled);
    assert_eq!(scene.end.state(), GatewayState::Idle);
    scene.check_still(Duration::from_millis(100));
    enable(&mut arm);
    arm.stop().unwrap();
}

/// With SIGSTOP: afterwards the host finds a stopped arm, and cannot continue without a reset.
pub fn frozen() {
    let scene = Scene::new();
    let frozen = scene.signal(Signal::STOP);
    scene.wait_until_braked(StopCause::HostSilent);
    println!("frozen: braked after {:?}", frozen.elapsed());
    scene.check_still(Duration::from_millis(300));
    scene.signal(Signal::CONT);
    let line = scene.line();
    assert!(line.starts_with("stopped: arm arm-6"), "{line}");
    println!("{line}");
    for expected in ["enabled again: false", "moved again: false", "state: Fault"] {
        assert_eq!(scene.line(), expected);
    }
    scene.check_still(Duration::from_millis(100));
}
