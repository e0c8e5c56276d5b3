//! The limiter.

use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, EnablePosition, JointCommand, JointState,
    PowerOrder,
};
use pb3dp_kinematics::{DOF, EffectiveLimits, JointVector};

use crate::guard::LIMIT_ROUNDING_RAD;
use crate::last_command::{CommandFade, LastCommand};
use crate::shaping::{self, CycleInput, SetPoint, SpeedCaps, StopDistance};
use crate::stopping::DriveLimits;

/// Near a limit the speed cap is distance / T: a control loop of gain 1/T, closed over the reaction time. Such a loop overshoots
/// unless its gain is at most 1 / (e x delay), so T is e times the reaction time.
const NO_OVERSHOOT: f64 = std::f64::consts::E;

/// Properties of the arm besides its limits.
#[derive(Clone, Debug, PartialEq)]
pub struct LimiterConfig {
    /// Time from a sample until the next command takes effect: cycle, delay of the link, lag of the drives.
    pub reaction_time: Duration,
    /// The arm stops without a new command for this time.
    pub command_timeout: Duration,
    /// Fading of a command without a successor; `None` if it is valid until the time-out.
    pub fade: Option<CommandFade>,
    /// Without a sample younger than this, the arm holds.
    pub stale_after: Duration,
    /// Required pose at the first motion after enabling.
    pub start: StartPose,
}

/// Required pose at the first motion after enabling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StartPose {
    /// Any pose: for motions that start from the measured joints, such as the one to the start pose.
    Anywhere,
    /// These angles, rad: for motions that were planned from there.
    Near {
        /// The planned angles, rad.
        position_rad: JointVector,
        /// Tolerance of each joint, rad; [`StartPose::TOLERANCE_RAD`] for a PA-10.
        tolerance_rad: f64,
    },
}

impl StartPose {
    /// Tolerance of a joint around its planned start, rad.
    pub const TOLERANCE_RAD: f64 = 0.01;

    /// The first joint outside the tolerance, with the difference, rad.
    fn missed_by(&self, measured_rad: &JointVector) -> Option<(usize, f64)> {
        let Self::Near { position_rad, tolerance_rad } = self else { return None };
        let difference_rad = measured_rad - position_rad;
        (0..DOF).map(|joint| (joint, difference_rad[joint])).find(|(_, difference)| {
            let is_near = difference.abs() <= *tolerance_rad;
            !is_near
        })
    }
}

/// Why a configuration of a limiter is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LimiterError {
    /// The tolerance of the start is invalid.
    #[error("tolerance of the start pose {0} rad is not a positive, finite number")]
    StartTolerance(f64),
    /// A time is zero.
    #[error("{0} is zero; give a time above 0")]
    ZeroTime(&'static str),
}

/// Counters of the limiter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimiterStatistics {
    /// Velocity commands received.
    pub velocity_commands: u64,
    /// Velocity commands that were changed for any of the reasons below.
    pub changed: u64,
    /// Velocity commands that were refused by the limiter or by a wrapped layer.
    pub refused: u64,
    /// Commands refused because a number was not finite.
    pub refused_not_finite: u64,
    /// Commands refused because the arm was not at its start pose.
    pub refused_start: u64,
    /// Commands refused because they move a joint further beyond its servo limit.
    pub refused_outwards: u64,
    /// Commands replaced by a hold because the newest sample was too old or missing.
    pub held_stale: u64,
    /// Commands scaled down because of a speed limit.
    pub speed_limited: u64,
    /// Commands scaled down because a joint came near its limit.
    pub position_limited: u64,
    /// Commands that are approached with limited acceleration and jerk.
    pub acceleration_limited: u64,
    /// Replies discarded because a number was not finite.
    pub samples_not_finite: u64,
}

/// An arm that no command can drive beyond its limits. The limiter owns the arm, so it cannot be bypassed.
///
/// A velocity is `Rejected`, and the arm holds, if it is not finite, if it moves a joint further beyond its servo limits, or if it
/// is the first one after enabling, is not zero and the arm is not at its start pose. All other velocities are shaped. Speed limits and the
/// remaining distance to the operating limits scale the whole vector, so the hand keeps its direction. The sent velocity changes
/// within the limits of acceleration and jerk, and always so that every joint can still stop inside its operating range. Without a
/// fresh sample each joint decelerates to a stop. Outside its operating range a joint can only return. `Hold` is the arm's own ramp
/// and passes unchanged.
pub struct Limiter<A> {
    arm: A,
    clock: Arc<dyn Clock>,
    limits: EffectiveLimits,
    config: LimiterConfig,
    drives: DriveLimits,
    newest: Option<JointState>,
    last: LastCommand,
    /// Whether the arm has been at its start pose since it was enabled.
    started: bool,
    statistics: LimiterStatistics,
}

