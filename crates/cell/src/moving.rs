//! The motion half of a run: both arms, the controller, and the record of each control step.

use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_geometry::frames::{Base, Model, Surface};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{ArmError, ArmErrorKind, EnablePosition, JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector};
use pb3dp_servo::supervisor::{
    ArmCondition, Decision, Event, OperatorCommand, OperatorInput, OperatorRequest, Permission, State, Supervisor,
};
use pb3dp_servo::{Command, Controller, Mode, Servo, ServoInput, ServoStep};
use pb3dp_setup::setup::{Carrier, Setup};
use pb3dp_sim::placement::FlangePath;
use pb3dp_sim::trajectory::Trajectory;

use super::aim::Aim;
use super::both_arms::{BothArms, CellArm, error_text};
use super::carrier::{carry, off_by};
use super::devices::ArmControl;
use super::halves::{CameraArmStep, Mover};
use super::operator::{ByCommand, MotionRequest, Operator};
use super::percept::Percept;
use crate::log::ArmSample;

/// With this error after a stop, the arm that carries the target was moved off its path meanwhile; metres and radians.
const AWAY_M: f64 = 0.05;
const AWAY_RAD: f64 = 0.17;

/// Interval after which an arm that is still enabled after a stop is stopped again.
const STOP_AGAIN: Duration = Duration::from_millis(100);

/// Both arms with controller, supervisor and operator.
pub struct Moving<'a> {
    setup: &'a Setup,
    arms: BothArms,
    /// Path of the arm that carries the target; none if that arm holds.
    path: Option<FlangePath<'a>>,
    servo: Servo,
    /// The desired pose of the hand.
    aim: Aim,
    operator: Box<dyn Operator>,
    /// A rest that only a person could end was reported.
    is_hold_reported: bool,
    /// Both arms are stopped and wait for the operator's reset and selection.
    is_stopped: bool,
    /// Cause of the stop, as reported by the arms.
    why_stopped: Option<String>,
    /// State of a command refused by an arm; only with a console operator.
    refusal: Refusal,
    /// Time of the next stop order to an arm that is still enabled; none before that is known.
    stop_again_at: Option<MonotonicTime>,
    damping: Damping,
    begin: MonotonicTime,
    stepped_at: Option<MonotonicTime>,
    /// The arm that carries the target is off its path and holds.
    is_away: bool,
    /// How long the path of the arm that carries the target has been paused.
    waited: Duration,
    newest: Option<Percept>,
    /// A result that no step has used yet.
    observed: Option<Percept>,
    /// Number of the next step.
    number: u64,
}

/// Progress of a refused command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refusal {
    None,
    InStepBefore,
    /// Reported; the operator has not resumed yet.
    Reported,
}

/// One control step.
#[derive(Clone, Copy, Debug)]
pub struct StepRecord {
    /// Number of the step, from 0.
    pub number: u64,
    /// Begin of the step.
    pub at: MonotonicTime,
    /// The result of a pair that this step is the first to use.
    pub observed: Option<Percept>,
    /// Pose of the target at the time of the joint sample, by the filter.
    pub base_from_model: Option<Pose<Base, Model>>,
    /// The surface for which the desired pose of the hand is meant.
    pub model_from_surface: Pose<Model, Surface>,
    /// Controller mode.
    pub mode: Mode,
    /// Decision of the supervisor.
    pub decision: Decision,
    /// Measured joints of the arm that carries the cameras.
    pub vs_joints: JointState,
    /// The arm that carries the cameras, and the one that carries the target.
    pub arms: [ArmSample; 2],
    /// State of their drives and brakes.
    pub conditions: [ArmCondition; 2],
}

impl<'a> Moving<'a> {
    /// Arms that are not enabled yet. The experiment begins at `begin`.
    ///
    /// # Errors
    /// A parameter of the controller or the supervisor out of its range.
    pub fn new(
        setup: &'a Setup,
        arms: (Box<dyn ArmControl>, Box<dyn ArmControl>),
        experiment: &'a dyn Trajectory,
        begin: MonotonicTime,
    ) -> Result<Self> {
        Ok(Self {
            arms: BothArms::new(setup, arms, begin),
            servo: Servo::new(
                Controller::new(setup.controller, setup.rig.arms.vs.chain.clone(), setup.rig.arms.vs.limits)?,
                Supervisor::new(setup.supervisor.clone())?,
            ),
            aim: Aim::new(&setup.controller.model_from_hand_desired),
            operator: Box::new(ByCommand),
            is_hold_reported: false,
            is_stopped: false,
            why_stopped: None,
            refusal: Refusal::None,
            stop_again_at: None,
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            path: (setup.experiment.carrier == Carrier::Arm).then(|| {
                FlangePath::of_carrier(experiment, &setup.rig.arms.tc.world_from_base, &setup.rig.flange_from_target)
            }),
            begin,
            stepped_at: None,
            is_away: false,
            waited: Duration::ZERO,
            newest: None,
            observed: None,
            number: 0,
            setup,
        })
    }

