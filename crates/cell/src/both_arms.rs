//! Both arms of a cell, as everything that moves them sees them: switched on, told, measured, and stopped.

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmErrorKind, ArmState, JointCommand, JointState};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::ArmCondition;
use pb3dp_setup::setup::Setup;

use crate::log::ArmSample;

use super::commands::CommandSummary;
use super::parts::DrivenArm;

/// One arm, with what was last measured of it.
pub struct LedArm {
    name: &'static str,
    arm: Box<dyn DrivenArm>,
    joints: JointState,
    /// What was last requested of it.
    requested: JointCommand,
    replies_missed: u64,
    /// It is being switched on.
    is_switching_on: bool,
}

impl LedArm {
    /// An arm that is not yet switched on; until it is measured it counts as resting at `start_rad`.
    fn new(name: &'static str, arm: Box<dyn DrivenArm>, start_rad: JointVector, now: MonotonicTime) -> Self {
        let joints = JointState { at: now, position_rad: start_rad, velocity_rad_per_s: JointVector::zeros() };
        Self { name, arm, joints, requested: JointCommand::Hold, replies_missed: 0, is_switching_on: false }
    }

    /// What was last measured.
    pub fn joints(&self) -> &JointState {
        &self.joints
    }

    /// What it measured last, and what was requested of it.
    pub fn sample(&self) -> ArmSample {
        let requested_rad_per_s = match self.requested {
            JointCommand::Velocity(velocity) => Some(velocity),
            JointCommand::Hold => None,
        };
        ArmSample { position_rad: self.joints.position_rad, requested_rad_per_s }
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
        self.requested = command;
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

    fn begin_enable(&mut self, from: Whence) -> Result<()> {
        let begun = match from {
            Whence::Start => self.arm.begin_enable(),
            Whence::Here if self.arm.state() != ArmState::Disabled => return Ok(()),
            Whence::Here => self.arm.begin_enable_here(),
        };
        begun.with_context(|| self.not_enabled())?;
        self.is_switching_on = true;
        Ok(())
    }

    /// Whether it is on.
    fn poll_enable(&mut self) -> Result<bool> {
        if self.is_switching_on {
            self.is_switching_on = !self.arm.poll_enable().with_context(|| self.not_enabled())?;
        }
        Ok(!self.is_switching_on)
    }

    fn not_enabled(&self) -> String {
        format!("{}: enable", self.name)
    }

    /// Watched while it or the other one is switched on: whether it is on, and where its joints really are.
    fn watch(&mut self) -> Result<bool> {
        if self.is_switching_on {
            self.look();
            return Ok(false);
        }
        Ok(self.exchange(JointCommand::Hold)?.is_some())
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

    fn stop(&mut self) -> Result<()> {
        self.is_switching_on = false;
        self.arm.stop().with_context(|| format!("{}: stop", self.name))
    }
}

/// Where arms may be when they are switched on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whence {
    /// At their start: the first velocity is refused elsewhere.
    Start,
    /// Where a stop has left them; one that is still on stays so.
    Here,
}

/// Both arms.
pub struct BothArms {
    /// The one that carries the cameras.
    pub vs: LedArm,
    /// The one that carries the target.
    pub tc: LedArm,
    is_switching_on: bool,
}

impl BothArms {
    /// Arms that are not yet switched on: the one with the cameras, the one with the target.
    pub fn new(setup: &Setup, (vs, tc): (Box<dyn DrivenArm>, Box<dyn DrivenArm>), now: MonotonicTime) -> Self {
        Self {
            vs: LedArm::new("vs-robot", vs, setup.rig.vs.start_rad, now),
            tc: LedArm::new("tc-robot", tc, setup.rig.tc.start_rad, now),
            is_switching_on: false,
        }
    }

    /// Switches both on, as far as that is possible now: whether they are on, and where their joints are is known. To be called in each
    /// control cycle until then. It takes seconds; an arm whose brakes are open is told to hold and watched in each of these cycles,
    /// as it is when it moves, and what stops one of them stops both.
    ///
    /// # Errors
    /// The arm that cannot be switched on or does not hold, and why; both have to be stopped then.
    pub fn enable(&mut self, from: Whence) -> Result<bool> {
        let was_switching_on = std::mem::replace(&mut self.is_switching_on, false);
        if !was_switching_on {
            self.vs.begin_enable(from)?;
            self.tc.begin_enable(from)?;
        }
        let polled = [self.vs.poll_enable(), self.tc.poll_enable()];
        let watched = [self.vs.watch(), self.tc.watch()];
        if self.is_latched() {
            // The one that failed by itself tells why.
            self.why_latched()?;
        }
        let mut are_on = true;
        for outcome in polled.into_iter().chain(watched) {
            are_on &= outcome?;
        }
        self.is_switching_on = !are_on;
        Ok(are_on)
    }

