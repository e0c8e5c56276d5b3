//! The half of a run that moves: both arms, the controller, and what each control step is to be remembered by.

use anyhow::{Result, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{JointCommand, JointState};
use pb3dp_kinematics::Damping;
use pb3dp_servo::supervisor::{Decision, Permission};
use pb3dp_servo::{Command, Controller, Mode};
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
            newest: None,
            setup,
        })
    }

    /// Both arms.
    pub fn arms(&self) -> &BothArms {
        &self.arms
    }

    /// What the controller wants, and what of it the arm that carries the cameras is told.
    fn decide(&mut self, now: MonotonicTime) -> (Mode, Decision, JointCommand) {
        let observation = self.newest.as_ref().and_then(|percept| percept.observation.as_ref());
        let control = self.controller.step(self.arms.vs.joints(), observation, now);
        let arms = [&self.arms.vs, &self.arms.tc].map(|arm| (arm.condition(), arm.joints()));
        let decision = self.permitting.step(&control, self.newest.as_ref(), arms, now);
        let told = match (decision.permission, control.command) {
            (Permission::Move { share }, Command::Velocity(velocity)) => Command::Velocity(velocity * share),
            _ => Command::Hold,
        };
        self.controller.note_told(told);
        if decision.rearm {
            self.controller.acquire();
        }
        let command = match told {
            Command::Velocity(velocity) => JointCommand::Velocity(velocity),
            Command::Hold => JointCommand::Hold,
        };
        (control.mode, decision, command)
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
        let (mode, decision, command) = self.decide(now);
        if decision.permission == Permission::Stop {
            self.arms.why_latched()?;
            bail!("{}", decision.why)
        }
        let t_s = now.seconds_since(self.begin);
        let carrying = self.path.as_ref().map_or(JointCommand::Hold, |path| {
            let position_rad = &self.arms.tc.joints().position_rad;
            JointCommand::Velocity(carry(&self.setup.tc.chain, &self.damping, path, t_s, position_rad))
        });
        self.arms.tc.exchange(carrying)?;
        self.arms.vs.exchange(command)?;
        Ok(Moved { at: now, mode, decision, vs_joints: *self.arms.vs.joints() })
    }

    fn stop(&mut self) -> Result<()> {
        self.arms.stop()
    }
}
