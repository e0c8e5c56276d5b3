//! State shared by all steps of a checklist: arm, operator, moves and measurements.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_arm_pa10::driver::Latched;
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_arm_pa10_protocol::gateway_protocol::HelloReply;
use pb3dp_cell::attended_motion::EndedByPerson;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::plan::Plan;
use pb3dp_cell::terminal::print_line;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand, JointState};
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::JointVector;
use pb3dp_setup::setup::Setup;
use pb3dp_wiring::commissioning::{SlowArm, wire_slow};

use super::super::confirm::Interrupted;
use super::super::drive::{self, Cycle, Drive};
use super::super::{Place, flights};
use super::limits::{OVER_SPEED, REST_RAD_PER_S, WRONG_WAY_DEG};
use super::operator::{Act, Operator, Question};
use super::report::{Answer, StepReport};
use super::test_line::TestLine;
use crate::arm::motion::JOG_RAD_PER_S;
use crate::commissioned::CommissioningRecord;

/// Share of a move's duration at which the operator has to act.
const ACT_AT: f64 = 0.35;
/// Reaction time of a person who reads NOW.
const PERSON_NEEDS: Duration = Duration::from_secs(4);
/// Below this speed at the stop, the test of the stop is inconclusive, rad/s.
const MOVING_RAD_PER_S: f64 = 0.25 * JOG_RAD_PER_S;
/// Interval at which an arm is checked while it stops.
const LOOK: Duration = Duration::from_millis(2);
/// Number of checks whether an arm has latched a stop.
const LATCHED_LOOKS: u32 = 25;
/// An arm without measurements for this long sends no more.
const QUIET: Duration = Duration::from_millis(500);
/// Longest time that any arm needs to stop.
const WATCHED_FOR: Duration = Duration::from_secs(4);
/// Time allowed for a reset: a gateway refuses it until the arm is stationary, and a plugged adapter needs a moment.
const RESET_WITHIN: Duration = Duration::from_secs(10);
/// Time between two reset attempts.
const RESET_AGAIN: Duration = Duration::from_millis(250);

/// State shared by all steps.
pub struct Session<'a> {
    /// Arm and setup from the command line.
    pub place: &'a Place,
    /// The setup with commissioning speeds.
    pub setup: Setup,
    /// The arm.
    pub choice: ArmChoice,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// Signals that end the test.
    pub signals: StopSignals,
    /// The operator.
    pub operator: Box<dyn Operator>,
    /// The axis that moves.
    pub axis: Axis,
    /// Angle of each move, rad.
    pub by_rad: f64,
    /// Joints at the beginning, rad.
    pub home_rad: JointVector,
    /// Properties reported by the gateway.
    pub gateway: HelloReply,
    /// The commissioning record of the arm.
    pub record: CommissioningRecord,
    /// Its file, if the setup names one and the arm is not emulated.
    pub record_file: Option<PathBuf>,
    /// Address and key of the arm, if it differs from the setup.
    pub line: Option<TestLine>,
    /// Output folder of the report.
    pub out: PathBuf,
    /// Report of the current step.
    pub report: StepReport,
}

/// Record of a stop.
pub struct Stop {
    /// Time of an action by the program.
    pub acted: Option<MonotonicTime>,
    /// Time at which the arm's driver noticed the stop.
    pub noticed: MonotonicTime,
    /// Cause of the stop.
    pub cause: String,
    /// State afterwards.
    pub state: ArmState,
    /// Last measurement before the stop.
    pub before: JointState,
    /// All measurements afterwards.
    pub after: Vec<JointState>,
}

impl Stop {
    /// Time to standstill, milliseconds; infinite if no standstill was measured.
    pub fn to_rest_ms(&self) -> f64 {
        let slow = |sample: &JointState| sample.velocity_rad_per_s.amax() <= REST_RAD_PER_S;
        match self.after.iter().rposition(|sample| !slow(sample)) {
            None if self.after.is_empty() => f64::INFINITY,
            None => 0.0,
            Some(last) => {
                let rested = self.after.get(last + 1);
                rested.map_or(f64::INFINITY, |sample| 1e3 * sample.at.seconds_since(self.noticed).max(0.0))
            }
        }
    }

