//! `pb3dp gateway` as a process, between an emulated controller and a host: how it ends, is killed and is held up.
#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests may fail the test")]

use std::fs::File;
use std::io::Write;
use std::net::{SocketAddr, TcpListener};
use std::os::unix::fs::PermissionsExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

use crate::cli::support::key_file;
use pb3dp_arm_pa10::arm::{KeyedTcp, read_shared_key};
use pb3dp_arm_pa10::driver::{DriverState, Request};
use pb3dp_arm_pa10_emulation::mock_controller::ControlMode;
use pb3dp_arm_pa10_gateway::bus::{BusPort, FRAME_ROOM, FrameListener};
use pb3dp_arm_pa10_protocol::gateway_protocol::StopCause;
use pb3dp_arm_pa10_test_support::world::{self, ARM, Emulation, Host, LONG, ms};
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_hal_platform::transport::Connector;
use pb3dp_test_support::programs_in_real_time_beside_others;
use rustix::process::{Pid, Signal, kill_process};

/// Of the emulated controller.
const TIME_OUT: Duration = Duration::from_millis(400);

/// A gateway as a process, its controller and its host.
struct Scene {
    child: Child,
    emulation: Emulation,
    host: Host,
    folder: tempfile::TempDir,
    /// The log before this test held the gateway up: only lateness of which it tells may be the machine's.
    log_before_stop: Option<String>,
}

impl Drop for Scene {
    fn drop(&mut self) {
        // One that ended already is no matter.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            let _ = writeln!(std::io::stderr(), "{}", self.log());
        }
    }
}

/// Runs a test with a scene in motion. A failure carries the line in which the gateway says that it was too late, if it says so: whether
/// the machine was late as well, its witnesses say.
fn with_scene(test: impl FnOnce(&mut Scene)) {
    let mut scene = Scene::start();
    let Err(failure) = catch_unwind(AssertUnwindSafe(|| {
        scene.lead_to_moving();
        test(&mut scene);
    })) else {
        return;
    };
    let text = failure.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| failure.downcast_ref::<&str>().copied()).unwrap_or("a panic without a text");
    let log = scene.log_before_stop.take().unwrap_or_else(|| scene.log());
    let late = log.lines().find(|line| line.contains("cycle-missed"));
    panic!("{text}; the gateway: {}", late.unwrap_or("no cycle missed"));
}

/// The file that is shipped, with longer times: tests run on loaded machines.
fn configuration(folder: &Path, bus: &Path, address: SocketAddr) -> std::path::PathBuf {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/gateway.toml");
    let mut text = std::fs::read_to_string(shipped).unwrap();
    for (from, to) in [
        ("number = 1", "number = 2".to_owned()),
        ("port = \"arcnet:arc0\"", format!("port = \"socket:{}\"", bus.display())),
        ("line = \"tcp:127.0.0.1:4534\"", format!("line = \"tcp:{address}\"")),
        ("\"arm1.key\"", format!("{:?}", key_file())),
        ("cycle_millis = 2.0", "cycle_millis = 10.0".to_owned()),
        ("lateness_allowed_millis = 2.0", "lateness_allowed_millis = 150.0".to_owned()),
        ("ramp_after_millis = 20.0", "ramp_after_millis = 100.0".to_owned()),
        ("stop_after_millis = 50.0", "stop_after_millis = 200.0".to_owned()),
        ("priority = 80", "priority = 20".to_owned()),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, &to, 1);
    }
    let file = folder.join("gateway.toml");
    std::fs::write(&file, text).unwrap();
    file
}

