//! `pb3dp arm home` and `pb3dp arm jog`: one slow move through limiter and guard, and nothing without an operator's word.

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::codec::Axis;
use pb3dp_arm_pa10::io::realtime::{Realtime, enter};
use pb3dp_arm_pa10::io::signals::StopSignals;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmErrorKind, Clock, JointCommand, JointState};
use pb3dp_hal_clock::SystemClock;
use pb3dp_kinematics::JointVector;

use super::plan::Plan;
use super::{MotionArgs, Place, confirm};
use crate::commands::estimate::output::print_line;
use crate::config::setup::{ArmLink, Setup, read_setup};
use crate::wiring::commissioning::{ArmChoice, SlowArm, slow_setup, wire_slow};

/// Of a jog, for every joint: the speed of the first motion in the checklist of the rig.
const JOG_RAD_PER_S: f64 = 0.02;
/// Of the loop that commands the move, below those of the arms.
const PRIORITY: u8 = 40;
/// By how much joints may have moved between the plan and the opening of the brakes, rad.
const STAYED_WITHIN_RAD: f64 = 0.01;
/// Speed per angle by which a joint is behind its plan, 1/s.
const GAIN_PER_S: f64 = 2.0;
/// A joint that is this near to its end has arrived, rad.
const ARRIVED_WITHIN_RAD: f64 = 5e-4;
/// How long joints may take to arrive after the move should have ended.
const LATE_MAX: Duration = Duration::from_secs(3);
/// How long the arm holds before its brakes close.
const HOLD: Duration = Duration::from_millis(300);

/// Where to.
#[derive(Clone, Copy, Debug)]
pub enum Goal {
    /// The start_deg of the setup.
    Start,
    /// One joint by an angle.
    Jog {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// By how much, rad.
        by_rad: f64,
    },
}