    /// Speed of the fastest joint afterwards, rad/s.
    pub fn fastest_rad_per_s(&self) -> f64 {
        self.after.iter().map(|sample| sample.velocity_rad_per_s.amax()).fold(0.0, f64::max)
    }

    /// The joint that moved farthest, and its displacement from before the stop to the end, degrees.
    pub fn way(&self) -> (Axis, f64) {
        farthest(&self.before, self.after.last().unwrap_or(&self.before))
    }

    /// From the action of the program to the stop, milliseconds.
    pub fn noticed_ms(&self) -> Option<f64> {
        self.acted.map(|acted| 1e3 * self.noticed.seconds_since(acted))
    }
}

/// The joint that moved farthest, and its displacement, degrees.
pub fn farthest(before: &JointState, after: &JointState) -> (Axis, f64) {
    let way_rad = (after.position_rad - before.position_rad).abs();
    let axis = Axis::ALL[way_rad.imax()];
    (axis, way_rad[axis.index()].to_degrees())
}

/// Measurements during a move.
#[derive(Debug, Default)]
pub struct MoveObservation {
    /// Largest sag of a joint when the brakes opened, degrees.
    pub sagged_deg: f64,
    /// Largest lag of the axis behind its plan, degrees.
    pub behind_deg: f64,
    /// Largest motion of another joint, degrees.
    pub others_deg: f64,
    /// Largest speed in two consecutive samples, rad/s.
    pub fastest_rad_per_s: f64,
    opened_rad: Option<JointVector>,
    last: Option<JointState>,
    last_speed_rad_per_s: f64,
}

impl MoveObservation {
    fn take(&mut self, plan: &Plan, axis: Axis, cycle: &Cycle<'_>) -> Result<()> {
        let (joint, measured) = (axis.index(), cycle.measured);
        let opened_rad = *self.opened_rad.get_or_insert_with(|| {
            self.sagged_deg = (measured.position_rad - plan.start_rad()).amax().to_degrees();
            measured.position_rad
        });
        let mut moved = measured.position_rad - opened_rad;
        let turned_deg = moved[joint].to_degrees() * plan.by_rad()[joint].signum();
        moved[joint] = 0.0;
        self.others_deg = self.others_deg.max(moved.amax().to_degrees());
        if self.last.is_none_or(|last| measured.at > last.at) {
            // A measurement may be one cycle old, which counts as lag.
            let behind_rad = cycle.planned_rad[joint] - measured.position_rad[joint];
            self.behind_deg = self.behind_deg.max(behind_rad.abs().to_degrees());
            let speed = measured.velocity_rad_per_s[joint].abs();
            self.fastest_rad_per_s = self.fastest_rad_per_s.max(speed.min(self.last_speed_rad_per_s));
            self.last_speed_rad_per_s = speed;
            self.last = Some(*measured);
        }
        if turned_deg < -WRONG_WAY_DEG {
            bail!(
                "{axis} turns the wrong way: {turned_deg:.3} degrees, commanded was the other direction; the sign of its encoder or \
                 drive differs from the robot description"
            );
        }
        Ok(())
    }

    /// Largest allowed speed, rad/s.
    pub fn fastest_allowed_rad_per_s() -> f64 {
        OVER_SPEED * JOG_RAD_PER_S
    }
}

