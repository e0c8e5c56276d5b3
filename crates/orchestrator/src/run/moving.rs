//! The half of a run that moves: both arms, the controller, and what each control step is to be remembered by.

use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector};
use pb3dp_servo::supervisor::{Decision, Permission};
use pb3dp_servo::{Command, ControlStep, Controller, Mode};
use pb3dp_sim::placement::FlangePath;
use pb3dp_sim::trajectory::Trajectory;

use super::both_arms::BothArms;
use super::carrier::carry;
use super::halves::Mover;
use super::percept::Percept;
use super::permitting::Permitting;
use crate::config::setup::{Carrier, Setup};
use crate::wiring::DrivenArm;

/// Both arms with what leads them.
pub struct Moving<'a> {
    setup: &'a Setup,
    arms: BothArms,
    /// The way of the arm that carries the target; none if it rests.
    path: Option<FlangePath<'a>>,
    controller: Controller,
    permitting: Permitting,
    damping: Damping,
    begin: MonotonicTime,
    stepped_at: Option<MonotonicTime>,
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
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            path: (setup.experiment.carrier == Carrier::Arm)
                .then(|| FlangePath::of_carrier(experiment, &setup.tc.world_from_base, &setup.flange_from_target)),
            begin,
            stepped_at: None,
            waited: Duration::ZERO,
            newest: None,
            setup,
        })
    }

    /// Both arms.
    pub fn arms(&self) -> &BothArms {
        &self.arms
    }

    /// What the controller wants, and what of it the arm that carries the cameras is to be told.
    fn decide(&mut self, now: MonotonicTime) -> (ControlStep, Decision, Command) {
        let observation = self.newest.as_ref().and_then(|percept| percept.observation.as_ref());
        let control = self.controller.step(self.arms.vs.joints(), observation, now);
        let arms = [&self.arms.vs, &self.arms.tc].map(|arm| (arm.condition(), arm.joints()));
        let decision = self.permitting.step(&control, self.newest.as_ref(), arms, now);
        let told = match (decision.permission, control.command) {
            (Permission::Move { share }, Command::Velocity(velocity)) => Command::Velocity(velocity * share),
            _ => Command::Hold,
        };
        if decision.rearm {
            self.controller.acquire();
        }
        (control, decision, told)
    }

    /// What the arm that carries the target is told: its way, which waits as long as no arm may move at all.
    fn carrying(&mut self, decision: &Decision, now: MonotonicTime) -> JointCommand {
        let since = self.stepped_at.replace(now).map_or(Duration::ZERO, |before| now.saturating_since(before));
        let Some(path) = &self.path else { return JointCommand::Hold };
        if decision.no_arm_may_move {
            self.waited += since;
            return JointCommand::Hold;
        }
        let t_s = now.seconds_since(self.begin) - self.waited.as_secs_f64();
        let position_rad = &self.arms.tc.joints().position_rad;
        JointCommand::Velocity(carry(&self.setup.tc.chain, &self.damping, path, t_s, position_rad))
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

    /// Nobody resets a run: a stop ends it. An arm that has failed says more about it than the supervisor knows.
    fn step(&mut self, now: MonotonicTime) -> Result<Moved> {
        let (control, decision, told) = self.decide(now);
        if decision.permission == Permission::Stop {
            self.arms.why_latched()?;
            bail!("{}", decision.why)
        }
        let carrying = self.carrying(&decision, now);
        self.arms.tc.exchange(carrying)?;
        self.tell(control.command, told)?;
        Ok(Moved { at: now, mode: control.mode, decision, vs_joints: *self.arms.vs.joints() })
    }

    fn stop(&mut self) -> Result<()> {
        self.arms.stop()
    }
}
