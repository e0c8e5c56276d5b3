//! Both arms of a cell, as everything that moves them sees them: switched on, told, measured, and stopped.

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmErrorKind, ArmState, JointCommand, JointState};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::ArmCondition;

use super::commands::CommandSummary;
use crate::config::setup::Setup;
use crate::wiring::DrivenArm;

/// One arm, with what was last measured of it.
pub struct LedArm {
    name: &'static str,
    arm: Box<dyn DrivenArm>,
    joints: JointState,
    replies_missed: u64,
}

impl LedArm {
    /// An arm that is not yet switched on; until it is measured it counts as resting at `start_rad`.
    fn new(name: &'static str, arm: Box<dyn DrivenArm>, start_rad: JointVector, now: MonotonicTime) -> Self {
        let joints = JointState { at: now, position_rad: start_rad, velocity_rad_per_s: JointVector::zeros() };
        Self { name, arm, joints, replies_missed: 0 }
    }

    /// What was last measured.
    pub fn joints(&self) -> &JointState {
        &self.joints
    }

    /// State of drives and brakes, in the supervisor's terms.
    pub fn condition(&self) -> ArmCondition {
        match self.arm.state() {
            ArmState::Disabled => ArmCondition::Disabled,
            ArmState::Enabled => ArmCondition::Enabled,
            ArmState::Fault if self.arm.is_stopped_by_other() => ArmCondition::StoppedByOther,
            ArmState::Fault => ArmCondition::Fault,
            ArmState::EStop => ArmCondition::EmergencyStop,
        }
    }

    /// One cycle; what was measured. `None`: the reply is only late or lost, and the arm holds in place of the command. It stops by
    /// itself when that happens too often.
    ///
    /// # Errors
    /// The arm's name, and why it fails.
    pub fn exchange(&mut self, command: JointCommand) -> Result<Option<JointState>> {
        match self.arm.exchange(command) {
            Ok(joints) => {
                self.joints = joints;
                Ok(Some(joints))
            }
            Err(error) if error.kind() == ArmErrorKind::Timeout => {
                self.replies_missed += 1;
                Ok(None)
            }
            Err(error) => Err(error).context(self.name),
        }
    }

    fn is_on(&self) -> bool {
        self.arm.state() == ArmState::Enabled
    }

    fn is_latched(&self) -> bool {
        matches!(self.arm.state(), ArmState::Fault | ArmState::EStop)
    }

    fn enable(&mut self) -> Result<()> {
        self.arm.enable().with_context(|| format!("{}: enable", self.name))
    }

    /// As [`Self::enable`], away from the start, too.
    fn enable_here(&mut self) -> Result<()> {
        if self.arm.state() == ArmState::Disabled {
            self.arm.enable_here().with_context(|| format!("{}: enable", self.name))?;
        }
        self.measure()
    }

    /// What can be measured of an arm that is off or latched; that it fails is no news.
    fn look(&mut self) {
        if let Ok(joints) = self.arm.exchange(JointCommand::Hold) {
            self.joints = joints;
        }
    }

    fn reset(&mut self) -> Result<()> {
        if self.is_latched() { self.arm.reset().with_context(|| format!("{}: reset", self.name)) } else { Ok(()) }
    }

    /// Where the joints really are, without which nothing is begun.
    fn measure(&mut self) -> Result<()> {
        self.joints = self.arm.exchange(JointCommand::Hold).context(self.name)?;
        Ok(())
    }

    fn stop(&mut self) -> Result<()> {
        self.arm.stop().with_context(|| format!("{}: stop", self.name))
    }
}

/// Both arms.
pub struct BothArms {
    /// The one that carries the cameras.
    pub vs: LedArm,
    /// The one that carries the target.
    pub tc: LedArm,
}

impl BothArms {
    /// Arms that are not yet switched on: the one with the cameras, the one with the target.
    pub fn new(setup: &Setup, (vs, tc): (Box<dyn DrivenArm>, Box<dyn DrivenArm>), now: MonotonicTime) -> Self {
        Self {
            vs: LedArm::new("vs-robot", vs, setup.vs.start_rad, now),
            tc: LedArm::new("tc-robot", tc, setup.tc.start_rad, now),
        }
    }

    /// Drives on, and where the joints really are.
    ///
    /// # Errors
    /// The arm that can not be switched on, and why.
    pub fn enable(&mut self) -> Result<()> {
        self.vs.enable()?;
        self.tc.enable()?;
        self.vs.measure()?;
        self.tc.measure()
    }

    /// Both come to rest with brakes on, whatever happened; the first failure is told.
    ///
    /// # Errors
    /// The arm that can not be told.
    pub fn stop(&mut self) -> Result<()> {
        // Closing the brakes of one takes time in which the other one must not wait for its next velocity.
        for led in [&mut self.vs, &mut self.tc] {
            led.arm.exchange(JointCommand::Hold).ok();
        }
        let vs = self.vs.stop();
        let tc = self.tc.stop();
        vs.and(tc)
    }

