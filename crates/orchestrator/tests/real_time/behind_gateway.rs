//! `pb3dp arm` before `pb3dp gateway`, a mock arm behind it as the controller on the bus.

use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::cli::mock_arm::MockArm;
use crate::cli::support::{key_file, repository};
use crate::real_time::arm::{START_DEG, assert_problem, pb3dp_arm, setup_at, setup_behind};
use pb3dp_test_support::programs_in_real_time_beside_others;

/// A gateway as a program of its own, and the controller behind it.
struct Gateway {
    program: Program,
    controller: MockArm,
    _folder: TempDir,
}

/// Ends with this, also when a test fails.
struct Program(Child);

impl Drop for Program {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

impl Gateway {
    /// At this host line, with longer times than those of the shipped file: tests run on loaded machines.
    fn start(stop_after_millis: &str, line: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bus = folder.path().join("bus").display().to_string();
        let mut controller = MockArm::start(&["--bus", &bus, "--watchdog", "400ms", "--pose-deg", START_DEG]);
        controller.line();
        let shipped = std::fs::read_to_string(repository().join("configs/gateway.toml")).unwrap();
        let text = [
            ("port = \"arcnet:arc0\"", format!("port = \"socket:{bus}\"")),
            ("tcp:127.0.0.1:4534", line.to_owned()),
            ("\"arm1.key\"", format!("{:?}", key_file())),
            ("cycle_millis = 2.0", "cycle_millis = 10.0".to_owned()),
            ("lateness_allowed_millis = 2.0", "lateness_allowed_millis = 45.0".to_owned()),
            ("stop_after_millis = 50.0", format!("stop_after_millis = {stop_after_millis}")),
            ("priority = 80", "priority = 45".to_owned()),
        ]
        .iter()
        .fold(shipped, |text, (from, to)| crate::cli::support::replaced(&text, from, to));
        // The speeds of the drives: the setup moves faster than the shipped gateway allows.
        let text = [("= 0.25,", "= 1.0,"), ("= 0.5,", "= 2.0,"), ("= 1.5708,", "= 6.28,")]
            .iter()
            .fold(text, |text, (from, to)| text.replace(from, to));
        let file = folder.path().join("gateway.toml");
        std::fs::write(&file, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
        let child = command.args(["gateway", "--config"]).arg(file).stderr(Stdio::null()).spawn().unwrap();
        let program = Program(child);
        let until = Instant::now() + Duration::from_secs(20);
        let listens = || match line.split_once(':').unwrap() {
            ("tcp", address) => TcpStream::connect(address).is_ok(),
            (_, path) => UnixStream::connect(path).is_ok(),
        };
        while !listens() {
            assert!(Instant::now() < until, "the gateway does not listen");
            std::thread::sleep(Duration::from_millis(10));
        }
        Self { program, controller, _folder: folder }
    }

    fn end(self) {
        drop(self.program);
        self.controller.quit();
    }
}

/// R10, R11: the limiter cannot leave room for an arm that goes on for longer than it knows of.
#[test]
fn a_gateway_that_stops_later_than_the_limiter_counts_on_moves_nothing() {
    programs_in_real_time_beside_others(|| {
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut gateway = Gateway::start("120.0", &format!("tcp:{address}"));
        let folder = setup_at(&address.to_string());
        let file = folder.path().join("cell.toml");
        let config = file.display().to_string();
        let values = ["stops the arm 120ms after the last command", "limit 50ms (command_timeout_millis of the arm"];
        let jog = ["jog", "--axis", "7", "--by", "1", "--move"];
        pb3dp_arm(&config, &jog, Some("vs-robot")).assert_refused(&values);
        assert_problem(&pb3dp_arm(&config, &["probe"], None), &values);
        assert_eq!(gateway.controller.state()[0], "controller: adjustment mode, all brakes closed");
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(&file, text.replacen("command_timeout_millis = 50.0", "command_timeout_millis = 120.0", 1))
            .unwrap();
        let finished = pb3dp_arm(&config, &["jog", "--axis", "7", "--by", "1"], None).assert_success();
        assert!(finished.stdout.contains("dry run"), "{}", finished.stdout);
        gateway.end();
    });
}

#[test]
fn an_arm_is_moved_through_a_gateway_of_the_same_computer() {
    programs_in_real_time_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("arm1.sock").display().to_string();
        let setup = setup_behind("local", &format!("socket = \"{socket}\""));
        let config = setup.path().join("cell.toml").display().to_string();
        assert_problem(&pb3dp_arm(&config, &["probe"], None), &["no program listens at the socket", &socket]);
        let mut gateway = Gateway::start("50.0", &format!("local:{socket}"));
        let probed = pb3dp_arm(&config, &["probe", "--exchanges", "20"], None).assert_success();
        assert!(
            probed.stdout.contains("gateway: \"pb3dp gateway") && probed.stdout.contains("0 lost"),
            "{}",
            probed.stdout
        );
        let before = gateway.controller.state();
        pb3dp_arm(&config, &["jog", "--axis", "7", "--by", "1", "--move"], Some("vs-robot")).assert_success();
        assert_ne!(gateway.controller.state(), before, "the arm stands elsewhere");
        gateway.end();
    });
}