    /// The same with another operator than [`ByCommand`].
    pub fn with_operator(self, operator: Box<dyn Operator>) -> Self {
        Self { operator, ..self }
    }

    /// Both arms.
    pub fn arms(&self) -> &BothArms {
        &self.arms
    }

    /// One step of controller and supervisor, with the command permitted for the arm that carries the cameras.
    fn decide(&mut self, now: MonotonicTime) -> ServoStep {
        let operator = self.listen(now);
        let MotionRequest { speed_share, hand_from_hand_shifted } = self.operator.motion();
        let input = ServoInput {
            joints: self.arms.vs.joints(),
            observation: self.newest.as_ref().and_then(|percept| percept.observation.as_ref()),
            estimate: self.newest.map(|percept| percept.estimate),
            frame: self.newest.map(|percept| percept.frame),
            operator,
            speed_share,
            arms: [&self.arms.vs, &self.arms.tc].map(CellArm::input),
        };
        let step = self.servo.step(&input, now);
        if let Some(desired) = self.aim.shift(hand_from_hand_shifted) {
            self.servo.set_model_from_hand_desired(desired);
        }
        self.operator.show(&step.decision);
        self.warn_if_only_operator_can_resume(&step.decision);
        self.align(&step.decision);
        step
    }

    /// Where the hand begins an approach, its desired pose is that relative to the surface as it is known now.
    fn align(&mut self, decision: &Decision) {
        let event = decision.transition.map(|transition| transition.event);
        if !matches!(event, Some(Event::Start | Event::Resume | Event::Realign)) {
            return;
        }
        if let Some(desired) = self.aim.align(self.newest.map(|percept| percept.estimate.target)) {
            self.servo.set_model_from_hand_desired(desired);
            self.servo.approach_again();
        }
    }

    /// Warns once of a rest that only a person could end, where nobody can type `resume`.
    fn warn_if_only_operator_can_resume(&mut self, decision: &Decision) {
        if decision.why.waits_for_resume() && self.operator.is_nobody() && !self.is_hold_reported {
            self.is_hold_reported = true;
            tracing::warn!(
                "the arms rest until the run ends: without a console nobody can use resume; use --operator console"
            );
        }
    }

    /// Reads the operator input. A reset that the supervisor would accept also clears the faults latched in the arms; while a fault
    /// remains, the supervisor refuses it.
    fn listen(&mut self, now: MonotonicTime) -> OperatorInput {
        let input = self.operator.listen(self.servo.last_decision(), now);
        let input = self.held_if_refused(input, now);
        let conditions = [&self.arms.vs, &self.arms.tc].map(CellArm::condition);
        if !input.request.is_some_and(|request| self.servo.would_reset(request, conditions, now)) {
            return input;
        }
        if let Some(name) = self.arms.still_enabled() {
            self.operator.tell(Some(format!(
                "reset refused: the drives of {name} are still enabled; the stop order is repeated; if they stay enabled, use the emergency stop"
            )));
            return OperatorInput { request: None, ..input };
        }
        match self.arms.reset() {
            Ok(()) => {
                self.why_stopped = None;
                self.operator.tell(None);
            }
            Err(trouble) => self.operator.tell(Some(error_text(&trouble))),
        }
        input
    }

    /// After a refused command both arms hold as after the command `hold`; only `stop` takes precedence. The refusal is shown until the
    /// operator resumes.
    fn held_if_refused(&mut self, input: OperatorInput, now: MonotonicTime) -> OperatorInput {
        let command = input.request.map(|request| request.command);
        match (self.refusal, command) {
            (Refusal::InStepBefore, Some(OperatorCommand::Stop)) => self.refusal = Refusal::Reported,
            (Refusal::InStepBefore, _) => {
                self.refusal = Refusal::Reported;
                return OperatorInput {
                    request: Some(OperatorRequest { command: OperatorCommand::Hold, at: now }),
                    ..input
                };
            }
            (Refusal::Reported, Some(OperatorCommand::Resume | OperatorCommand::Start)) => {
                self.refusal = Refusal::None;
                self.operator.tell(None);
            }
            (Refusal::None | Refusal::Reported, _) => {}
        }
        input
    }

