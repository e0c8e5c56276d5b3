//! Executes a planned move: one command per cycle through all layers in front of the arm.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_cell::attended_motion::AttendedMotion;
use pb3dp_cell::both_arms::report_if_out_of_reach;
use pb3dp_cell::parts::{ArmChoice, ArmControl};
use pb3dp_cell::plan::Plan;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, Clock, JointCommand, JointState};
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::JointVector;
use pb3dp_wiring::commissioning::SlowArm;

use super::confirm::Interrupted;

/// Proportional gain of the joint error to the plan, 1/s.
pub const GAIN_PER_S: f64 = 2.0;
/// A joint this near to its end has arrived, rad.
pub const ARRIVED_WITHIN_RAD: f64 = 5e-4;
/// Time allowed for arrival after the planned end of a move.
pub const LATE_MAX: Duration = Duration::from_secs(3);
/// How long the arm holds before its brakes close.
const HOLD: Duration = Duration::from_millis(300);

/// A move in execution.
pub struct Drive<'a> {
    arm: &'a mut SlowArm,
    plan: &'a Plan,
    clock: &'a Arc<dyn Clock>,
    period: Duration,
    lost: u64,
    attended: Option<&'a AttendedMotion>,
}

/// One cycle of a move, for an observer.
#[derive(Clone, Copy, Debug)]
pub struct Cycle<'a> {
    /// Time since the start of the move.
    pub passed: Duration,
    /// Planned joint angles, rad.
    pub planned_rad: &'a JointVector,
    /// Measured joint state.
    pub measured: &'a JointState,
}

/// Selects one of the two arms.
type Which = fn(&mut SlowArm) -> Result<&mut dyn ArmControl>;

fn this_arm(arm: &mut SlowArm) -> Result<&mut dyn ArmControl> {
    Ok(&mut *arm.driven)
}

fn other_arm(arm: &mut SlowArm) -> Result<&mut dyn ArmControl> {
    Ok(&mut *arm.other.as_mut().context("the other arm is not connected")?.driven)
}

