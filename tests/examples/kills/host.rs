//! `pb3dp run` with a terminal, at which an operator types.

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink as _;
use pb3dp_test_support::program_lines;

use crate::files::Files;

/// Time in which a run begins, on a busy machine.
const BEGINS_WITHIN: Duration = Duration::from_secs(90);
/// Interval between two tries of a command that may come too early.
const AGAIN: Duration = Duration::from_millis(500);
/// Words of the log after which a run does not go on by itself.
const STOPPED: [&str; 2] = ["stopped: ", "fault: "];

/// A run in progress.
pub struct Host {
    program: Child,
    terminal: Pty,
    written: [Receiver<String>; 2],
    lines_read: Vec<String>,
}

impl Host {
    /// Starts a run of this cell.
    pub fn start(program: &Path, files: &Files) -> Result<Self> {
        let terminal = Pty::open()?;
        let input = File::open(terminal.path())?;
        let mut command = Command::new(program);
        command.args(["run", "--operator", "console", "--config"]).arg(files.setup());
        command.arg("--out").arg(files.path("out")).current_dir(files.path("."));
        let mut program = command.stdin(input).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let (Some(answers), Some(log)) = (program.stdout.take(), program.stderr.take()) else { bail!("no pipes") };
        Ok(Self { program, terminal, written: [program_lines(answers), program_lines(log)], lines_read: Vec::new() })
    }

    /// Types a line.
    pub fn say(&mut self, line: &str) -> Result<()> {
        let written = self.terminal.try_write(format!("{line}\n").as_bytes());
        ensure!(written == Ok(line.len() + 1), "{line:?} cannot be typed: {written:?}");
        Ok(())
    }

    /// Selects and starts; whether the hand tracks then.
    pub fn lead_to_tracking(&mut self) -> Result<bool> {
        Ok(self.says("select", "select: selecting")?
            && self.says("start", "approaching")?
            && self.says("", "tracking")?)
    }

    /// Repeats a line until the answer comes; false if the run stops before.
    fn says(&mut self, line: &str, answer: &str) -> Result<bool> {
        let begin = Instant::now();
        while begin.elapsed() < BEGINS_WITHIN {
            self.read();
            if self.lines_read.iter().any(|line| line.contains(answer)) {
                return Ok(true);
            }
            if self.lines_read.iter().any(|line| STOPPED.iter().any(|term| line.contains(term))) {
                return Ok(false);
            }
            if let Some(status) = self.program.try_wait()? {
                self.read();
                bail!("the run ended with {status} before {answer:?}:\n{}", self.lines_read.join("\n"));
            }
            self.say(line)?;
            std::thread::sleep(AGAIN);
        }
        bail!("{answer:?} was not written:\n{}", self.lines_read.join("\n"))
    }

    fn read(&mut self) {
        self.lines_read.extend(self.written.iter().flat_map(Receiver::try_iter));
    }

    /// SIGKILL.
    pub fn kill(&mut self) {
        // One that has ended already is no matter.
        let _ = self.program.kill();
        let _ = self.program.wait();
    }

    /// Waits until the program has ended, and gives what it has written.
    pub fn end_by_itself(&mut self) -> Result<String> {
        let begin = Instant::now();
        while self.program.try_wait()?.is_none() {
            self.read();
            ensure!(begin.elapsed() < BEGINS_WITHIN, "the run goes on:\n{}", self.lines_read.join("\n"));
            std::thread::sleep(Duration::from_millis(20));
        }
        // Until both pipes are empty.
        let rest: Vec<_> = self.written.iter().flat_map(Receiver::iter).collect();
        self.lines_read.extend(rest);
        Ok(self.lines_read.join("\n"))
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        self.kill();
    }
}