impl<A: Arm> Limiter<A> {
    /// Wraps an arm with these limits, whose samples have timestamps of `clock`. The drives can decelerate with the accelerations
    /// of the limits; the limiter decelerates before the operating limits.
    ///
    /// # Errors
    /// If a number of the configuration is out of range; the error names it.
    pub fn new(
        arm: A,
        limits: EffectiveLimits,
        config: LimiterConfig,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, LimiterError> {
        check(&config)?;
        let drives = DriveLimits::braking(&limits);
        let last = LastCommand::new(drives, config.command_timeout, config.fade);
        Ok(Self {
            arm,
            clock,
            limits,
            config,
            drives,
            newest: None,
            last,
            started: false,
            statistics: LimiterStatistics::default(),
        })
    }

    /// Counters so far.
    pub fn statistics(&self) -> LimiterStatistics {
        self.statistics
    }

    /// Forgets all earlier samples and commands.
    fn forget(&mut self) {
        self.last.note_rest();
        self.newest = None;
        self.started = false;
    }

    /// The limits of this limiter.
    pub fn config(&self) -> &LimiterConfig {
        &self.config
    }

    /// The wrapped arm, read-only.
    pub fn arm(&self) -> &A {
        &self.arm
    }

    /// Forwards a command and stores the result. The arm holds after anything but an accepted velocity.
    fn forward(&mut self, command: JointCommand, now: MonotonicTime) -> Result<JointState, ArmError> {
        let sample = self.arm.exchange(command).inspect_err(|_| self.last.note_hold(now))?;
        let mut numbers = sample.position_rad.iter().chain(sample.velocity_rad_per_s.iter());
        if !numbers.all(|number| number.is_finite()) {
            self.statistics.samples_not_finite += 1;
            self.last.note_hold(now);
            self.arm.exchange(JointCommand::Hold)?;
            let text = "the reply contains joint values that are not finite, and is discarded; the arm holds";
            return Err(self.error(ArmErrorKind::Timeout, text));
        }
        self.newest = Some(sample);
        if command == JointCommand::Hold {
            self.last.note_hold(now);
        }
        Ok(sample)
    }

    /// Why a velocity must not be sent at all, if so.
    fn refusal(&mut self, desired: &JointVector) -> Option<(usize, String)> {
        if let Some(joint) = (0..DOF).find(|&joint| !desired[joint].is_finite()) {
            self.statistics.refused_not_finite += 1;
            return Some((joint, format!("axis {}: command {} rad/s is not finite", joint + 1, desired[joint])));
        }
        let measured_rad = self.newest?.position_rad;
        if let Some(joint) = self.leads_out(desired, &measured_rad) {
            self.statistics.refused_outwards += 1;
            let limits = self.limits.servo();
            let reason = format!(
                "axis {} is at {:.2} degrees, beyond its servo limits {:.2} to {:.2} degrees, and {:+.4} rad/s leads further \
                 out: only motion back into the range is allowed",
                joint + 1,
                measured_rad[joint].to_degrees(),
                limits.position_min_rad()[joint].to_degrees(),
                limits.position_max_rad()[joint].to_degrees(),
                desired[joint]
            );
            return Some((joint, reason));
        }
        // Standstill is allowed anywhere. A latched arm answers it with the cause of its latch, which must not be hidden.
        if self.started || *desired == JointVector::zeros() {
            return None;
        }
        if let Some((joint, difference_rad)) = self.config.start.missed_by(&measured_rad) {
            self.statistics.refused_start += 1;
            let reason = format!(
                "axis {} is at {:.2} degrees, {:+.2} degrees from the start pose: move the arm to its start pose first (home \
                 it, at low speed), or correct the start pose in the configuration",
                joint + 1,
                measured_rad[joint].to_degrees(),
                difference_rad.to_degrees()
            );
            return Some((joint, reason));
        }
        self.started = true;
        None
    }

    /// A joint beyond its servo limits that would move further out.
    fn leads_out(&self, desired: &JointVector, measured_rad: &JointVector) -> Option<usize> {
        let limits = self.limits.servo();
        (0..DOF).find(|&joint| {
            let (angle, velocity) = (measured_rad[joint], desired[joint]);
            (angle > limits.position_max_rad()[joint] + LIMIT_ROUNDING_RAD && velocity > 0.0)
                || (angle < limits.position_min_rad()[joint] - LIMIT_ROUNDING_RAD && velocity < 0.0)
        })
    }

    fn refuse(&mut self, (joint, reason): (usize, String)) -> Result<JointState, ArmError> {
        self.forward(JointCommand::Hold, self.clock.now())?;
        Err(self.error(ArmErrorKind::Rejected, &format!("{reason}; the arm holds")).of_joint(joint))
    }

    /// The velocity to send in place of `desired`.
    fn limit(&mut self, desired: &JointVector, now: MonotonicTime) -> SetPoint {
        let config = &self.config;
        let fresh = self.newest.map(|sample| (now.saturating_since(sample.at), sample));
        let fresh = fresh.filter(|(age, _)| *age <= config.stale_after);
        let (previous, since) = self.last.at(now, self.arm.info().cycle, self.newest.as_ref());
        let operating = self.limits.operating();
        let speeds = *operating.velocity_max_rad_per_s();
        let drives = &self.drives;
        let step = CycleInput { previous: &previous, dt_s: since.as_secs_f64(), drives, speeds: &speeds };
        let nowhere = SpeedCaps { lower: -speeds, upper: speeds, by_position: [[false; 2]; DOF] };
        let Some((age, sample)) = fresh else {
            self.statistics.held_stale += 1;
            return shaping::shape(desired, &nowhere, &step, None).set_point;
        };
        let reaction = config.reaction_time + age;
        let position = &sample.position_rad;
        let near_s = NO_OVERSHOOT * reaction.as_secs_f64();
        let caps = shaping::caps(position, operating, &speeds, drives, near_s);
        let stop_distance = StopDistance {
            to_ends: [position - operating.position_min_rad(), operating.position_max_rad() - position],
            peaks: self.last.peaks_since(now - reaction),
            // A command that may be the last one for a while.
            reaction_s: (reaction + config.command_timeout).as_secs_f64(),
        };
        let shaped = shaping::shape(desired, &caps, &step, Some(&stop_distance));
        self.statistics.speed_limited += u64::from(shaped.speed_limited);
        self.statistics.position_limited += u64::from(shaped.position_limited);
        self.statistics.acceleration_limited += u64::from(shaped.acceleration_limited);
        shaped.set_point
    }

    fn error(&self, kind: ArmErrorKind, text: &str) -> ArmError {
        ArmError::new(kind, format!("limiter of arm {}: {text}", self.arm.info().name))
    }
}

impl<A: Arm> Arm for Limiter<A> {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let now = self.clock.now();
        let JointCommand::Velocity(desired) = command else { return self.forward(command, now) };
        self.statistics.velocity_commands += 1;
        if let Some(reason) = self.refusal(&desired) {
            self.statistics.refused += 1;
            return self.refuse(reason);
        }
        let set_point = self.limit(&desired, now);
        let answer = self.forward(JointCommand::Velocity(set_point.velocity), now);
        match &answer {
            Err(error) if error.kind() == ArmErrorKind::Rejected => self.statistics.refused += 1,
            _ => self.statistics.changed += u64::from(shaping::differ(&set_point.velocity, &desired)),
        }
        let sample = answer?;
        self.last.note_velocity(now, set_point);
        Ok(sample)
    }
}