impl Goal {
    fn name(self) -> &'static str {
        match self {
            Self::Start => "home",
            Self::Jog { .. } => "jog",
        }
    }

    fn by_rad(self, from_rad: &JointVector, start_rad: &JointVector) -> JointVector {
        match self {
            Self::Start => start_rad - from_rad,
            Self::Jog { joint, by_rad } => {
                let mut by = JointVector::zeros();
                by[joint] = by_rad;
                by
            }
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A configuration or a way that is refused, a confirmation that does not come, an arm that does not answer or stopped.
pub fn run(place: &Place, args: &MotionArgs, goal: Goal) -> Result<ExitCode> {
    let choice = place.choice();
    // Before any thread is started.
    let mut signals = StopSignals::take_over()?;
    let setup = read_setup(&place.config)?;
    if choice.of(&setup).link == ArmLink::InProcess {
        bail!("{}.backend = \"mock\" has no arm to move; set emulated, serial, tcp or arcnet", choice.table());
    }
    let jog_speed = matches!(goal, Goal::Jog { .. }).then_some(JOG_RAD_PER_S);
    let setup = slow_setup(&setup, choice, jog_speed)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut arm = wire_slow(&setup, choice, args.both, &clock)?;
    let now_rad = arm.driven.exchange(JointCommand::Hold)?.position_rad;
    let plan = Plan::new(choice.of(&setup), now_rad, goal.by_rad(&now_rad, &choice.of(&setup).start_rad))?;
    show(&setup, (choice, goal), &plan, &mut arm)?;
    if !args.moves {
        print_line("dry run: the brakes stayed on and nothing moved; --move does it")?;
        return Ok(ExitCode::SUCCESS);
    }
    print_line(&format!(
        "The arm will move. Nobody may be within its reach, and a hand has to be on the emergency stop.\nType {} to move it:",
        choice.name()
    ))?;
    confirm::typed(choice.name(), &mut signals)?;
    for shortfall in enter(&Realtime { priority: Some(PRIORITY), locks_memory: false, cpu: None }) {
        tracing::warn!("control loop: {shortfall}");
    }
    let mut drive = Drive { arm: &mut arm, plan: &plan, clock: &clock, period: setup.control_period, lost: 0 };
    let outcome = drive.run(&mut signals);
    let lost = drive.lost;
    let stopped = arm.driven.stop().with_context(|| format!("{}: the stop order", choice.name()));
    let reached = match (outcome, stopped) {
        (Ok(reached), Ok(())) => reached,
        (Ok(_), Err(error)) => return Err(error),
        (Err(error), Ok(())) => {
            return Err(error.context(format!("{}: the move was broken off and the stop order given", choice.name())));
        }
        (Err(error), Err(stop)) => return Err(error.context(format!("{stop:#}; press the emergency stop"))),
    };
    let off_deg = (reached.position_rad - plan.end_rad()).amax().to_degrees();
    print_line(&format!("done: every joint within {off_deg:.3} degrees of its end, brakes on; {lost} replies lost"))?;
    Ok(ExitCode::SUCCESS)
}

/// Says what would be sent.
fn show(setup: &Setup, (choice, goal): (ArmChoice, Goal), plan: &Plan, arm: &mut SlowArm) -> Result<()> {
    let duration = plan.duration();
    let commands = (duration.as_secs_f64() / setup.control_period.as_secs_f64()).ceil();
    print_line(&format!("{}: {}, {}", choice.name(), goal.name(), arm.driven.info().name))?;
    print_line(plan.table(choice.of(setup)).trim_end())?;
    print_line(&format!(
        "1. servos on, brakes on, at least 100 exchanges that prove the link; brakes open at speed 0\n2. {commands} velocities, one \
         every {:?}, for {:.2} s: all joints together on a straight way, at rest at both ends\n3. speed 0, brakes on, servos off",
        setup.control_period,
        duration.as_secs_f64()
    ))?;
    let Some(other) = &mut arm.other else {
        return Ok(print_line(&format!(
            "room to the {}: not known, as it is not connected (--both): look yourself that the way is free",
            choice.other().name()
        ))?);
    };
    let other_rad = other.exchange(JointCommand::Hold)?.position_rad;
    let room = plan.room(setup, choice, &other_rad);
    print_line(&format!("least room to the {} on the way: {room}", choice.other().name()))?;
    if room.distance_m().is_nan() || room.distance_m() < setup.least_room_m {
        bail!("{room} is less than arms.least_room_mm, {:.0} mm: move the other arm away", 1e3 * setup.least_room_m);
    }
    Ok(())
}

/// A move that is being made.
struct Drive<'a> {
    arm: &'a mut SlowArm,
    plan: &'a Plan,
    clock: &'a Arc<dyn Clock>,
    period: Duration,
    lost: u64,
}

impl Drive<'_> {
    fn run(&mut self, signals: &mut StopSignals) -> Result<JointState> {
        self.arm.driven.enable()?;
        let mut newest = self.exchange(JointCommand::Hold)?.context("no joints after the brakes were opened")?;
        let moved = newest.position_rad - self.plan.start_rad();
        if moved.amax() > STAYED_WITHIN_RAD {
            let joint = moved.iamax();
            let off_deg = moved[joint].to_degrees();
            bail!("{} is {off_deg:+.3} degrees from where the plan begins: plan again", Axis::ALL[joint]);
        }
        let (begin, duration) = (self.clock.now(), self.plan.duration());
        let mut next = begin;
        loop {
            next = self.wait(next, signals)?;
            let passed = self.clock.now().saturating_since(begin);
            let (planned_rad, speed_rad_per_s) = self.plan.at(passed);
            let behind_rad = planned_rad - newest.position_rad;
            let is_there = passed >= duration && behind_rad.amax() <= ARRIVED_WITHIN_RAD;
            if is_there {
                return self.hold(next, signals, newest);
            }
            if passed > duration + LATE_MAX {
                let joint = behind_rad.iamax();
                let left_deg = behind_rad[joint].to_degrees();
                bail!("{} did not arrive: {left_deg:+.3} degrees are left", Axis::ALL[joint]);
            }
            let velocity = speed_rad_per_s + behind_rad * GAIN_PER_S;
            newest = self.exchange(JointCommand::Velocity(velocity))?.unwrap_or(newest);
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

    /// Waits for the next cycle, and for no signal.
    fn wait(&self, last: MonotonicTime, signals: &mut StopSignals) -> Result<MonotonicTime> {
        if let Some(signal) = signals.try_take()? {
            bail!("ended by {signal}");
        }
        // A cycle whose time has passed is left out.
        let next = (last + self.period).max(self.clock.now());
        self.clock.sleep_until(next);
        Ok(next)
    }

    /// One exchange; `None` if the reply is late, which the arm itself counts and bears twice in a row.
    fn exchange(&mut self, command: JointCommand) -> Result<Option<JointState>> {
        if let Some(other) = &mut self.arm.other {
            other.exchange(JointCommand::Hold)?;
        }
        match self.arm.driven.exchange(command) {
            Ok(measured) => Ok(Some(measured)),
            Err(error) if error.kind() == ArmErrorKind::Timeout => {
                self.lost += 1;
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }
}