impl Scene {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bus = folder.path().join("bus");
        let listener = FrameListener::bind(&bus).unwrap();
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
            .args(["gateway", "--config"])
            .arg(configuration(folder.path(), &bus, address))
            .stderr(File::create(folder.path().join("log")).unwrap())
            .spawn()
            .unwrap();
        let socket = wait_for("the gateway opens its bus", || listener.try_accept().unwrap());
        let emulation = Emulation::start(Box::new(socket), Some(TIME_OUT));
        let key = read_shared_key(&key_file()).unwrap();
        let mut gateway = KeyedTcp { tcp: TcpConfig { address }, key, arm: ARM };
        let link = wait_for("the gateway listens", || gateway.connect().ok());
        let host = Host::new(link);
        Self { child, emulation, host, folder, log_before_stop: None }
    }

    fn lead_to_moving(&mut self) {
        self.host.open();
        self.host.lead_to_moving();
        assert!(!self.emulation.observed().is_braked);
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    fn signal(&mut self, signal: Signal) {
        if signal == Signal::STOP {
            self.log_before_stop = Some(self.log());
        }
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    fn ended(&mut self) -> ExitStatus {
        let child = &mut self.child;
        wait_for("the gateway ends", || child.try_wait().unwrap())
    }

    fn must_be_braked(&self) {
        self.emulation.wait_for("braked", |observed| observed.is_braked && observed.mode == ControlMode::Adjustment);
    }
}

fn wait_for<T>(what: &str, mut is: impl FnMut() -> Option<T>) -> T {
    let since = Instant::now();
    loop {
        if let Some(value) = is() {
            return value;
        }
        assert!(since.elapsed() < LONG, "never: {what}");
        std::thread::sleep(ms(5));
    }
}

#[test]
fn a_signal_ends_it_through_the_stop_order() {
    programs_in_real_time_beside_others(|| {
        for signal in [Signal::TERM, Signal::INT, Signal::QUIT, Signal::USR1] {
            with_scene(|scene| {
                scene.signal(signal);
                assert!(scene.ended().success());
                scene.must_be_braked();
                // E came: the controller did not have to stop by itself.
                let counters = scene.emulation.observed().counters;
                assert_eq!((counters.watchdog_trips, counters.forbidden, counters.malformed), (0, 0, 0));
                let log = scene.log();
                for part in ["gateway of arm 2", "moving -> stopping", "stopping -> idle", "ended idle", "cycles"] {
                    assert!(log.contains(part), "{part} not in {log}");
                }
                scene.host.run_for(LONG, |host| host.is_gone);
                assert_eq!(scene.host.driver.state(), DriverState::Fault);
            });
        }
    });
}

/// Ctrl-Z at its terminal, or a read or a write in the background.
#[test]
fn no_key_suspends_it_while_the_arm_moves() {
    programs_in_real_time_beside_others(|| {
        with_scene(|scene| {
            for signal in [Signal::TSTP, Signal::TTIN, Signal::TTOU] {
                scene.signal(signal);
                assert!(!scene.host.run_for(ms(300), |host| host.driver.state() != DriverState::Moving), "{signal:?}");
            }
            scene.signal(Signal::TERM);
            assert!(scene.ended().success());
            scene.must_be_braked();
            assert_eq!(scene.emulation.observed().counters.watchdog_trips, 0);
        });
    });
}

/// The host may be gone when somebody asks what happened: the log of the gateway names axis and alarm.
#[test]
fn its_log_names_axis_and_alarm_of_a_fault() {
    programs_in_real_time_beside_others(|| {
        with_scene(|scene| {
            scene.emulation.inject("alarm 4 0x0e");
            let expected_line = "moving -> fault: servo-alarm: axis 4 (E1), status word 0x";
            wait_for("it says so", || scene.log().contains(expected_line).then_some(()));
            assert!(scene.log().contains("alarm 0x0e (over-current)"), "{}", scene.log());
            scene.host.run_for(LONG, |host| host.driver.state() == DriverState::Fault);
            scene.signal(Signal::TERM);
            assert!(scene.ended().success());
            assert!(scene.log().contains("the gateway was stopped by servo-alarm: axis 4 (E1)"), "{}", scene.log());
        });
    });
}

/// Standard error is a pipe that is full: the stop order does not wait for the log.
#[test]
fn a_signal_is_obeyed_while_the_log_is_held_up() {
    let folder = tempfile::tempdir().unwrap();
    let bus = folder.path().join("bus");
    let listener = FrameListener::bind(&bus).unwrap();
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let (unread, full) = std::io::pipe().unwrap();
    let mut filler = full.try_clone().unwrap();
    // Ends when nobody can read any more.
    let filling = std::thread::spawn(move || while filler.write_all(&[b'x'; 4096]).is_ok() {});
    std::thread::sleep(ms(100));
    let mut child = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
        .args(["gateway", "--config"])
        .arg(configuration(folder.path(), &bus, address))
        .stderr(full)
        .spawn()
        .unwrap();
    let mut socket = wait_for("the gateway opens its bus", || listener.try_accept().unwrap());
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let mut buffer = [0; FRAME_ROOM];
    let end = wait_for("the gateway leaves its bus", || socket.try_receive(&mut buffer).err());
    assert!(child.try_wait().unwrap().is_none(), "{end}: it still waits for its log");
    drop(unread);
    wait_for("the gateway ends", || child.try_wait().unwrap());
    filling.join().unwrap();
}

/// kill -9: nobody is left to stop the arm but the controller, and the host does not move before an operator resets.
#[test]
fn after_a_kill_the_controller_stops_the_arm() {
    programs_in_real_time_beside_others(|| {
        with_scene(|scene| {
            scene.signal(Signal::KILL);
            scene.ended();
            scene.must_be_braked();
            assert_eq!(scene.emulation.observed().counters.watchdog_trips, 1);
            scene.host.run_for(LONG, |host| host.driver.state() == DriverState::Fault);
            let now = pb3dp_hal_platform::realtime::now();
            assert!(scene.host.driver.handle_request(now, Request::Move(world::velocity())).is_err());
            assert!(scene.host.driver.handle_request(now, Request::Enable).is_err());
        });
    });
}

/// SIGSTOP: the controller stops the arm, and a gateway that wakes up again latches.
#[test]
fn a_gateway_that_was_held_up_latches() {
    programs_in_real_time_beside_others(|| {
        with_scene(|scene| {
            scene.signal(Signal::STOP);
            scene.must_be_braked();
            assert_eq!(scene.emulation.observed().counters.watchdog_trips, 1);
            scene.signal(Signal::CONT);
            wait_for("it latches", || scene.log().contains("cycle-missed").then_some(()));
            scene.host.run_for(LONG, |host| host.driver.state() == DriverState::Fault);
            scene.host.link.open(pb3dp_hal_platform::realtime::now());
            assert!(scene.host.run_for(LONG, |host| host.link.hello().is_some()));
            assert_eq!(scene.host.link.hello().unwrap().cause, StopCause::CycleMissed);
            scene.signal(Signal::TERM);
            assert!(scene.ended().success());
            assert!(scene.log().contains("a new gateway does not keep this state"));
        });
    });
}

#[test]
fn what_can_not_be_had_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let nobody = folder.path().join("nobody");
    let address = "127.0.0.1:0".parse().unwrap();
    let file = configuration(folder.path(), &nobody, address);
    let failed = |extra: &[&str], expected: &str| {
        let out = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
            .args(["gateway", "--config", file.to_str().unwrap()])
            .args(extra)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(!out.status.success() && text.contains(expected), "{expected} not in {text}");
    };
    failed(&[], "no program listens at the socket");
    failed(&["--bus", "arcnet:nix0"], "there is no network interface nix0");
    failed(&["--bus", "arcnet:lo"], "is of type 772, not ARCNET (7)");
    failed(&["--bus", "usb"], "write arcnet:INTERFACE or socket:PATH");
    failed(&["--host", "tcp:here:1"], "use serial:DEVICE, local:PATH or tcp:ADDRESS:PORT");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = format!("tcp:{}", taken.local_addr().unwrap());
    failed(&["--host", &host], "check whether another program uses this port");
}