impl Session<'_> {
    /// Connects the arm, alone or with the other one; its brakes stay closed.
    ///
    /// # Errors
    /// If it does not answer, or is stopped.
    pub fn connect(&self, beside_other: bool) -> Result<SlowArm> {
        wire_slow(&self.setup, self.choice, beside_other, &self.clock)
    }

    /// Plans the next move: away from the start of the test, or back.
    ///
    /// # Errors
    /// If it leaves the operating range.
    pub fn plan(&self, arm: &mut SlowArm) -> Result<Plan> {
        let now_rad = arm.driven.exchange(JointCommand::Hold)?.position_rad;
        let joint = self.axis.index();
        let out = (now_rad[joint] - self.home_rad[joint]) * self.by_rad.signum();
        let by = if out > 0.25 * self.by_rad.abs() { -self.by_rad } else { self.by_rad };
        self.plan_by(now_rad, by)
    }

    /// Plans a move of the axis by this angle.
    ///
    /// # Errors
    /// If it leaves the operating range.
    pub fn plan_by(&self, from_rad: JointVector, by: f64) -> Result<Plan> {
        let mut by_rad = JointVector::zeros();
        by_rad[self.axis.index()] = by;
        Plan::new(self.choice.of(&self.setup), from_rad, by_rad)
    }

    /// A warning if a person has too little time after NOW.
    pub fn too_short_for_a_person(&self, plan: &Plan) -> Option<String> {
        let left = plan.duration().mul_f64(1.0 - ACT_AT);
        let is_short = !self.operator.is_prompt() && left < PERSON_NEEDS;
        // The speed is the same: twice the angle takes twice as long, or slightly less if the speed is hardly reached.
        let needed_deg = self.by_rad.to_degrees().abs() * PERSON_NEEDS.as_secs_f64() / left.as_secs_f64();
        is_short.then(|| {
            format!(
                "--by {:.1}: after NOW you have {:.1} s until the move ends, and a person needs {} s; use --by {:.0} or more",
                self.by_rad.to_degrees(),
                left.as_secs_f64(),
                PERSON_NEEDS.as_secs(),
                needed_deg.ceil().copysign(self.by_rad)
            )
        })
    }

    /// Makes an undisturbed move; closes the brakes afterwards.
    ///
    /// # Errors
    /// The cause of an abort.
    pub fn drive(&mut self, arm: &mut SlowArm, plan: &Plan) -> Result<(JointState, MoveObservation)> {
        let (axis, mut observation) = (self.axis, MoveObservation::default());
        let Self { operator, signals, clock, setup, .. } = self;
        let mut watch = |cycle: &Cycle<'_>| {
            operator.goes_on()?;
            observation.take(plan, axis, cycle)
        };
        let outcome = Drive::new(arm, plan, clock, setup.control_period).run(signals, &mut watch);
        Ok((drive::stopped_after(self.choice, arm, outcome)?, observation))
    }

    /// Plans the next move, in which the operator has to act, and announces it.
    ///
    /// # Errors
    /// If it leaves the operating range, or the operator declines.
    pub fn announce(&mut self, arm: &mut SlowArm, act: Act) -> Result<Plan> {
        let plan = self.plan(arm)?;
        let by_deg = plan.by_rad()[self.axis.index()].to_degrees();
        let text = format!(
            "Next, {} turns by {by_deg:+.1} degrees within {:.0} s. While it moves: {act}. Keep a hand on the emergency stop.",
            self.axis,
            plan.duration().as_secs_f64()
        );
        self.ready(&text, None)?;
        Ok(plan)
    }

    /// Checks the clearance to the other arm on the path.
    ///
    /// # Errors
    /// If it is less than allowed, or unknown.
    pub fn check_room(&self, arm: &mut SlowArm, plan: &Plan) -> Result<()> {
        let other = arm.other.as_mut().context("the other arm is not connected")?;
        let other_rad = other.driven.exchange(JointCommand::Hold)?.position_rad;
        plan.room(&self.setup, self.choice, &other_rad).check(&self.setup)
    }

    /// Opens the brakes of the other arm, which holds during the move of this one.
    ///
    /// # Errors
    /// The failure of an arm, or a signal.
    pub fn switch_other_on(&mut self, arm: &mut SlowArm, plan: &Plan) -> Result<()> {
        Drive::new(arm, plan, &self.clock, self.setup.control_period).switch_other_on(&mut self.signals)
    }

    /// Makes a move that the operator's action has to stop.
    ///
    /// # Errors
    /// If nothing stopped it, or another failure ended it.
    pub fn drive_until(&mut self, arm: &mut SlowArm, plan: &Plan, act: Act) -> Result<Stop> {
        let (axis, duration) = (self.axis, plan.duration());
        let (mut acted, mut last, mut observation) = (None, None, MoveObservation::default());
        let mut speed_rad_per_s = 0.0;
        let Self { operator, signals, clock, setup, .. } = self;
        let mut watch = |cycle: &Cycle<'_>| {
            operator.goes_on()?;
            observation.take(plan, axis, cycle)?;
            last = Some(*cycle.measured);
            speed_rad_per_s = plan.at(cycle.passed).1[axis.index()].abs();
            if acted.is_none() && cycle.passed >= duration.mul_f64(ACT_AT) {
                acted = Some(clock.now());
                operator.act(act)?;
            }
            Ok(())
        };
        let outcome = Drive::new(arm, plan, clock, setup.control_period).run(signals, &mut watch);
        let monitor = arm.monitor.clone().context("the arm has no link")?;
        // An arm that was not stopped must be stopped at once.
        let stopped = outcome.as_ref().err().filter(|error| is_stop(error)).map(|error| format!("{error:#}"));
        let latched = if stopped.is_some() { latched_soon(&monitor) } else { None };
        let (Some(cause), Some(latched)) = (stopped, latched) else {
            let ended = drive::stopped_after(self.choice, arm, outcome);
            ended.map_err(|error| match acted {
                Some(_) if !is_interruption(&error) => error.context(format!("the arm did not report a stop ({act})")),
                _ => error,
            })?;
            bail!("the move ended without a stop ({act}): repeat this step, and act while the arm moves");
        };
        if acted.is_none() || speed_rad_per_s < MOVING_RAD_PER_S {
            bail!(
                "the arm stopped at {speed_rad_per_s:.4} rad/s, at the start or the end of its move; the test is inconclusive: \
                 repeat this step, and act when NOW is written ({cause})"
            );
        }
        let before = last.context("no measurement")?;
        let after = self.watch_rest(&monitor, latched.at)?;
        Ok(Stop {
            acted: acted.filter(|_| self.operator.is_prompt()),
            noticed: latched.at,
            cause,
            state: arm.driven.state(),
            before,
            after,
        })
    }

    /// Collects the measurements of an arm from a time on, until no more arrive.
    ///
    /// # Errors
    /// [`Interrupted`].
    pub fn watch_rest(&mut self, monitor: &ArmMonitor, from: MonotonicTime) -> Result<Vec<JointState>> {
        let mut samples: Vec<JointState> = Vec::new();
        let begin = self.clock.now();
        let mut newest = begin;
        loop {
            let now = self.clock.now();
            if let Some(joints) = monitor.snapshot().joints
                && joints.at >= from
                && samples.last().is_none_or(|last| joints.at > last.at)
            {
                samples.push(joints);
                newest = now;
            }
            if now.saturating_since(newest) > QUIET || now.saturating_since(begin) > WATCHED_FOR {
                return Ok(samples);
            }
            self.pause(LOOK)?;
        }
    }

    /// Waits, unless a signal arrives.
    ///
    /// # Errors
    /// [`Interrupted`].
    pub fn pause(&mut self, time: Duration) -> Result<()> {
        let end = self.clock.now() + time;
        loop {
            if let Some(signal) = self.signals.try_take()? {
                return Err(Interrupted(signal).into());
            }
            let now = self.clock.now();
            if now >= end {
                return Ok(());
            }
            self.clock.sleep_until(end.min(now + Duration::from_millis(50)));
        }
    }

    /// Shows the next event and the requested action, and waits until the operator is ready.
    ///
    /// # Errors
    /// As [`Operator::ready`].
    pub fn ready(&mut self, text: &str, act: Option<Act>) -> Result<()> {
        self.operator.ready(text, act, &mut self.signals)
    }

    /// Asks the operator, and records the answer.
    ///
    /// # Errors
    /// If the operator does not answer.
    pub fn ask(&mut self, question: &Question) -> Result<()> {
        let yes = self.operator.ask(question, &mut self.signals)?;
        self.report.answers.push(Answer { question: question.to_string(), yes });
        if let (false, Question::Stopped(choice)) = (yes, question) {
            print_line(&format!("PRESS THE EMERGENCY STOP of the {}: nothing else may stop the arm", choice.name()))?;
        }
        Ok(())
    }

    /// Resets an arm as soon as it accepts the reset.
    ///
    /// # Errors
    /// If it does not accept within ten seconds.
    pub fn reset(&mut self, arm: &mut (impl ArmPower + ?Sized)) -> Result<()> {
        let begin = self.clock.now();
        loop {
            let Err(error) = arm.reset() else { return Ok(()) };
            if self.clock.now().saturating_since(begin) > RESET_WITHIN {
                let text = "the reset was refused for 10 s: remove the cause, then use `pb3dp arm reset`";
                return Err(anyhow::Error::new(error).context(text));
            }
            self.pause(RESET_AGAIN)?;
        }
    }

    /// Keeps the flight recorders of a failed step, and notes the files.
    ///
    /// # Errors
    /// Those of `outcome`.
    pub fn keep_if_failed(&mut self, arm: &SlowArm, outcome: Result<()>) -> Result<()> {
        let complaints = self.report.complaints();
        let failure = match &outcome {
            Err(error) => format!("{error:#}"),
            Ok(()) if complaints.is_empty() => return outcome,
            Ok(()) => complaints.join("; "),
        };
        let folder = self.out.join(self.report.step);
        for kept in flights::keep(&folder, self.choice, arm, &anyhow!("{failure}"), self.clock.now()) {
            match kept {
                Ok(path) => self.report.flights.push(path.display().to_string()),
                Err(error) => self.report.note(format!("{error:#}")),
            }
        }
        outcome
    }
}

