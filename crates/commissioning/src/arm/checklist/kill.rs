//! Step `kill`: the process that moves the arm is killed; only the gateway can stop the arm.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::ArmSnapshot;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::JointState;
use pb3dp_kinematics::JointVector;
use pb3dp_wiring::commissioning::see;
use rustix::process::{Pid, Signal, kill_process};

use super::super::drive::LATE_MAX;
use super::super::motion::{JointReport, settings_line};
use super::limits::{BRAKED_MAX_DEG, LEFT_ALONE};
use super::operator::Question;
use super::report::StepReport;
use super::session::{Session, refuses_motion};
use super::stops::{stopped_by_gateway, way};

/// Share of the move after which the process is killed.
const KILL_AT: f64 = 0.35;
/// Time allowed until the process has tested the link, opened the brakes and reports joints.
const STARTED_WITHIN: Duration = Duration::from_secs(20);
/// Interval at which signals are checked.
const LOOK: Duration = Duration::from_millis(20);
/// Time allowed for a process to end with its stop order.
const ENDS_WITHIN: Duration = Duration::from_secs(5);
/// Time between two measurements of an arm that must be stationary.
const BETWEEN_LOOKS: Duration = Duration::from_millis(500);

/// Runs the step.
///
/// # Errors
/// If the arm was not moved, or an operator does not answer.
pub fn run(session: &mut Session<'_>) -> Result<()> {
    let (choice, axis) = (session.choice, session.axis);
    let plan = {
        // The process to be killed needs the link for itself.
        let mut arm = session.connect(false)?;
        session.plan(&mut arm)?
    };
    let by_rad = plan.by_rad()[axis.index()];
    let text = format!(
        "Next, another program turns {axis} by {:+.1} degrees within {:.0} s, and is killed during the move. Keep a hand on the emergency stop.",
        by_rad.to_degrees(),
        plan.duration().as_secs_f64()
    );
    session.ready(&text, None)?;
    let begin = session.clock.now();
    let mut mover = Mover::start(session, by_rad)?;
    let last_rad = mover.moved(session, plan.start_rad(), (by_rad * KILL_AT, plan.duration()))?;
    mover.kill()?;
    let last_rad = mover.last_line().unwrap_or(last_rad);
    let killed = session.clock.now();
    let last = JointState { at: killed, position_rad: last_rad, velocity_rad_per_s: JointVector::zeros() };
    session.report.note(format!("killed {:.2} s after it was started", killed.seconds_since(begin)));
    session.pause(LEFT_ALONE)?;

    let observed = see(&session.setup, choice, &session.clock).map_err(|error| format!("{error:#}"));
    found_stopped(&mut session.report, observed.as_ref().map(|observed| observed.arm.monitor().snapshot()))?;
    session.ask(&Question::Stopped(choice))?;
    let Ok(mut observed) = observed else { return Ok(()) };
    if !session.report.complaints().is_empty() {
        return Ok(());
    }
    let monitor = observed.arm.monitor();
    refuses_motion(&mut session.report, "before the reset", &mut observed.arm);
    session.ready("Next, the arm is reset.", None)?;
    session.reset(&mut observed.arm)?;
    observed.arm.look()?;
    let rests = monitor.snapshot().joints.context("the arm reported no joints")?;
    session.pause(BETWEEN_LOOKS)?;
    observed.arm.look()?;
    let later = monitor.snapshot().joints.context("the arm reported no joints")?;
    way(session, &last, &rests);
    let moves_deg = (later.position_rad - rests.position_rad).amax().to_degrees();
    session.report.at_most("motion between two measurements afterwards", moves_deg, BRAKED_MAX_DEG, "deg");
    Ok(())
}