    /// Whether they are being switched on.
    pub fn is_switching_on(&self) -> bool {
        self.is_switching_on
    }

    /// Both come to rest with brakes on, whatever happened; the first failure is told.
    ///
    /// # Errors
    /// The arm that cannot be told.
    pub fn stop(&mut self) -> Result<()> {
        // Closing the brakes of one takes time in which the other one must neither wait for its next velocity nor for its own brakes.
        self.is_switching_on = false;
        let arms = [&mut self.vs, &mut self.tc].map(|led| {
            led.arm.exchange(JointCommand::Hold).ok();
            // Whoever cannot be told is told once more.
            led.arm.begin_stop().ok();
            led
        });
        let [vs, tc] = arms.map(LedArm::stop);
        vs.and(tc)
    }

    /// An arm that a stop has left switched on.
    pub fn still_on(&self) -> Option<&'static str> {
        [&self.vs, &self.tc].into_iter().find(|led| led.is_on()).map(|led| led.name)
    }

    /// Stops those that are still switched on.
    ///
    /// # Errors
    /// The first arm that cannot be told.
    pub fn stop_still_on(&mut self) -> Result<()> {
        let still_on = [&mut self.vs, &mut self.tc].into_iter().filter(|led| led.is_on());
        still_on.map(LedArm::stop).fold(Ok(()), Result::and)
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

    /// A failure of an arm, or, if the other one has stopped that arm, what the other one says: it may be heard second.
    pub fn traced(&mut self, failure: anyhow::Error) -> anyhow::Error {
        let name = failure.to_string();
        let is_told = |led: &LedArm| led.name == name && led.arm.is_stopped_by_other();
        if !is_told(&self.vs) && !is_told(&self.tc) {
            return failure;
        }
        self.why_latched().err().unwrap_or(failure)
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
    use std::time::Duration;

    use pb3dp_arm_pa10_emulation::mock::{MockArm, MockArmConfig, MockArmFaults};
    use pb3dp_hal_api::{Arm, ArmError, ArmInfo, ArmPower, Clock};
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_hal_middleware::{Limiter, LimiterStatistics, couple};
    use pb3dp_setup::setup::{ArmSetup, read_setup};
    use pb3dp_sim::joint_dynamics::JointPlant;

    use super::*;

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
        let (vs, tc) = (mock("vs-robot", &setup.rig.vs), mock("tc-robot", &setup.rig.tc));
        let faults = [vs.faults(), tc.faults()];
        let pair = ((vs, setup.rig.vs.coupled()), (tc, setup.rig.tc.coupled()));
        let (vs, tc) = couple(pair.0, pair.1, setup.rig.least_room_m, &clock).unwrap();
        let vs =
            Box::new(Limiter::new(vs, setup.rig.vs.limits, setup.rig.vs.limiter.clone(), Arc::clone(&clock)).unwrap());
        let tc =
            Box::new(Limiter::new(tc, setup.rig.tc.limits, setup.rig.tc.limiter.clone(), Arc::clone(&clock)).unwrap());
        let mut arms = BothArms::new(&setup, (vs, tc), clock.now());
        assert!(arms.enable(Whence::Start).unwrap());
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

    #[test]
    fn a_failure_is_told_by_the_arm_that_has_failed_by_itself() {
        let (mut arms, faults) = cell();
        faults[0].raise_fault("an overcurrent");
        arms.vs.look();
        let heard_first = arms.tc.exchange(JointCommand::Velocity(JointVector::zeros())).unwrap_err();
        assert!(!format!("{heard_first:#}").contains("an overcurrent"), "{heard_first:#}");
        let told = format!("{:#}", arms.traced(heard_first));
        assert!(told.starts_with("vs-robot") && told.contains("an overcurrent"), "{told}");
    }

    /// Switched on after so many polls; notes what it is asked, and fails where it is told to.
    struct Slow {
        info: ArmInfo,
        polls_left: u32,
        fails_after: usize,
        holds: usize,
        said: Arc<Mutex<Vec<String>>>,
    }

    impl Slow {
        fn boxed(name: &str, polls_left: u32, fails_after: usize, said: &Arc<Mutex<Vec<String>>>) -> Box<Self> {
            let info = ArmInfo { name: name.to_owned(), cycle: Duration::from_millis(10) };
            Box::new(Self { info, polls_left, fails_after, holds: 0, said: Arc::clone(said) })
        }

        fn say(&self, what: &str) {
            self.said.lock().unwrap().push(format!("{} {what}", self.info.name));
        }

        fn failed(&self) -> ArmError {
            ArmError::new(ArmErrorKind::Fault, format!("{} ran away", self.info.name))
        }
    }

    impl Arm for Slow {
        fn info(&self) -> &ArmInfo {
            &self.info
        }

        fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
            self.holds += usize::from(command == JointCommand::Hold);
            if self.state() == ArmState::Fault {
                return Err(self.failed());
            }
            let at = MonotonicTime::ZERO + self.info.cycle * self.holds as u32;
            Ok(JointState { at, position_rad: JointVector::zeros(), velocity_rad_per_s: JointVector::zeros() })
        }
    }

    impl ArmPower for Slow {
        fn state(&self) -> ArmState {
            match (self.holds >= self.fails_after, self.polls_left) {
                (true, _) => ArmState::Fault,
                (false, 0) => ArmState::Enabled,
                (false, _) => ArmState::Disabled,
            }
        }

        fn enable(&mut self) -> Result<(), ArmError> {
            self.polls_left = 0;
            Ok(())
        }

        fn begin_enable(&mut self) -> Result<(), ArmError> {
            self.say("begin");
            Ok(())
        }

        fn poll_enable(&mut self) -> Result<bool, ArmError> {
            self.polls_left = self.polls_left.saturating_sub(1);
            if self.polls_left == 0 {
                self.say("on");
            }
            Ok(self.polls_left == 0)
        }

        fn begin_stop(&mut self) -> Result<(), ArmError> {
            self.say("begin to stop");
            Ok(())
        }

        fn stop(&mut self) -> Result<(), ArmError> {
            self.say("stop");
            Ok(())
        }

        fn reset(&mut self) -> Result<(), ArmError> {
            Ok(())
        }
    }

    impl DrivenArm for Slow {
        fn statistics(&self) -> LimiterStatistics {
            LimiterStatistics::default()
        }

        fn enable_here(&mut self) -> Result<(), ArmError> {
            self.enable()
        }

        fn begin_enable_here(&mut self) -> Result<(), ArmError> {
            self.begin_enable()
        }
    }

    /// Arms of which the second one takes longer to be switched on, and what they are asked.
    fn slow(fails_after: usize) -> (BothArms, Arc<Mutex<Vec<String>>>) {
        let said = Arc::default();
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let setup = read_setup(Path::new(file)).unwrap();
        let pair: (Box<dyn DrivenArm>, Box<dyn DrivenArm>) =
            (Slow::boxed("vs", 3, fails_after, &said), Slow::boxed("tc", 100, usize::MAX, &said));
        (BothArms::new(&setup, pair, MonotonicTime::ZERO), said)
    }

    #[test]
    fn an_arm_with_open_brakes_is_watched_in_each_cycle_until_the_other_one_is_on() {
        for from in [Whence::Start, Whence::Here] {
            let (mut arms, said) = slow(usize::MAX);
            for cycle in 1..100 {
                assert!(!arms.enable(from).unwrap() && arms.is_switching_on());
                let at = MonotonicTime::ZERO + Duration::from_millis(10) * cycle;
                assert_eq!([arms.vs.joints().at, arms.tc.joints().at], [at; 2]);
            }
            assert!(arms.enable(from).unwrap() && !arms.is_switching_on());
            assert_eq!(*said.lock().unwrap(), ["vs begin", "tc begin", "vs on", "tc on"]);
        }
    }

    #[test]
    fn an_arm_that_fails_while_the_other_one_is_switched_on_stops_both() {
        let (mut arms, said) = slow(50);
        let failure = (0..100).find_map(|_| arms.enable(Whence::Start).err()).unwrap();
        assert_eq!(format!("{failure:#}"), "vs-robot: vs ran away");
        arms.stop().unwrap();
        assert!(!arms.is_switching_on());
        let order = ["vs begin", "tc begin", "vs on", "vs begin to stop", "tc begin to stop", "vs stop", "tc stop"];
        assert_eq!(
            *said.lock().unwrap(),
            order,
            "the second one must not be switched on, and none waits for the other one's brakes"
        );
    }
}