    /// Returns the measurement. With a console operator, an arm that refuses a command only holds and the run continues.
    fn hold_after_refusal(&mut self, exchanged: Result<Option<JointState>>) -> Result<Option<JointState>> {
        let Err(failure) = exchanged else { return exchanged };
        let kind = failure.downcast_ref::<ArmError>().map(ArmError::kind);
        if kind != Some(ArmErrorKind::Rejected) || !self.operator.is_person() || self.arms.is_latched() {
            return Err(failure);
        }
        if self.refusal == Refusal::None {
            tracing::warn!("both arms hold because a command was refused: {}", error_text(&failure));
        }
        self.operator.tell(Some(error_text(&failure)));
        self.refusal = Refusal::InStepBefore;
        Ok(None)
    }

    /// Command for the arm that carries the target: its path, which pauses while no arm may move.
    fn carrying(&mut self, decision: &Decision, now: MonotonicTime) -> JointCommand {
        let since = self.stepped_at.replace(now).map_or(Duration::ZERO, |before| now.saturating_since(before));
        let Some(path) = &self.path else { return JointCommand::Hold };
        // With a person who commands, nothing moves before the command `start`.
        let has_begun =
            !matches!(decision.state, State::Idle | State::Selecting) || self.operator.carries_before_start();
        if decision.no_arm_may_move || !has_begun {
            self.waited += since;
            return JointCommand::Hold;
        }
        let t_s = now.seconds_since(self.begin) - self.waited.as_secs_f64();
        let position_rad = &self.arms.tc.joints().position_rad;
        let (off_m, off_rad) = off_by(&self.setup.rig.arms.tc.chain, path, t_s, position_rad);
        let was_away =
            std::mem::replace(&mut self.is_away, self.operator.is_person() && (off_m > AWAY_M || off_rad > AWAY_RAD));
        if self.is_away {
            self.waited += since;
            if !was_away {
                let (off_mm, off_deg) = (off_m * 1e3, off_rad.to_degrees());
                self.operator.tell(Some(format!(
                    "tc-robot holds: {off_mm:.0} mm and {off_deg:.0} degrees off its path; move it back to its start pose, then start a new run"
                )));
            }
            return JointCommand::Hold;
        }
        JointCommand::Velocity(carry(&self.setup.rig.arms.tc.chain, &self.damping, path, t_s, position_rad))
    }

    /// Keeps both arms stopped with closed brakes until the operator resets them. Without a console operator the run ends; the cause from a
    /// failed arm is preferred because it has more detail than the supervisor's.
    fn stay_stopped(&mut self, decision: &Decision, now: MonotonicTime) -> Result<()> {
        if !self.operator.is_person() {
            self.arms.why_latched()?;
            bail!("{}", decision.why.without_console())
        }
        if self.is_stopped && !self.arms.is_enabling() {
            self.stay_off(now);
            return Ok(());
        }
        self.is_stopped = true;
        let why = self.arms.why_latched();
        self.stop_because(why);
        Ok(())
    }

    /// Stops both arms; the operator gets the first cause.
    fn stop_because(&mut self, why: Result<()>) {
        let stopped = self.arms.stop();
        self.stop_again_at = None;
        let later = if why.is_err() { stopped.as_ref().err().map(error_text) } else { None };
        self.why_stopped = why.and(stopped).as_ref().err().map(error_text);
        if let Some(why) = &self.why_stopped {
            tracing::error!("{why}");
            self.operator.tell(Some(why.clone()));
        }
        if let Some(later) = later {
            tracing::error!("after the first failure: {later}");
        }
    }

