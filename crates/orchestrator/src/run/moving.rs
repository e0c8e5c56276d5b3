//! The half of a run that moves: both arms, the controller, and what each control step is to be remembered by.

use anyhow::{Context, Result, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmState, JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector};
use pb3dp_servo::supervisor::{Decision, Permission};
use pb3dp_servo::{Command, Controller, Mode};
use pb3dp_sim::placement::FlangePath;
use pb3dp_sim::trajectory::Trajectory;

use super::carrier::carry;
use super::commands::CommandSummary;
use super::percept::Percept;
use super::permitting::{Permitting, condition};
use crate::config::setup::{Carrier, Setup};
use crate::wiring::DrivenArm;

/// Both arms with what leads them.
pub struct Moving<'a> {
    setup: &'a Setup,
    vs: Box<dyn DrivenArm>,
    tc: Box<dyn DrivenArm>,
    /// The way of the arm that carries the target; none if it rests.
    path: Option<FlangePath<'a>>,
    controller: Controller,
    permitting: Permitting,
    damping: Damping,
    begin: MonotonicTime,
    vs_joints: JointState,
    tc_joints: JointState,
    newest: Option<Percept>,
    replies_missed: u64,
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
        (vs, tc): (Box<dyn DrivenArm>, Box<dyn DrivenArm>),
        experiment: &'a dyn Trajectory,
        begin: MonotonicTime,
    ) -> Result<Self> {
        let limiter = &setup.vs.limiter;
        let limits = limiter.hard_limits.with_position_range(limiter.operating_min_rad, limiter.operating_max_rad)?;
        let at_rest = |position_rad: JointVector| JointState {
            at: begin,
            position_rad,
            velocity_rad_per_s: JointVector::zeros(),
        };
        Ok(Self {
            controller: Controller::new(setup.controller, setup.vs.chain.clone(), limits)?,
            permitting: Permitting::new(&setup.supervisor, limits)?,
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            path: (setup.experiment.carrier == Carrier::Arm)
                .then(|| FlangePath::of_carrier(experiment, &setup.tc.world_from_base, &setup.flange_from_target)),
            begin,
            vs_joints: at_rest(setup.vs.start_rad),
            tc_joints: at_rest(setup.tc.start_rad),
            newest: None,
            replies_missed: 0,
            setup,
            vs,
            tc,
        })
    }

    /// Drives on, and where the joints really are.
    ///
    /// # Errors
    /// The arm that can not be switched on, and why.
    pub fn enable(&mut self) -> Result<()> {
        self.vs.enable().context("vs-robot: enable")?;
        self.tc.enable().context("tc-robot: enable")?;
        self.vs_joints = self.vs.exchange(JointCommand::Hold).context("vs-robot")?;
        self.tc_joints = self.tc.exchange(JointCommand::Hold).context("tc-robot")?;
        Ok(())
    }

    /// The experiment begins at this time.
    pub fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    /// The newest that was seen of the target.
    pub fn observe(&mut self, percept: Percept) {
        self.newest = Some(percept);
    }

    /// One step of both arms.
    ///
    /// # Errors
    /// The arm that fails, and why; or why the supervisor stops both.
    pub fn step(&mut self, now: MonotonicTime) -> Result<Moved> {
        let (mode, decision, command) = self.decide(now);
        if decision.permission == Permission::Stop {
            return self.stop_for(&decision);
        }
        let t_s = now.seconds_since(self.begin);
        let carrying = self.path.as_ref().map_or(JointCommand::Hold, |path| {
            JointCommand::Velocity(carry(&self.setup.tc.chain, &self.damping, path, t_s, &self.tc_joints.position_rad))
        });
        let measured = self.tc.exchange(carrying);
        self.tc_joints = newest(measured, &self.tc_joints, &mut self.replies_missed).context("tc-robot")?;
        let measured = self.vs.exchange(command);
        self.vs_joints = newest(measured, &self.vs_joints, &mut self.replies_missed).context("vs-robot")?;
        Ok(Moved { at: now, mode, decision, vs_joints: self.vs_joints })
    }

    /// What the controller wants, and what of it the arm that carries the cameras is told.
    fn decide(&mut self, now: MonotonicTime) -> (Mode, Decision, JointCommand) {
        let observation = self.newest.as_ref().and_then(|percept| percept.observation.as_ref());
        let control = self.controller.step(&self.vs_joints, observation, now);
        let arms = [(condition(&*self.vs), &self.vs_joints), (condition(&*self.tc), &self.tc_joints)];
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

    /// Nobody resets a run: it ends. An arm that has failed says more about it than the supervisor knows.
    fn stop_for(&mut self, decision: &Decision) -> Result<Moved> {
        let mut arms = [("tc-robot", &mut self.tc), ("vs-robot", &mut self.vs)];
        arms.sort_by_key(|(_, arm)| arm.is_stopped_by_other());
        for (name, arm) in arms {
            let rest = match arm.state() {
                // It refuses, and says why.
                ArmState::Fault | ArmState::EStop => JointCommand::Velocity(JointVector::zeros()),
                ArmState::Enabled | ArmState::Disabled => JointCommand::Hold,
            };
            arm.exchange(rest).context(name)?;
        }
        bail!("{}", decision.why)
    }

    /// Both arms come to rest with brakes on, whatever happened; the first failure is told.
    ///
    /// # Errors
    /// The arm that can not be told.
    pub fn stop(&mut self) -> Result<()> {
        // Closing the brakes of one takes time in which the other one must not wait for its next velocity.
        for arm in [&mut self.vs, &mut self.tc] {
            arm.exchange(JointCommand::Hold).ok();
        }
        let vs = self.vs.stop().context("vs-robot: stop");
        let tc = self.tc.stop().context("tc-robot: stop");
        vs.and(tc)
    }

    /// Steps in which an arm had no measurement in time; it held.
    pub fn replies_missed(&self) -> u64 {
        self.replies_missed
    }

    /// What became of the velocities of both arms.
    pub fn commands(&self) -> [CommandSummary; 2] {
        [("vs-robot", &self.vs), ("tc-robot", &self.tc)].map(|(name, arm)| CommandSummary::of(name, &arm.statistics()))
    }
}

/// What was measured, or, if a reply is only late or lost, what was measured before: the arm holds meanwhile, and stops by itself
/// when it happens too often.
fn newest(
    measured: Result<JointState, ArmError>,
    before: &JointState,
    missed: &mut u64,
) -> Result<JointState, ArmError> {
    match measured {
        Err(error) if error.kind() == ArmErrorKind::Timeout => {
            *missed += 1;
            Ok(*before)
        }
        other => other,
    }
}