impl<A: Arm + ArmPower> ArmPower for Limiter<A> {
    fn state(&self) -> ArmState {
        self.arm.state()
    }

    fn is_stopped_by_other(&self) -> bool {
        self.arm.is_stopped_by_other()
    }

    /// With [`EnablePosition::Here`] an arm that has been at its start pose before may start from its present pose, for example after a
    /// stop. This remains valid if enabling fails at first.
    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        match order {
            PowerOrder::Enable(from) | PowerOrder::BeginEnable(from) => {
                let started = self.started && from == EnablePosition::Here;
                self.forget();
                self.started = started;
            }
            PowerOrder::Stop | PowerOrder::Reset => self.last.note_rest(),
            PowerOrder::PollEnable | PowerOrder::BeginStop => {}
        }
        self.arm.power(order)
    }
}

fn check(config: &LimiterConfig) -> Result<(), LimiterError> {
    if let StartPose::Near { tolerance_rad, .. } = config.start
        && !(tolerance_rad.is_finite() && tolerance_rad > 0.0)
    {
        return Err(LimiterError::StartTolerance(tolerance_rad));
    }
    for (name, time) in [
        ("the reaction time", config.reaction_time),
        ("the time-out of commands", config.command_timeout),
        ("the age of a stale sample", config.stale_after),
    ] {
        if time.is_zero() {
            return Err(LimiterError::ZeroTime(name));
        }
    }
    Ok(())
}