/// The latched cause of a stop. The layers in front of an arm may latch a moment before its driver.
fn latched_soon(monitor: &ArmMonitor) -> Option<Latched> {
    (0..LATCHED_LOOKS).find_map(|look| {
        if look > 0 {
            std::thread::sleep(LOOK);
        }
        monitor.snapshot().latched
    })
}

/// Whether the arm, or a layer in front of it, has stopped by itself.
fn is_stop(error: &anyhow::Error) -> bool {
    use ArmErrorKind::{Disconnected, Fault, NotEnabled};
    let of_arm = error.chain().find_map(|cause| cause.downcast_ref::<ArmError>());
    of_arm.is_some_and(|error| matches!(error.kind(), Disconnected | Fault | NotEnabled))
}

/// Whether a signal or the operator has ended the test.
pub fn is_interruption(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| cause.is::<Interrupted>() || cause.is::<EndedByPerson>())
}

/// Checks that an arm refuses to be enabled and moved; an arm that does not refuse is stopped again.
pub fn refuses_motion(report: &mut StepReport, when: &str, arm: &mut (impl Arm + ArmPower + ?Sized)) {
    let enabled = arm.enable();
    let moved = arm.exchange(JointCommand::Velocity(JointVector::zeros()));
    if enabled.is_ok() {
        // Its effect shows in the figures.
        let _ = arm.stop();
    }
    let what = format!("motion is refused {when}");
    match (enabled, moved) {
        (Err(error), Err(_)) => report.holds(what, true, error.to_string()),
        (Ok(()), _) => report.holds(what, false, "the arm could be enabled"),
        (_, Ok(_)) => report.holds(what, false, "a velocity was accepted"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(at_ms: u64, angle_deg: f64, speed_rad_per_s: f64) -> JointState {
        JointState {
            at: MonotonicTime::from_nanos(at_ms * 1_000_000),
            position_rad: JointVector::repeat(angle_deg.to_radians()),
            velocity_rad_per_s: JointVector::from([0.0, 0.0, 0.0, speed_rad_per_s, 0.0, 0.0, 0.0]),
        }
    }

    fn stop(after: &[JointState]) -> Stop {
        let noticed = MonotonicTime::from_nanos(1_000_000_000);
        let (cause, state, before) = (String::new(), ArmState::EStop, sample(995, 10.0, 0.018));
        Stop { acted: None, noticed, cause, state, before, after: after.to_vec() }
    }

    #[test]
    fn an_arm_rests_from_the_first_measurement_on_after_which_it_is_never_fast() {
        let falls = [sample(1005, 10.0, 0.0), sample(1015, 10.2, -0.4), sample(1025, 10.5, 0.001)];
        let fell = stop(&falls);
        assert!((fell.to_rest_ms() - 25.0).abs() < 1e-9, "{}", fell.to_rest_ms());
        assert!((fell.way().1 - 0.5).abs() < 1e-9 && fell.fastest_rad_per_s() == 0.4);
        assert_eq!(stop(&falls[..2]).to_rest_ms(), f64::INFINITY, "no standstill was measured");
        assert_eq!(stop(&[]).to_rest_ms(), f64::INFINITY, "there is no measurement");
        assert_eq!(stop(&falls[..1]).to_rest_ms(), 0.0);
    }
}
