//! Both arms of a workcell: enable, command, measure and stop.

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmState, EnablePosition, JointCommand, JointState, PowerOrder};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::{ArmCondition, ArmInput};
use pb3dp_setup::setup::Setup;

use crate::log::ArmSample;

use super::commands::CommandSummary;
use super::devices::ArmControl;

/// One arm with its last measurement.
pub struct CellArm {
    name: &'static str,
    arm: Box<dyn ArmControl>,
    joints: JointState,
    /// Last requested command.
    requested: JointCommand,
    replies_missed: u64,
    /// Enabling is in progress.
    is_enabling: bool,
    /// A person was asked to press the emergency stop, and no reset has come since.
    is_emergency_reported: bool,
}

impl CellArm {
    /// An arm that is not enabled yet; until its first measurement it counts as stationary at `start_rad`.
    fn new(name: &'static str, arm: Box<dyn ArmControl>, start_rad: JointVector, now: MonotonicTime) -> Self {
        let joints = JointState { at: now, position_rad: start_rad, velocity_rad_per_s: JointVector::zeros() };
        Self {
            name,
            arm,
            joints,
            requested: JointCommand::Hold,
            replies_missed: 0,
            is_enabling: false,
            is_emergency_reported: false,
        }
    }

    /// Last measured joint state.
    pub fn joints(&self) -> &JointState {
        &self.joints
    }

    /// Last measured joints and last requested command.
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

    /// Its condition and the time of its measurement, for the supervisor.
    pub fn input(&self) -> ArmInput {
        ArmInput { state: self.condition(), measured_at: Some(self.joints.at) }
    }