#[test]
fn a_tcp_gateway_without_a_key_does_not_start() {
    let folder = tempfile::tempdir().unwrap();
    let file = configuration(folder.path(), &folder.path().join("nobody"), "127.0.0.1:0".parse().unwrap());
    let key = folder.path().join("arm2.key");
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.replace(&format!("{:?}", key_file()), "\"arm2.key\"")).unwrap();
    let run = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_pb3dp")).arg("gateway").args(args).output().unwrap();
        (out.status.success(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let start = || run(&["--config", file.to_str().unwrap()]).1;
    let text = start();
    assert!(text.contains("access.key_file") && text.contains("arm2.key: cannot be read"), "{text}");
    let (is_made, text) = run(&["key", key.to_str().unwrap()]);
    assert!(is_made, "{text}");
    let secret = std::fs::read_to_string(&key).unwrap();
    assert!(!text.contains(secret.trim()) && text.contains("arm2.key"), "{text}");
    assert!(!run(&["key", key.to_str().unwrap()]).0, "an existing key is kept");
    assert!(start().contains("no program listens at the socket"), "the key is accepted");
    std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o644)).unwrap();
    let text = start();
    assert!(text.contains("its mode is 0644, allowed are 0600 and 0400: run `chmod 600"), "{text}");
    assert!(!text.contains(secret.trim()), "{text}");
}
