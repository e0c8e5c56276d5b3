//! The half of a run that moves: both arms, the controller, and what each control step is to be remembered by.

use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector};
use pb3dp_servo::supervisor::{Decision, Event, Permission, State, Word};
use pb3dp_servo::{Command, ControlStep, Controller, Mode};
use pb3dp_sim::placement::FlangePath;
use pb3dp_sim::trajectory::Trajectory;

use super::both_arms::BothArms;
use super::carrier::{carry, off_by};
use super::halves::Mover;
use super::operator::{ByCommand, Operator};
use super::percept::Percept;
use super::permitting::Permitting;
use crate::config::setup::{Carrier, Setup};
use crate::wiring::DrivenArm;

/// An arm that carries the target and is farther from its way after a stop was led elsewhere meanwhile, metres and radians.
const AWAY_M: f64 = 0.05;
const AWAY_RAD: f64 = 0.17;

/// Both arms with what leads them.
pub struct Moving<'a> {
    setup: &'a Setup,
    arms: BothArms,
    /// The way of the arm that carries the target; none if it rests.
    path: Option<FlangePath<'a>>,
    controller: Controller,
    permitting: Permitting,
    operator: Box<dyn Operator>,
    /// Both arms are stopped, and wait for the operator's reset and selection.
    is_stopped: bool,
    damping: Damping,
    begin: MonotonicTime,
    stepped_at: Option<MonotonicTime>,
    /// The arm that carries the target is not on its way, and rests.
    is_away: bool,
    /// For how long the way of the arm that carries the target has waited.
    waited: Duration,
    newest: Option<Percept>,
}

/// One control step.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// When it was begun.
    pub at: MonotonicTime,
    /// What the controller was doing.
    pub mode: Mode,
    /// What the supervisor made of it.
    pub decision: Decision,
    /// The arm that carries the cameras, as it was measured.
    pub vs_joints: JointState,
}

impl<'a> Moving<'a> {
    /// Arms that are not yet switched on. The experiment begins at `begin`.
    ///
    /// # Errors
    /// A parameter of the controller or the supervisor out of its range.
    pub fn new(
        setup: &'a Setup,
        arms: (Box<dyn DrivenArm>, Box<dyn DrivenArm>),
        experiment: &'a dyn Trajectory,
        begin: MonotonicTime,
    ) -> Result<Self> {
        let limiter = &setup.vs.limiter;
        let limits = limiter.hard_limits.with_position_range(limiter.operating_min_rad, limiter.operating_max_rad)?;
        Ok(Self {
            arms: BothArms::new(setup, arms, begin),
            controller: Controller::new(setup.controller, setup.vs.chain.clone(), limits)?,
            permitting: Permitting::new(&setup.supervisor, limits)?,
            operator: Box::new(ByCommand),
            is_stopped: false,
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            path: (setup.experiment.carrier == Carrier::Arm)
                .then(|| FlangePath::of_carrier(experiment, &setup.tc.world_from_base, &setup.flange_from_target)),
            begin,
            stepped_at: None,
            is_away: false,
            waited: Duration::ZERO,
            newest: None,
            setup,
        })
    }

    /// The same, told by somebody else than the command itself.
    pub fn with_operator(self, operator: Box<dyn Operator>) -> Self {
        Self { operator, ..self }
    }

    /// Both arms.
    pub fn arms(&self) -> &BothArms {
        &self.arms
    }

    /// What the controller wants, and what of it the arm that carries the cameras is to be told.
    fn decide(&mut self, now: MonotonicTime) -> (ControlStep, Decision, Command) {
        let observation = self.newest.as_ref().and_then(|percept| percept.observation.as_ref());
        let control = self.controller.step(self.arms.vs.joints(), observation, now);
        let heard = self.operator.listen(self.permitting.last(), now);
        if self.is_stopped && heard.said.is_some_and(|said| said.word == Word::Reset) {
            // What is latched in an arm itself goes first; the supervisor refuses as long as it is still there.
            let cleared = self.arms.reset();
            self.tell_of(cleared);
        }
        let arms = [&self.arms.vs, &self.arms.tc].map(|arm| (arm.condition(), arm.joints()));
        let decision = self.permitting.step(heard, &control, self.newest.as_ref(), arms, now);
        self.operator.show(&decision);
        let told = match (decision.permission, control.command) {
            (Permission::Move { share }, Command::Velocity(velocity)) => Command::Velocity(velocity * share),
            _ => Command::Hold,
        };
        self.controller.permit_search(decision.search);
        if decision.rearm {
            self.controller.acquire();
        }
        (control, decision, told)
    }