    /// Measures arms that must be disabled; one that is still enabled after a stop gets the stop order again at intervals.
    fn stay_off(&mut self, now: MonotonicTime) {
        self.arms.look();
        if self.arms.still_enabled().is_none() {
            self.stop_again_at = None;
            return;
        }
        let again_at = *self.stop_again_at.get_or_insert(now + STOP_AGAIN);
        if now < again_at {
            return;
        }
        // A stop takes time: the interval to the next one starts with the following step.
        self.stop_again_at = None;
        match self.arms.stop_still_on() {
            Ok(()) => self.operator.tell(self.why_stopped.clone()),
            Err(trouble) => tracing::error!("{}", error_text(&trouble)),
        }
    }

    /// After the reset both arms stay disabled until a target is selected. Then they are enabled at their current pose, over as many steps
    /// as necessary.
    fn leave_stop(&mut self, decision: &Decision, now: MonotonicTime) {
        let is_selected = decision.transition.is_some_and(|transition| transition.event == Event::Select);
        if is_selected {
            self.operator.tell(None);
            // A target seen earlier is not the selected one.
            self.newest = None;
        } else if !self.arms.is_enabling() {
            self.stay_off(now);
            return;
        }
        match self.arms.enable(EnablePosition::Here) {
            Ok(are_on) => self.is_stopped = !are_on,
            Err(why) => {
                let next = if self.arms.is_latched() { "reset" } else { "select" };
                self.operator.answer(format!(
                    "enabling failed: {}; both arms are stopped; remove the cause, then use {next}",
                    error_text(&why)
                ));
                self.stop_because(Err(why));
            }
        }
    }

    /// Commands the arm that carries the cameras.
    fn command(&mut self, command: Command) -> Result<()> {
        let exchanged = self.arms.vs.exchange(match command {
            Command::Velocity(velocity) => JointCommand::Velocity(velocity),
            Command::Hold => JointCommand::Hold,
        });
        if self.hold_after_refusal(exchanged)?.is_none() && command != Command::Hold {
            // An arm that did not answer holds until the next command.
            self.servo.set_executed_command(Command::Velocity(JointVector::zeros()));
        }
        Ok(())
    }
}

impl CameraArmStep for StepRecord {
    fn camera_arm_joints(&self) -> &JointState {
        &self.vs_joints
    }
}

impl Mover for Moving<'_> {
    type Step = StepRecord;

    fn enable(&mut self) -> Result<bool> {
        self.arms.enable(EnablePosition::Start)
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    fn observe(&mut self, percept: Percept, _now: MonotonicTime) {
        self.aim.see(&percept);
        self.newest = Some(percept);
        self.observed = Some(percept);
    }

    fn step(&mut self, now: MonotonicTime) -> Result<StepRecord> {
        let moved = self.step_both(now)?;
        self.operator.end_step();
        Ok(moved)
    }

    fn stop(&mut self) -> Result<()> {
        self.arms.stop()
    }
}

impl Moving<'_> {
    /// One control step of both arms.
    fn step_both(&mut self, now: MonotonicTime) -> Result<StepRecord> {
        let ServoStep { command, control, decision } = self.decide(now);
        let arms = [self.arms.vs.sample(), self.arms.tc.sample()];
        let conditions = [&self.arms.vs, &self.arms.tc].map(CellArm::condition);
        let vs_joints = *self.arms.vs.joints();
        let (mode, base_from_model) = (control.mode, control.base_from_model);
        let (number, observed) = (self.number, self.observed.take());
        self.number += 1;
        let model_from_surface = self.aim.model_from_surface();
        let moved = StepRecord {
            number,
            at: now,
            observed,
            base_from_model,
            model_from_surface,
            mode,
            decision,
            vs_joints,
            arms,
            conditions,
        };
        if decision.permission == Permission::Stop {
            self.stay_stopped(&decision, now)?;
            return Ok(moved);
        }
        if self.is_stopped {
            self.leave_stop(&decision, now);
            return Ok(moved);
        }
        let carrying = self.carrying(&decision, now);
        let carried = self.arms.tc.exchange(carrying);
        let exchanged = self.hold_after_refusal(carried).and_then(|_| self.command(command));
        if let Err(failure) = exchanged {
            // A latched fault goes to the supervisor in the next step, and to the operator; any other failure ends the run.
            let failure = self.arms.traced(failure);
            if !(self.operator.is_person() && self.arms.is_latched()) {
                return Err(failure);
            }
            self.operator.tell(Some(error_text(&failure)));
        }
        let arms = [self.arms.vs.sample(), self.arms.tc.sample()];
        Ok(StepRecord { vs_joints: *self.arms.vs.joints(), arms, ..moved })
    }
}
