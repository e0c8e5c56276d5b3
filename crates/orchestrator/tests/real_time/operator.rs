//! Who may command arms that are not emulated, and what becomes of them when nobody is there.

use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink as _;
use pb3dp_test_support::{program_lines, programs_in_real_time_beside_others};

use crate::real_time::arm::{Cell, FIRST_RUN, START_DEG, WITHOUT_IMAGES, hil};

/// A run whose standard input is a terminal.
struct Led {
    program: Child,
    terminal: Pty,
    answers: Receiver<String>,
    log: Receiver<String>,
    lines_read: Vec<String>,
}

impl Led {
    fn start(cell: &Cell, settings: &[&str]) -> Self {
        let terminal = Pty::open().unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
        command.arg("run").arg("--config").arg(cell.config()).arg("--out").arg(cell.folder.path().join("out"));
        command.args(["--operator", "console"]).args(FIRST_RUN).args(WITHOUT_IMAGES).args(settings);
        command.stdin(File::open(terminal.path()).unwrap()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut program = command.spawn().unwrap();
        let (answers, log) =
            (program_lines(program.stdout.take().unwrap()), program_lines(program.stderr.take().unwrap()));
        Self { program, terminal, answers, log, lines_read: Vec::new() }
    }

    fn say(&mut self, line: &str) {
        assert_eq!(self.terminal.try_write(format!("{line}\n").as_bytes()), Ok(line.len() + 1));
    }

    /// Waits until a line contains this text, and repeats a command every second meanwhile.
    fn wait_for(&mut self, text: &str, again: Option<&str>) {
        let begin = Instant::now();
        while !self.lines_read.iter().any(|line| line.contains(text)) {
            assert!(begin.elapsed() < Duration::from_secs(90), "{text:?} was not written: {:#?}", self.lines_read);
            if let Some(again) = again {
                self.say(again);
            }
            std::thread::sleep(Duration::from_secs(1));
            self.lines_read.extend(self.answers.try_iter().chain(self.log.try_iter()));
        }
    }
}

impl Drop for Led {
    fn drop(&mut self) {
        self.program.kill().ok();
        self.program.wait().ok();
    }
}

/// The terminal is open, and nobody types: a frozen connection, or an operator who has left.
#[test]
fn a_terminal_at_which_nobody_types_holds_both_arms() {
    programs_in_real_time_beside_others(|| {
        let cell = Cell::start(&["--pose-deg", START_DEG]);
        let settings =
            ["--set", "supervisor.operator_key_within_s=5", "--set", "supervisor.policies.operator_silent.action=hold"];
        let mut run = Led::start(&cell, &settings);
        run.wait_for("select: selecting", Some("select"));
        run.wait_for("start: approaching", Some("start"));
        run.wait_for("are you there? press Enter now", None);
        run.wait_for("holding: the newest sign of life from the operator is 5.0", None);
        // Enter alone moves nothing.
        run.say("");
        run.lines_read.clear();
        run.wait_for("; use resume", Some("status"));
        run.say("quit");
        run.wait_for("report", None);
        drop(run);
        cell.arm.quit();
    });
}

/// Typed, or pasted, before the plan was on the screen: nobody has read it.
#[test]
fn a_name_typed_before_the_prompt_moves_nothing() {
    programs_in_real_time_beside_others(|| {
        let mut terminal = Pty::open().unwrap();
        let input = File::open(terminal.path()).unwrap();
        let mut say = |text: &str| assert_eq!(terminal.try_write(text.as_bytes()), Ok(text.len()));
        say("vs-robot\nvs-ro");
        let mut program = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
            .args(["arm", "jog", "--config", &hil(), "--arm", "vs", "--axis", "7", "--by", "0.5", "--move"])
            .stdin(input)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (answers, log) =
            (program_lines(program.stdout.take().unwrap()), program_lines(program.stderr.take().unwrap()));
        let within = Duration::from_secs(60);
        while !answers.recv_timeout(within).unwrap().contains("Type vs-robot to move it") {}
        assert!(answers.recv_timeout(Duration::from_secs(2)).is_err(), "it waits for a name");
        assert!(program.try_wait().unwrap().is_none());
        // A complete answer, not the rest of one that was begun before the prompt.
        say("no\n");
        let log: Vec<String> = log.iter().collect();
        assert!(!program.wait().unwrap().success());
        assert!(log.iter().any(|line| line.contains("typed \"no\" is not vs-robot; nothing was moved")), "{log:?}");
    });
}
