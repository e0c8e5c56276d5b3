//! `pb3dp mock-arm`: an operator types, hosts connect.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::FileTypeExt;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use crate::cli::support::pb3dp;

pub struct MockArm {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl MockArm {
    pub fn start(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
        // Should the tests be killed, the arm ends by itself.
        command.arg("mock-arm").args(["--stop-after", "120"]).args(args);
        if args.contains(&"--tcp") {
            command.arg("--key").arg(super::support::key_file());
        }
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let (input, output) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        Self { child, input, output }
    }

    pub fn line(&mut self) -> String {
        let mut line = String::new();
        assert!(self.output.read_line(&mut line).unwrap() > 0, "it has ended");
        line.trim_end().to_owned()
    }

    pub fn say(&mut self, line: &str) {
        writeln!(self.input, "{line}").unwrap();
    }

    /// The lines of a report, up to the last one.
    pub fn state(&mut self) -> Vec<String> {
        self.say("state");
        let mut lines = vec![self.line()];
        while !lines.last().unwrap().starts_with("thread:") {
            lines.push(self.line());
        }
        lines
    }

    pub fn quit(mut self) {
        self.say("quit");
        let until = Instant::now() + Duration::from_secs(10);
        while Instant::now() < until {
            if let Some(status) = self.child.try_wait().unwrap() {
                assert!(status.success());
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("it does not end");
    }
}

/// A test that is tried again must not have the arms of its failures beside it, which go before other threads.
impl Drop for MockArm {
    fn drop(&mut self) {
        // It may have ended by itself.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

#[test]
fn it_prints_its_terminal_and_obeys_what_is_typed() {
    let mut arm = MockArm::start(&["--format", "a", "--fault", "at 0s jump 2 1deg", "--pose-deg", "0,-30,0,60,0,45,0"]);
    let path = arm.line();
    assert!(std::fs::metadata(&path).unwrap().file_type().is_char_device(), "{path}");
    arm.say("alarm 4 0x0e");
    arm.say("not a fault");
    let state = arm.state();
    assert_eq!(state[0], "controller: adjustment mode, all brakes closed");
    assert_eq!(state[2], "  axis 2 (S2)   -30.000 deg     0.000 deg/s  brake");
    assert!(state.contains(&"faults so far: alarm 1, jump 1".to_owned()), "{state:?}");
    arm.quit();
}

#[test]
fn it_listens_on_tcp_or_a_socket() {
    let mut arm = MockArm::start(&["--tcp", "127.0.0.1:0"]);
    let address = arm.line();
    std::net::TcpStream::connect(&address).unwrap();
    arm.quit();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bus");
    let mut arm = MockArm::start(&["--bus", path.to_str().unwrap()]);
    assert_eq!(arm.line(), path.to_str().unwrap());
    assert!(std::fs::metadata(&path).unwrap().file_type().is_socket());
    assert!(!arm.state().iter().any(|line| line.starts_with("gateway")), "the controller alone");
    arm.quit();
    assert!(!path.exists());
}

#[test]
fn what_it_can_not_do_is_refused_by_name() {
    let refused = |args: &[&str], parts: &[&str]| pb3dp(&[&["mock-arm"], args].concat()).assert_refused(parts);
    refused(&["--fault", "chance 1 drop 1"], &["the chance is `1`; write a part such as 1% of messages"]);
    refused(&["--watchdog", "0s"], &["\"0s\" is neither a time such as 6ms nor none"]);
    refused(&["--pose-deg", "0,30,0"], &["is not seven angles in degrees"]);
    refused(&["--pose-deg", "0,120,0,0,0,0,0"], &["--pose-deg", "axis 2 starts at 120.00"]);
    refused(&["--limits-deg", "177,94,174,-137,255,165,255"], &["axis 4 (E1): a limit of -2.39", "out of range"]);
    refused(&["--bus", "x", "--tcp", "127.0.0.1:0", "--key", "x"], &["cannot be used with"]);
    refused(&["--tcp", "127.0.0.1:0"], &["--key <FILE>"]);
    refused(&["--tcp", "127.0.0.1:0", "--key", "/nowhere/key"], &["key file /nowhere/key: cannot be read"]);
    refused(&["--bus", "/nowhere/bus"], &["/nowhere/bus"]);
    refused(&["--script", "/nowhere/faults"], &["script /nowhere/faults cannot be read"]);
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("faults");
    std::fs::write(&script, "drop 1\nat 2 drop 1\n").unwrap();
    refused(&["--script", script.to_str().unwrap()], &["line 2: the time is `2`"]);
}
