//! Runs the program as a user does: writes commands, reads lines.

use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use pb3dp_hal_platform::realtime::now;
use rustix::process::{Pid, Signal, kill_process};

use crate::report::note;

const PROGRAM: &str = "/bin/pb3dp";

/// Timeout for any action of the program, in the time of this computer.
const LONG: Duration = Duration::from_secs(30);

/// A command is repeated after this time.
const AGAIN: Duration = Duration::from_millis(500);

/// Number of last lines that are shown when an expected line is missing.
const LAST_LINES: usize = 30;

/// Output of the program without input.
pub fn once(args: &[&str]) -> Result<Output, Box<dyn Error>> {
    Ok(Command::new(PROGRAM).args(args).output().map_err(|error| format!("{PROGRAM}: {error}"))?)
}

/// A running program, with its output.
pub struct Running {
    child: Child,
    input: ChildStdin,
    lines: Receiver<String>,
    output_lines: Vec<String>,
}

impl Running {
    pub fn start(args: &[&str]) -> Result<Self, Box<dyn Error>> {
        let mut command = Command::new(PROGRAM);
        command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| format!("{PROGRAM}: {error}"))?;
        let input = child.stdin.take().ok_or("no input")?;
        let (say, lines) = channel();
        let outputs: [Option<Box<dyn Read + Send>>; 2] = [
            child.stdout.take().map(|stream| Box::new(stream) as _),
            child.stderr.take().map(|stream| Box::new(stream) as _),
        ];
        for stream in outputs.into_iter().flatten() {
            let say = say.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(stream).lines().map_while(Result::ok) {
                    if say.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        Ok(Self { child, input, lines, output_lines: Vec::new() })
    }

    pub fn say(&mut self, typed: &str) -> Result<(), Box<dyn Error>> {
        Ok(writeln!(self.input, "{typed}").and_then(|()| self.input.flush())?)
    }

    /// Gives a command and waits for a line with this text; repeats the command whenever no line comes for a while.
    pub fn wait_for(&mut self, part: &str, typed: Option<&str>) -> Result<String, Box<dyn Error>> {
        typed.map_or(Ok(()), |typed| self.say(typed))?;
        let end = Instant::now() + LONG;
        while Instant::now() < end {
            match self.lines.recv_timeout(AGAIN) {
                Ok(line) => {
                    self.output_lines.push(format!("{:.2} s: {line}", now().as_nanos() as f64 * 1e-9));
                    if let Some(line) = self.output_lines.last().filter(|line| line.contains(part)) {
                        return Ok(line.clone());
                    }
                }
                // Without a command only Enter: somebody is there.
                Err(RecvTimeoutError::Timeout) => self.say(typed.unwrap_or_default())?,
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Err(self.untold(part))
    }

    /// The error that this line did not come; first shows the last lines.
    fn untold(&self, what: &str) -> Box<dyn Error> {
        let last = self.output_lines.len().saturating_sub(LAST_LINES);
        self.output_lines[last..].iter().for_each(|line| note(line));
        format!("the program did not print `{what}` within {LONG:?}").into()
    }

    /// Ctrl-C.
    pub fn interrupt(&self) -> Result<(), Box<dyn Error>> {
        Ok(kill_process(Pid::from_child(&self.child), Signal::INT)?)
    }

    /// Waits until the program has ended.
    pub fn end(mut self) -> Result<ExitStatus, Box<dyn Error>> {
        loop {
            match self.lines.recv_timeout(LONG) {
                Ok(line) => self.output_lines.push(line),
                Err(RecvTimeoutError::Disconnected) => return Ok(self.child.wait()?),
                Err(RecvTimeoutError::Timeout) => return Err(self.untold("its end")),
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // A program that nothing waited for is no longer needed.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