/// What the next process finds: an arm already stopped by its gateway.
fn found_stopped(report: &mut StepReport, observed: Result<ArmSnapshot, &String>) -> Result<()> {
    let latched = observed.map(|observed| observed.latched.map(|latched| latched.trip.to_string()));
    let found = match &latched {
        Ok(latched) => latched.clone().unwrap_or_else(|| "not stopped".to_owned()),
        Err(error) => format!("it cannot connect: {error}"),
    };
    report.holds("the next program finds the arm stopped", matches!(latched, Ok(Some(_))), found);
    let gateway = observed.ok().and_then(|observed| observed.gateway_found);
    if let Some(gateway) = gateway {
        stopped_by_gateway(report, gateway.state, gateway.cause);
    }
    if !report.complaints().is_empty() {
        let is = gateway.map_or_else(|| "unknown".to_owned(), |gateway| gateway.state.to_string());
        print_line(&format!("PRESS THE EMERGENCY STOP: the gateway has not stopped the arm, its state is {is}"))?;
    }
    Ok(())
}

/// A separate process that moves the arm. Dropping it ends it with its stop order.
struct Mover {
    child: Child,
    lines: Receiver<String>,
}

impl Mover {
    fn start(session: &Session<'_>, by_rad: f64) -> Result<Self> {
        let program = std::env::current_exe().context("the path of this program is unknown")?;
        let mut command = Command::new(program);
        command.args(["--log", "warn", "arm", "jog", "--alone", "--move", "--report-joints"]);
        command.args(session.place.setup.words()).args(["--arm", session.place.arm_word()]);
        command.args(["--axis", &session.axis.number().to_string(), "--by", &by_rad.to_degrees().to_string()]);
        if let Some(line) = &session.line {
            command.args(["--line", &line.address.to_string()]).arg("--line-key").arg(line.key.file());
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().context("cannot start the process that moves the arm")?;
        let (input, output) = (child.stdin.take(), child.stdout.take());
        let (sender, lines) = channel();
        let mover = Self { child, lines };
        let output = output.context("the process that moves the arm has no output")?;
        let read = move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        };
        std::thread::Builder::new().name("mover".to_owned()).spawn(read).context("no thread for its lines")?;
        // The operator has already typed the name for these settings, and the clearance on the path is known.
        let mut input = input.context("the process that moves the arm has no input")?;
        writeln!(input, "{}", settings_line(&session.setup)?).context("the process that moves the arm has ended")?;
        Ok(mover)
    }

    /// Waits until the axis has turned by this angle; returns the joints then, rad.
    fn moved(
        &mut self,
        session: &mut Session<'_>,
        from_rad: &JointVector,
        (by_rad, duration): (f64, Duration),
    ) -> Result<JointVector> {
        let joint = session.axis.index();
        let patience = STARTED_WITHIN + duration + LATE_MAX;
        let begin = Instant::now();
        loop {
            session.pause(Duration::ZERO)?;
            session.operator.goes_on()?;
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => {
                    let Some(position_rad) = joints_of(&line) else { continue };
                    if (position_rad[joint] - from_rad[joint]) / by_rad >= 1.0 {
                        return Ok(position_rad);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    bail!("the process that moves the arm has ended by itself: see above")
                }
            }
            if begin.elapsed() > patience {
                bail!("the process did not move the arm within {patience:?}: see above");
            }
        }
    }

    fn kill(&mut self) -> Result<()> {
        self.child.kill().context("cannot kill the process that moves the arm")?;
        self.child.wait().context("cannot wait for the killed process").map(drop)
    }

    /// The last joints that it reported before it was killed.
    fn last_line(&self) -> Option<JointVector> {
        let mut last = None;
        // Its end closes the pipe, which ends the thread and with it these lines.
        while let Ok(line) = self.lines.recv_timeout(LOOK) {
            last = joints_of(&line).or(last);
        }
        last
    }
}

impl Drop for Mover {
    fn drop(&mut self) {
        if !matches!(self.child.try_wait(), Ok(None)) {
            return;
        }
        if let Some(pid) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            // It may have ended meanwhile.
            kill_process(pid, Signal::TERM).ok();
        }
        let begin = Instant::now();
        while begin.elapsed() < ENDS_WITHIN {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::sleep(LOOK);
        }
        // Its gateway then stops the arm.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The joints in an output line of the process, if the line has any.
fn joints_of(line: &str) -> Option<JointVector> {
    serde_json::from_str::<JointReport>(line).ok().map(|report| JointVector::from(report.position_rad))
}