    /// One control cycle; returns the measurement. `None`: the reply is late or lost and the arm holds. The arm stops by itself if that
    /// happens too often.
    ///
    /// # Errors
    /// The arm's name and the cause of the failure.
    pub fn exchange(&mut self, command: JointCommand) -> Result<Option<JointState>> {
        self.requested = command;
        match self.ask(command) {
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

    /// One exchange. Reports once until a reset that commands possibly do not reach the arm.
    fn ask(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let answer = self.arm.exchange(command);
        self.is_emergency_reported = self.is_emergency_reported || report_if_out_of_reach(self.name, &answer);
        answer
    }

    fn is_on(&self) -> bool {
        self.arm.state() == ArmState::Enabled
    }

    fn is_latched(&self) -> bool {
        matches!(self.arm.state(), ArmState::Fault | ArmState::EStop)
    }

    fn begin_enable(&mut self, from: EnablePosition) -> Result<()> {
        if from == EnablePosition::Here && self.arm.state() != ArmState::Disabled {
            return Ok(());
        }
        self.arm.power(PowerOrder::BeginEnable(from)).map(drop).with_context(|| self.not_enabled())?;
        self.is_enabling = true;
        Ok(())
    }

    /// Whether enabling has finished.
    fn poll_enable(&mut self) -> Result<bool> {
        if self.is_enabling {
            self.is_enabling = !self.arm.poll_enable().with_context(|| self.not_enabled())?;
        }
        Ok(!self.is_enabling)
    }

    fn not_enabled(&self) -> String {
        format!("{}: enable", self.name)
    }

    /// Monitors the arm while both arms are enabled: whether it is enabled and its joints are measured.
    fn watch(&mut self) -> Result<bool> {
        if self.is_enabling {
            self.look();
            return Ok(false);
        }
        Ok(self.exchange(JointCommand::Hold)?.is_some())
    }

    /// Measures an arm that is disabled or latched; a failure is already known.
    fn look(&mut self) {
        if let Ok(joints) = self.arm.exchange(JointCommand::Hold) {
            self.joints = joints;
        }
    }

    fn reset(&mut self) -> Result<()> {
        if !self.is_latched() {
            return Ok(());
        }
        self.arm.reset().with_context(|| format!("{}: reset", self.name))?;
        self.is_emergency_reported = false;
        Ok(())
    }

    fn stop(&mut self) -> Result<()> {
        self.is_enabling = false;
        self.arm.stop().with_context(|| format!("{}: stop", self.name))
    }
}

/// Both arms.
pub struct BothArms {
    /// The arm that carries the cameras.
    pub vs: CellArm,
    /// The arm that carries the target.
    pub tc: CellArm,
    is_enabling: bool,
}

impl BothArms {
    /// Arms that are not enabled yet: the one with the cameras, the one with the target.
    pub fn new(setup: &Setup, (vs, tc): (Box<dyn ArmControl>, Box<dyn ArmControl>), now: MonotonicTime) -> Self {
        Self {
            vs: CellArm::new("vs-robot", vs, setup.rig.arms.vs.start_rad, now),
            tc: CellArm::new("tc-robot", tc, setup.rig.arms.tc.start_rad, now),
            is_enabling: false,
        }
    }

    /// Enables both arms step by step; returns whether both are enabled and their joints are measured. Call it in each control cycle until
    /// then: enabling takes seconds. Meanwhile an arm with open brakes holds and is monitored in each cycle, as during motion. A failure of
    /// one arm stops both.
    ///
    /// # Errors
    /// The arm that cannot be enabled or does not hold, with the cause; the caller must then stop both.
    pub fn enable(&mut self, from: EnablePosition) -> Result<bool> {
        let was_enabling = std::mem::replace(&mut self.is_enabling, false);
        if !was_enabling {
            self.vs.begin_enable(from)?;
            self.tc.begin_enable(from)?;
        }
        let polled = [self.vs.poll_enable(), self.tc.poll_enable()];
        let watched = [self.vs.watch(), self.tc.watch()];
        if self.is_latched() {
            // The arm that failed by itself reports the cause.
            self.why_latched()?;
        }
        let mut are_on = true;
        for outcome in polled.into_iter().chain(watched) {
            are_on &= outcome?;
        }
        self.is_enabling = !are_on;
        Ok(are_on)
    }

    /// Whether enabling is in progress.
    pub fn is_enabling(&self) -> bool {
        self.is_enabling
    }

    /// Stops both arms and closes their brakes in any state; returns the first failure.
    ///
    /// # Errors
    /// The arm that cannot be commanded.
    pub fn stop(&mut self) -> Result<()> {
        // Closing one arm's brakes takes time. The other arm must not wait meanwhile, neither for a velocity nor for its own brakes.
        self.is_enabling = false;
        let arms = [&mut self.vs, &mut self.tc].map(|led| {
            led.arm.exchange(JointCommand::Hold).ok();
            // An arm that cannot be commanded gets the command a second time below.
            led.arm.power(PowerOrder::BeginStop).ok();
            led
        });
        let [vs, tc] = arms.map(CellArm::stop);
        vs.and(tc)
    }

    /// Name of an arm that is still enabled after a stop.
    pub fn still_enabled(&self) -> Option<&'static str> {
        [&self.vs, &self.tc].into_iter().find(|led| led.is_on()).map(|led| led.name)
    }

    /// Stops the arms that are still enabled.
    ///
    /// # Errors
    /// The first arm that cannot be commanded.
    pub fn stop_still_on(&mut self) -> Result<()> {
        let still_enabled = [&mut self.vs, &mut self.tc].into_iter().filter(|led| led.is_on());
        still_enabled.map(CellArm::stop).fold(Ok(()), Result::and)
    }

    /// Whether an arm has a latched fault or emergency stop.
    pub fn is_latched(&self) -> bool {
        self.vs.is_latched() || self.tc.is_latched()
    }

    /// Measures both arms while they are disabled or latched.
    pub fn look(&mut self) {
        self.vs.look();
        self.tc.look();
    }

    /// Resets latched arms whose cause is gone. An arm stopped only by the other one is reset after it. If both failed by themselves, the
    /// first one can only be reset after the second one and is therefore tried again.
    ///
    /// # Errors
    /// The first arm whose cause still exists.
    pub fn reset(&mut self) -> Result<()> {
        let mut arms = [&mut self.tc, &mut self.vs];
        arms.sort_by_key(|led| led.arm.is_stopped_by_other());
        let mut failed: Vec<_> = arms.into_iter().filter_map(|led| led.reset().is_err().then_some(led)).collect();
        failed.sort_by_key(|led| led.arm.is_stopped_by_other());
        failed.into_iter().map(CellArm::reset).fold(Ok(()), Result::and)
    }

    /// Returns the cause of a latch; an arm that failed by itself takes precedence over one stopped by the other arm.
    ///
    /// # Errors
    /// The arm and the cause of its latch.
    pub fn why_latched(&mut self) -> Result<()> {
        let mut arms = [&mut self.tc, &mut self.vs];
        arms.sort_by_key(|led| led.arm.is_stopped_by_other());
        for led in arms {
            let rest = match led.arm.state() {
                // It refuses and returns the cause.
                ArmState::Fault | ArmState::EStop => JointCommand::Velocity(JointVector::zeros()),
                ArmState::Enabled | ArmState::Disabled => JointCommand::Hold,
            };
            led.ask(rest).context(led.name)?;
        }
        Ok(())
    }

    /// The failure of an arm; if the other arm caused that stop, the other arm's failure, which may arrive second.
    pub fn traced(&mut self, failure: anyhow::Error) -> anyhow::Error {
        let name = failure.to_string();
        let is_stopped_by = |led: &CellArm| led.name == name && led.arm.is_stopped_by_other();
        if !is_stopped_by(&self.vs) && !is_stopped_by(&self.tc) {
            return failure;
        }
        self.why_latched().err().unwrap_or(failure)
    }

    /// Steps without a measurement in time; the arm held.
    pub fn replies_missed(&self) -> u64 {
        self.vs.replies_missed + self.tc.replies_missed
    }

    /// Velocity command counts of both arms.
    pub fn commands(&self) -> [CommandSummary; 2] {
        [&self.vs, &self.tc].map(|led| CommandSummary::of(led.name, &led.arm.statistics()))
    }
}

/// Tells a person what to do if commands possibly do not reach an arm with open brakes; returns whether that is so. Call it at once: a stop
/// order takes time.
pub fn report_if_out_of_reach(arm: &str, answer: &Result<JointState, ArmError>) -> bool {
    let is_out_of_reach = answer.as_ref().is_err_and(ArmError::may_still_move);
    if is_out_of_reach {
        tracing::error!("EMERGENCY STOP: press it at {arm} if it moves: commands may not reach this arm");
    }
    is_out_of_reach
}

/// A failure of an arm for a person. The failure begins with the name of the arm, which most causes repeat.
pub fn error_text(failure: &anyhow::Error) -> String {
    let whole = format!("{failure:#}");
    let name = failure.to_string();
    let rest = whole.strip_prefix(&format!("{name}: ")).filter(|rest| rest.starts_with(&format!("arm {name} ")));
    rest.map_or_else(|| whole.clone(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    use pb3dp_arm_pa10_emulation::mock::{MockArm, MockArmConfig, MockArmFaults};
    use std::task::Poll;

    use pb3dp_hal_api::{Arm, ArmInfo, ArmPower, Clock};
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_hal_middleware::{Limiter, LimiterStatistics, couple};
    use pb3dp_setup::setup::{ArmSetup, read_setup};
    use pb3dp_sim::joint_dynamics::JointPlant;

    use super::*;

    /// Two coupled enabled arms and their fault injectors.
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
        let (vs, tc) = (mock("vs-robot", &setup.rig.arms.vs), mock("tc-robot", &setup.rig.arms.tc));
        let faults = [vs.faults(), tc.faults()];
        let pair = ((vs, setup.rig.arms.vs.coupled()), (tc, setup.rig.arms.tc.coupled()));
        let (vs, tc) = couple(pair.0, pair.1, setup.rig.least_room_m, &clock).unwrap();
        let vs = Box::new(
            Limiter::new(vs, setup.rig.arms.vs.limits, setup.rig.arms.vs.limiter.clone(), Arc::clone(&clock)).unwrap(),
        );
        let tc = Box::new(
            Limiter::new(tc, setup.rig.arms.tc.limits, setup.rig.arms.tc.limiter.clone(), Arc::clone(&clock)).unwrap(),
        );
        let mut arms = BothArms::new(&setup, (vs, tc), clock.now());
        assert!(arms.enable(EnablePosition::Start).unwrap());
        (arms, faults)
    }

    #[test]
    fn one_reset_clears_two_arms_that_have_failed_each_by_itself() {
        let (mut arms, faults) = cell();
        for arm in &faults {
            arm.raise_fault("an overcurrent");
        }
        arms.look();
        assert_eq!([&arms.vs, &arms.tc].map(CellArm::condition), [ArmCondition::Fault; 2]);
        faults[1].remove_fault_cause();
        let error = format!("{:#}", arms.reset().unwrap_err());
        assert!(error.contains("vs-robot") && error.contains("an overcurrent"), "{error}");
        assert!(arms.is_latched());
        faults[0].remove_fault_cause();
        arms.reset().unwrap();
        assert_eq!([&arms.vs, &arms.tc].map(CellArm::condition), [ArmCondition::Disabled; 2]);
    }

    #[test]
    fn a_failure_is_reported_for_the_arm_that_failed_first() {
        let (mut arms, faults) = cell();
        faults[0].raise_fault("an overcurrent");
        arms.vs.look();
        let first_failure = arms.tc.exchange(JointCommand::Velocity(JointVector::zeros())).unwrap_err();
        assert!(!format!("{first_failure:#}").contains("an overcurrent"), "{first_failure:#}");
        let text = format!("{:#}", arms.traced(first_failure));
        assert!(text.starts_with("vs-robot") && text.contains("an overcurrent"), "{text}");
    }

    #[test]
    fn the_name_of_an_arm_is_stated_once() {
        let (mut arms, faults) = cell();
        faults[0].raise_fault("an overcurrent");
        arms.vs.look();
        let failure = arms.vs.exchange(JointCommand::Velocity(JointVector::zeros())).unwrap_err();
        let text = error_text(&failure);
        assert!(text.starts_with("arm vs-robot (") && text.matches("vs-robot").count() == 1, "{text}");
        assert_eq!(error_text(&anyhow::anyhow!("late").context("tc-robot")), "tc-robot: late");
    }

    /// Enabled after a number of polls; records its calls and fails on request.
    struct Slow {
        info: ArmInfo,
        polls_left: u32,
        fails_after: usize,
        holds: usize,
        calls: Arc<Mutex<Vec<String>>>,
    }

    impl Slow {
        fn boxed(name: &str, polls_left: u32, fails_after: usize, calls: &Arc<Mutex<Vec<String>>>) -> Box<Self> {
            let info = ArmInfo { name: name.to_owned(), cycle: Duration::from_millis(10) };
            Box::new(Self { info, polls_left, fails_after, holds: 0, calls: Arc::clone(calls) })
        }

        fn say(&self, what: &str) {
            self.calls.lock().unwrap().push(format!("{} {what}", self.info.name));
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

        fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
            match order {
                PowerOrder::Enable(_) => self.polls_left = 0,
                PowerOrder::BeginEnable(_) => self.say("begin"),
                PowerOrder::PollEnable => {
                    self.polls_left = self.polls_left.saturating_sub(1);
                    if self.polls_left > 0 {
                        return Ok(Poll::Pending);
                    }
                    self.say("on");
                }
                PowerOrder::BeginStop => self.say("begin to stop"),
                PowerOrder::Stop => self.say("stop"),
                PowerOrder::Reset => {}
            }
            Ok(Poll::Ready(()))
        }
    }

    impl ArmControl for Slow {
        fn statistics(&self) -> LimiterStatistics {
            LimiterStatistics::default()
        }
    }

    /// Two arms, the second of which takes longer to enable, and the record of their calls.
    fn slow(fails_after: usize) -> (BothArms, Arc<Mutex<Vec<String>>>) {
        let calls = Arc::default();
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let setup = read_setup(Path::new(file)).unwrap();
        let pair: (Box<dyn ArmControl>, Box<dyn ArmControl>) =
            (Slow::boxed("vs", 3, fails_after, &calls), Slow::boxed("tc", 100, usize::MAX, &calls));
        (BothArms::new(&setup, pair, MonotonicTime::ZERO), calls)
    }

    #[test]
    fn an_arm_with_open_brakes_is_watched_in_each_cycle_until_the_other_one_is_on() {
        for from in [EnablePosition::Start, EnablePosition::Here] {
            let (mut arms, calls) = slow(usize::MAX);
            for cycle in 1..100 {
                assert!(!arms.enable(from).unwrap() && arms.is_enabling());
                let at = MonotonicTime::ZERO + Duration::from_millis(10) * cycle;
                assert_eq!([arms.vs.joints().at, arms.tc.joints().at], [at; 2]);
            }
            assert!(arms.enable(from).unwrap() && !arms.is_enabling());
            assert_eq!(*calls.lock().unwrap(), ["vs begin", "tc begin", "vs on", "tc on"]);
        }
    }

    #[test]
    fn an_arm_that_fails_while_the_other_one_is_enabled_stops_both() {
        let (mut arms, calls) = slow(50);
        let failure = (0..100).find_map(|_| arms.enable(EnablePosition::Start).err()).unwrap();
        assert_eq!(format!("{failure:#}"), "vs-robot: vs ran away");
        arms.stop().unwrap();
        assert!(!arms.is_enabling());
        let order = ["vs begin", "tc begin", "vs on", "vs begin to stop", "tc begin to stop", "vs stop", "tc stop"];
        assert_eq!(
            *calls.lock().unwrap(),
            order,
            "the second arm must not be enabled, and no arm waits for the other one's brakes"
        );
    }
}