    /// What the arm that carries the target is told: its way, which waits as long as no arm may move at all.
    fn carrying(&mut self, decision: &Decision, now: MonotonicTime) -> JointCommand {
        let since = self.stepped_at.replace(now).map_or(Duration::ZERO, |before| now.saturating_since(before));
        let Some(path) = &self.path else { return JointCommand::Hold };
        // Where a person leads, nothing at all moves before the word.
        let has_begun = !matches!(decision.state, State::Idle | State::Selecting) || !self.operator.is_person();
        if decision.no_arm_may_move || !has_begun {
            self.waited += since;
            return JointCommand::Hold;
        }
        let t_s = now.seconds_since(self.begin) - self.waited.as_secs_f64();
        let position_rad = &self.arms.tc.joints().position_rad;
        let (off_m, off_rad) = off_by(&self.setup.tc.chain, path, t_s, position_rad);
        let was_away =
            std::mem::replace(&mut self.is_away, self.operator.is_person() && (off_m > AWAY_M || off_rad > AWAY_RAD));
        if self.is_away {
            self.waited += since;
            if !was_away {
                let (off_mm, off_deg) = (off_m * 1e3, off_rad.to_degrees());
                self.operator.tell(Some(format!(
                    "tc-robot is {off_mm:.0} mm and {off_deg:.0} degrees from its way and rests: bring it back to its start, then begin the run anew"
                )));
            }
            return JointCommand::Hold;
        }
        JointCommand::Velocity(carry(&self.setup.tc.chain, &self.damping, path, t_s, position_rad))
    }

    /// Both arms rest with brakes on until a person resets them. Where there is none the run ends; an arm that has failed says more about
    /// it than the supervisor knows.
    fn stay_stopped(&mut self, decision: &Decision) -> Result<()> {
        if !self.operator.is_person() {
            self.arms.why_latched()?;
            bail!("{}", decision.why)
        }
        if self.is_stopped {
            self.arms.look();
            return Ok(());
        }
        self.is_stopped = true;
        let why = self.arms.why_latched();
        self.tell_of(why);
        let stopped = self.arms.stop();
        self.tell_of(stopped);
        Ok(())
    }

    /// Behind the reset both arms stay off until a target is selected; then they are switched on where they are.
    fn leave_stop(&mut self, decision: &Decision) {
        if decision.transition.is_none_or(|transition| transition.event != Event::Select) {
            self.arms.look();
            return;
        }
        let on = self.arms.enable_here();
        self.is_stopped = on.is_err();
        self.operator.tell(None);
        if self.is_stopped {
            self.arms.stop().ok();
            self.tell_of(on);
        }
        // A target that was seen before is not the one that was selected.
        self.newest = None;
    }

    fn tell_of(&mut self, outcome: Result<()>) {
        if let Err(trouble) = outcome {
            self.operator.tell(Some(format!("{trouble:#}")));
        }
    }

    /// Tells the arm that carries the cameras; the controller gets to know what its joints do now, if that is not what it wanted.
    fn tell(&mut self, wanted: Command, told: Command) -> Result<()> {
        let measured = self.arms.vs.exchange(match told {
            Command::Velocity(velocity) => JointCommand::Velocity(velocity),
            Command::Hold => JointCommand::Hold,
        })?;
        let done = match (measured, told) {
            // An arm that did not answer holds until it is told again.
            (None, Command::Velocity(_)) => Command::Velocity(JointVector::zeros()),
            _ => told,
        };
        if done != wanted {
            self.controller.note_told(done);
        }
        Ok(())
    }
}

impl Mover for Moving<'_> {
    type Step = Moved;

    fn enable(&mut self) -> Result<()> {
        self.arms.enable()
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    fn observe(&mut self, percept: Percept, _now: MonotonicTime) {
        self.newest = Some(percept);
    }

    fn step(&mut self, now: MonotonicTime) -> Result<Moved> {
        let (control, decision, told) = self.decide(now);
        let moved = Moved { at: now, mode: control.mode, decision, vs_joints: *self.arms.vs.joints() };
        if decision.permission == Permission::Stop {
            self.stay_stopped(&decision)?;
            return Ok(moved);
        }
        if self.is_stopped {
            self.leave_stop(&decision);
            return Ok(moved);
        }
        let carrying = self.carrying(&decision, now);
        let exchanged = self.arms.tc.exchange(carrying).and_then(|_| self.tell(control.command, told));
        if let Err(failure) = exchanged {
            // What is latched is the supervisor's from the next step on, and a person's; anything else ends the run.
            if !(self.operator.is_person() && self.arms.is_latched()) {
                return Err(failure);
            }
            self.operator.tell(Some(format!("{failure:#}")));
        }
        Ok(Moved { vs_joints: *self.arms.vs.joints(), ..moved })
    }

    fn stop(&mut self) -> Result<()> {
        self.arms.stop()
    }
}