/// Called in each cycle; an error ends the move.
pub type Watch<'a> = &'a mut dyn FnMut(&Cycle<'_>) -> Result<()>;

/// Sends the stop order after a move, whatever its outcome.
///
/// # Errors
/// The failure of the move, and that of the stop order.
pub fn stopped_after(choice: ArmChoice, arm: &mut SlowArm, outcome: Result<JointState>) -> Result<JointState> {
    let stopped = arm.driven.stop().with_context(|| format!("{}: the stop order", choice.name()));
    match (outcome, stopped) {
        (Ok(reached), Ok(())) => Ok(reached),
        (Ok(_), Err(error)) => Err(error),
        (Err(error), Ok(())) => {
            Err(error.context(format!("{}: the move was aborted and the stop order given", choice.name())))
        }
        (Err(error), Err(stop)) => Err(error.context(format!("{stop:#}; press the emergency stop"))),
    }
}

impl<'a> Drive<'a> {
    /// A move with one command per period.
    pub fn new(arm: &'a mut SlowArm, plan: &'a Plan, clock: &'a Arc<dyn Clock>, period: Duration) -> Self {
        Self { arm, plan, clock, period, lost: 0, attended: None }
    }

    /// A person, or nobody, can end it.
    pub fn attended(self, attended: Option<&'a AttendedMotion>) -> Self {
        Self { attended, ..self }
    }

    /// Number of late or lost replies.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Opens the brakes and makes the move; afterwards the arm holds with open brakes.
    ///
    /// # Errors
    /// The failure of the arm or of `watch`, [`Interrupted`], the end by a person, or a joint that did not arrive. The caller must send
    /// the stop order.
    pub fn run(&mut self, signals: &mut StopSignals, watch: Watch<'_>) -> Result<JointState> {
        let mut newest = self.switch_on(signals, this_arm)?;
        watch(&Cycle { passed: Duration::ZERO, planned_rad: self.plan.start_rad(), measured: &newest })?;
        self.plan.check_begin(&newest.position_rad)?;
        let (begin, duration) = (self.clock.now(), self.plan.duration());
        let mut next = begin;
        loop {
            next = self.wait(next, signals)?;
            let passed = self.clock.now().saturating_since(begin);
            let (planned_rad, speed_rad_per_s) = self.plan.at(passed);
            watch(&Cycle { passed, planned_rad: &planned_rad, measured: &newest })?;
            let behind_rad = planned_rad - newest.position_rad;
            let is_there = passed >= duration && behind_rad.amax() <= ARRIVED_WITHIN_RAD;
            if is_there {
                return self.hold(next, signals, newest);
            }
            if passed > duration + LATE_MAX {
                let joint = behind_rad.iamax();
                let left_deg = behind_rad[joint].to_degrees();
                bail!("{} did not arrive: residual {left_deg:+.3} degrees", Axis::ALL[joint]);
            }
            let velocity = speed_rad_per_s + behind_rad * GAIN_PER_S;
            newest = self.exchange(JointCommand::Velocity(velocity))?.unwrap_or(newest);
        }
    }

    /// Opens the brakes of the other arm, which then holds.
    ///
    /// # Errors
    /// The failure of an arm, or [`Interrupted`]. The caller must send the stop order.
    pub fn switch_other_on(&mut self, signals: &mut StopSignals) -> Result<()> {
        self.switch_on(signals, other_arm).map(drop)
    }

    /// Opens the brakes of an arm, which takes seconds. Arms with open brakes are monitored in each cycle meanwhile.
    fn switch_on(&mut self, signals: &mut StopSignals, which: Which) -> Result<JointState> {
        which(self.arm)?.begin_enable()?;
        let mut next = self.clock.now();
        loop {
            let is_on = which(self.arm)?.poll_enable()?;
            let newest = self.exchange(JointCommand::Hold)?;
            if let (true, Some(newest)) = (is_on, newest) {
                return Ok(newest);
            }
            next = self.wait(next, signals)?;
        }
    }

    fn hold(&mut self, from: MonotonicTime, signals: &mut StopSignals, newest: JointState) -> Result<JointState> {
        let (mut next, mut newest) = (from, newest);
        while next < from + HOLD {
            next = self.wait(next, signals)?;
            newest = self.exchange(JointCommand::Hold)?.unwrap_or(newest);
        }
        Ok(newest)
    }

    /// Waits for the next cycle, unless a signal or a person ends the move.
    fn wait(&self, last: MonotonicTime, signals: &mut StopSignals) -> Result<MonotonicTime> {
        if let Some(signal) = signals.try_take()? {
            return Err(Interrupted(signal).into());
        }
        if let Some(ended) = self.attended.and_then(AttendedMotion::ended) {
            return Err(ended.clone().into());
        }
        // A cycle whose time has passed is skipped.
        let next = (last + self.period).max(self.clock.now());
        self.clock.sleep_until(next);
        Ok(next)
    }

    /// One exchange with each arm that is connected; `None` if this one's reply is late.
    fn exchange(&mut self, command: JointCommand) -> Result<Option<JointState>> {
        if let Some(other) = &mut self.arm.other {
            measured(&mut *other.driven, JointCommand::Hold, &mut self.lost)?;
        }
        Ok(measured(&mut *self.arm.driven, command, &mut self.lost)?)
    }
}

/// Returns the measurement; `None` for a late reply, which the arm counts and tolerates twice in a row.
fn measured(arm: &mut dyn ArmControl, command: JointCommand, lost: &mut u64) -> Result<Option<JointState>, ArmError> {
    let exchanged = arm.exchange(command);
    report_if_out_of_reach(&arm.info().name, &exchanged);
    match exchanged {
        Err(error) if error.kind() == ArmErrorKind::Timeout => {
            *lost += 1;
            Ok(None)
        }
        other => other.map(Some),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::task::Poll;

    use pb3dp_hal_api::{Arm, ArmInfo, ArmPower, ArmState, PowerOrder};
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_hal_middleware::{FlightLog, LimiterStatistics};
    use pb3dp_setup::setup::read_setup;
    use pb3dp_wiring::commissioning::OtherArm;

    use super::*;

    /// Returns scripted answers, the last one first.
    struct Scripted {
        info: ArmInfo,
        answers: Vec<Result<JointState, ArmErrorKind>>,
        /// Number of polls until it is enabled.
        switching_on: u32,
    }

    impl Arm for Scripted {
        fn info(&self) -> &ArmInfo {
            &self.info
        }

        fn exchange(&mut self, _: JointCommand) -> Result<JointState, ArmError> {
            self.answers.pop().unwrap().map_err(|kind| ArmError::new(kind, "scripted".to_owned()))
        }
    }

    impl ArmPower for Scripted {
        fn state(&self) -> ArmState {
            ArmState::Enabled
        }

        fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
            if order == PowerOrder::PollEnable {
                self.switching_on = self.switching_on.saturating_sub(1);
                return Ok(if self.switching_on == 0 { Poll::Ready(()) } else { Poll::Pending });
            }
            Ok(Poll::Ready(()))
        }
    }

    impl ArmControl for Scripted {
        fn statistics(&self) -> LimiterStatistics {
            LimiterStatistics::default()
        }
    }

    fn at_rest() -> JointState {
        let zeros = JointVector::zeros();
        JointState { at: MonotonicTime::ZERO, position_rad: zeros, velocity_rad_per_s: zeros }
    }

    /// A pair of arms with scripted answers; the first one needs this many polls to be enabled.
    fn cell(answers: [&[Result<JointState, ArmErrorKind>]; 2], switching_on: u32) -> SlowArm {
        let scripted = |answers: &[_], switching_on| {
            let info = ArmInfo { name: "scripted".to_owned(), cycle: Duration::from_millis(10) };
            Box::new(Scripted { info, answers: answers.to_vec(), switching_on })
        };
        let other = OtherArm { driven: scripted(answers[1], 0), monitor: None, flight: FlightLog::with_capacity(1) };
        SlowArm {
            driven: scripted(answers[0], switching_on),
            monitor: None,
            flight: FlightLog::with_capacity(1),
            other: Some(other),
            emulated: Vec::new(),
        }
    }

    /// A plan without motion, and the period of its cycles.
    fn plan() -> (Plan, Duration) {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let setup = read_setup(&configs.join("hil.toml")).unwrap();
        (
            Plan::new(&setup.rig.arms.vs, setup.rig.arms.vs.start_rad, JointVector::zeros()).unwrap(),
            setup.control_period,
        )
    }

    fn kind(error: &anyhow::Error) -> ArmErrorKind {
        error.downcast_ref::<ArmError>().unwrap().kind()
    }

    /// R4: one or two lost replies are tolerated, from either arm.
    #[test]
    fn a_lost_reply_of_the_other_arm_breaks_no_move_off() {
        let other = [Err(ArmErrorKind::Fault), Err(ArmErrorKind::Timeout), Err(ArmErrorKind::Timeout), Ok(at_rest())];
        let mut arm = cell([&[Err(ArmErrorKind::Timeout), Ok(at_rest()), Ok(at_rest())], &other], 0);
        let (plan, period) = plan();
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let mut drive = Drive::new(&mut arm, &plan, &clock, period);
        assert_eq!(drive.exchange(JointCommand::Hold).unwrap(), Some(at_rest()));
        assert_eq!(drive.exchange(JointCommand::Hold).unwrap(), Some(at_rest()));
        assert_eq!(drive.exchange(JointCommand::Hold).unwrap(), None);
        assert_eq!(drive.lost(), 3);
        assert_eq!(kind(&drive.exchange(JointCommand::Hold).unwrap_err()), ArmErrorKind::Fault);
    }

    /// Brakes take seconds to open: an arm with open brakes is exchanged with in each cycle meanwhile, and its stop aborts the move.
    #[test]
    fn the_other_arm_is_watched_while_this_one_is_enabled() {
        let mut other = vec![Err(ArmErrorKind::Fault)];
        other.resize(60, Ok(at_rest()));
        let mut arm = cell([&[Ok(at_rest()); 200], &other], 100);
        let (plan, period) = plan();
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let mut drive = Drive::new(&mut arm, &plan, &clock, period);
        let mut signals = StopSignals::take_over().unwrap();
        let error = drive.run(&mut signals, &mut |_| panic!("it moves")).unwrap_err();
        assert_eq!(kind(&error), ArmErrorKind::Fault, "{error}");
        assert_eq!(clock.now(), MonotonicTime::ZERO + period * 59, "60 cycles");
    }
}