    /// An arm that a stop has left switched on.
    pub fn still_on(&self) -> Option<&'static str> {
        [&self.vs, &self.tc].into_iter().find(|led| led.is_on()).map(|led| led.name)
    }

    /// Stops those that are still switched on.
    ///
    /// # Errors
    /// The first arm that can not be told.
    pub fn stop_still_on(&mut self) -> Result<()> {
        let still_on = [&mut self.vs, &mut self.tc].into_iter().filter(|led| led.is_on());
        still_on.map(LedArm::stop).fold(Ok(()), Result::and)
    }

    /// Drives on again after a stop, and where the joints really are: from there they go on, wherever it is.
    ///
    /// # Errors
    /// The arm that can not be switched on, and why.
    pub fn enable_here(&mut self) -> Result<()> {
        self.vs.enable_here()?;
        self.tc.enable_here()
    }

    /// Whether one of them has a fault or an emergency stop.
    pub fn is_latched(&self) -> bool {
        self.vs.is_latched() || self.tc.is_latched()
    }

    /// What can be measured while both are off or latched.
    pub fn look(&mut self) {
        self.vs.look();
        self.tc.look();
    }

    /// Clears what is latched in the arms themselves, as far as its cause is gone: an arm that was only stopped by the other one comes
    /// behind it. Where each one has failed by itself, the first one can be reset only behind the second one, and is tried again.
    ///
    /// # Errors
    /// The first arm whose cause is still there.
    pub fn reset(&mut self) -> Result<()> {
        let mut arms = [&mut self.tc, &mut self.vs];
        arms.sort_by_key(|led| led.arm.is_stopped_by_other());
        let mut failed: Vec<_> = arms.into_iter().filter_map(|led| led.reset().is_err().then_some(led)).collect();
        failed.sort_by_key(|led| led.arm.is_stopped_by_other());
        failed.into_iter().map(LedArm::reset).fold(Ok(()), Result::and)
    }

    /// Has a latched arm say why it is; one that has failed by itself goes before one that the other one stopped.
    ///
    /// # Errors
    /// The arm, and why it is latched.
    pub fn why_latched(&mut self) -> Result<()> {
        let mut arms = [&mut self.tc, &mut self.vs];
        arms.sort_by_key(|led| led.arm.is_stopped_by_other());
        for led in arms {
            let rest = match led.arm.state() {
                // It refuses, and says why.
                ArmState::Fault | ArmState::EStop => JointCommand::Velocity(JointVector::zeros()),
                ArmState::Enabled | ArmState::Disabled => JointCommand::Hold,
            };
            led.arm.exchange(rest).context(led.name)?;
        }
        Ok(())
    }

    /// Steps in which an arm had no measurement in time; it held.
    pub fn replies_missed(&self) -> u64 {
        self.vs.replies_missed + self.tc.replies_missed
    }

    /// What became of the velocities of both arms.
    pub fn commands(&self) -> [CommandSummary; 2] {
        [&self.vs, &self.tc].map(|led| CommandSummary::of(led.name, &led.arm.statistics()))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::{Arc, Mutex};

    use pb3dp_arm_pa10::mock::{MockArm, MockArmConfig, MockArmFaults};
    use pb3dp_hal_api::Clock;
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_hal_middleware::{Limiter, couple};
    use pb3dp_sim::joint_dynamics::JointPlant;

    use super::*;
    use crate::config::setup::{ArmSetup, read_setup};
    use crate::wiring::arm::coupled_config;

    /// Two coupled arms that are switched on, and what makes each one fail.
    fn cell() -> (BothArms, [MockArmFaults; 2]) {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let setup = read_setup(Path::new(file)).unwrap();
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let mock = |name: &str, arm: &ArmSetup| {
            let plant = JointPlant::new(arm.plant.clone(), arm.start_rad, clock.now()).unwrap();
            let (cycle, command_timeout) = (setup.control_period, arm.command_timeout);
            let config = MockArmConfig { name: name.to_owned(), cycle, command_timeout };
            MockArm::new(config, Arc::new(Mutex::new(plant)), Arc::clone(&clock))
        };
        let (vs, tc) = (mock("vs-robot", &setup.vs), mock("tc-robot", &setup.tc));
        let faults = [vs.faults(), tc.faults()];
        let pair = ((vs, coupled_config(&setup.vs)), (tc, coupled_config(&setup.tc)));
        let (vs, tc) = couple(pair.0, pair.1, setup.least_room_m, &clock).unwrap();
        let vs = Box::new(Limiter::new(vs, setup.vs.limiter.clone(), Arc::clone(&clock)).unwrap());
        let tc = Box::new(Limiter::new(tc, setup.tc.limiter.clone(), Arc::clone(&clock)).unwrap());
        let mut arms = BothArms::new(&setup, (vs, tc), clock.now());
        arms.enable().unwrap();
        (arms, faults)
    }

    #[test]
    fn one_reset_clears_two_arms_that_have_failed_each_by_itself() {
        let (mut arms, faults) = cell();
        for arm in &faults {
            arm.raise_fault("an overcurrent");
        }
        arms.look();
        assert_eq!([&arms.vs, &arms.tc].map(LedArm::condition), [ArmCondition::Fault; 2]);
        faults[1].remove_fault_cause();
        let error = format!("{:#}", arms.reset().unwrap_err());
        assert!(error.contains("vs-robot") && error.contains("an overcurrent"), "{error}");
        assert!(arms.is_latched());
        faults[0].remove_fault_cause();
        arms.reset().unwrap();
        assert_eq!([&arms.vs, &arms.tc].map(LedArm::condition), [ArmCondition::Disabled; 2]);
    }
}
