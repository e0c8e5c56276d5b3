//! Motion limits of the gateway: checks each command of the host, and the measured angles in each cycle.
//!
//! This is the last check before the servo controller, and shares no code with the limiter of the host. Towards 0 every change of
//! speed is allowed, because each kind of stop needs it. Away from 0, an axis keeps its limits of acceleration and jerk between
//! the commands, with a tolerance for the time of a command (`docs/gateway.md` derives it): the gateway accepts a frame that is at
//! most `ramp_after` late, and a host follows a set-point without fading for at most [`SET_POINT_AGE_MAX`]. Two commands that
//! arrive t apart are therefore set-points that are at most t plus these two times apart.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, ArmReply, Axis};
use pb3dp_arm_pa10_protocol::gateway_protocol::{AxisMotion, MotionLimits, MotionQuantity};
use pb3dp_geometry::MonotonicTime;

/// Age up to which a host follows its own set-point without fading (`docs/arm-protocol.md`, watchdogs).
pub(super) const SET_POINT_AGE_MAX: Duration = Duration::from_millis(20);

/// Age of a measurement in cycles: one more without a reply stops the arm for another cause.
const MEASUREMENT_CYCLES: u32 = 3;

/// Two rounded speeds differ by one count more than the exact ones, at most.
const ROUNDING_RAD_PER_S: f64 = 0.0002;

/// A limit that motion would exceed.
pub(super) type Exceeded = (Axis, MotionQuantity);

/// The limits in force, and what they need to know of earlier commands.
#[derive(Clone, Copy, Debug)]
pub(super) struct LimitMonitor {
    limits: MotionLimits,
    /// Limits that the host has stated.
    pub asked: Option<MotionLimits>,
    motions: [AxisMotion; Axis::COUNT],
    /// How much farther apart two set-points may be than their commands.
    tolerance: Duration,
    /// From a measurement until a stop takes effect.
    reaction: Duration,
    /// Time of the last command.
    at: MonotonicTime,
    /// Downwards and upwards.
    sides: [[Side; 2]; Axis::COUNT],
}

/// Speeds of one axis in one direction, rad/s; negative in the other direction.
#[derive(Clone, Copy, Debug, Default)]
struct Side {
    speed: f64,
    /// The largest speed that the limit of acceleration allows after all earlier commands.
    reach: f64,
    /// Time and speed from which the axis accelerates from a constant or falling speed; `None` if it does not begin with an
    /// acceleration of 0.
    rise: Option<(MonotonicTime, f64)>,
    /// Time of the last command with a higher speed than the one before.
    risen: MonotonicTime,
}

impl LimitMonitor {
    /// Limits of the gateway, before a host has stated its own.
    pub fn new(limits: MotionLimits, ramp_after: Duration, cycle: Duration) -> Self {
        Self {
            limits,
            asked: None,
            motions: limits.axes.map(|axis| axis.to_si()),
            tolerance: ramp_after + SET_POINT_AGE_MAX,
            reaction: cycle * MEASUREMENT_CYCLES,
            at: MonotonicTime::ZERO,
            sides: [[Side::default(); 2]; Axis::COUNT],
        }
    }

    /// Speed, acceleration and jerk that a host does not ask for are not allowed either. The range remains the gateway's: the
    /// operating range of a host leaves no room beyond it.
    pub fn tighten(&mut self, own: &MotionLimits, asked: &MotionLimits) {
        self.limits = *own;
        for (limit, asked) in self.limits.axes.iter_mut().zip(&asked.axes) {
            limit.speed = limit.speed.min(asked.speed);
            limit.acceleration = limit.acceleration.min(asked.acceleration);
            limit.jerk = limit.jerk.min(asked.jerk);
        }
        self.motions = self.limits.axes.map(|axis| axis.to_si());
        self.asked = Some(*asked);
    }

    /// Forgets earlier commands: the arm is stationary, with its brakes on.
    pub fn restart(&mut self, now: MonotonicTime) {
        self.at = now;
        self.sides = [[Side { rise: Some((now, 0.0)), risen: now, ..Side::default() }; 2]; Axis::COUNT];
    }

    /// Largest accelerations, rad/s^2.
    pub fn acceleration_rad_per_s2(&self, axis: usize) -> f64 {
        self.motions[axis].acceleration_max_rad_per_s2
    }

    /// Checks a command that would be followed from now on. The first exceeded limit, if any.
    pub fn judge_command(
        &mut self,
        now: MonotonicTime,
        command: &ArmCommand,
        measured: Option<&ArmReply>,
    ) -> Option<Exceeded> {
        for (axis, limit) in Axis::ALL.into_iter().zip(&self.limits.axes) {
            if command.axes[axis.index()].speed().0.unsigned_abs() > limit.speed {
                return Some((axis, MotionQuantity::Speed));
            }
        }
        if let Some(exceeded) = measured.and_then(|reply| self.judge_range(command, reply)) {
            return Some(exceeded);
        }
        let times = Times { before: self.at, now, tolerance: self.tolerance };
        for axis in Axis::ALL {
            let speed = command.axes[axis.index()].speed().to_rad_per_s();
            let motion = &self.motions[axis.index()];
            for (side, sign) in self.sides[axis.index()].iter_mut().zip([-1.0, 1.0]) {
                if let Some(quantity) = side.judge(sign * speed, &times, motion) {
                    return Some((axis, quantity));
                }
            }
        }
        self.at = now;
        None
    }

    /// Whether each axis that moves towards an end of its range can stop before it: with the allowed deceleration, after the time
    /// until a stop takes effect.
    pub fn judge_range(&self, command: &ArmCommand, measured: &ArmReply) -> Option<Exceeded> {
        for axis in Axis::ALL {
            let speed = command.axes[axis.index()].speed().to_rad_per_s();
            let AxisMotion { acceleration_max_rad_per_s2, range_rad: [lower, upper], .. } = self.motions[axis.index()];
            let way = speed.abs() * (self.reaction.as_secs_f64() + speed.abs() / (2.0 * acceleration_max_rad_per_s2));
            let angle = measured.axes[axis.index()].angle.to_rad();
            if speed > 0.0 && angle + way > upper {
                return Some((axis, MotionQuantity::UpperEnd));
            }
            if speed < 0.0 && angle - way < lower {
                return Some((axis, MotionQuantity::LowerEnd));
            }
        }
        None
    }
}

/// Times of two commands.
struct Times {
    before: MonotonicTime,
    now: MonotonicTime,
    tolerance: Duration,
}

impl Side {
    /// Checks and stores the next speed.
    fn judge(&mut self, speed: f64, times: &Times, motion: &AxisMotion) -> Option<MotionQuantity> {
        let acceleration = motion.acceleration_max_rad_per_s2;
        let reach = self.reach + acceleration * times.now.seconds_since(times.before);
        let with_tolerance = reach.max(0.0) + acceleration * times.tolerance.as_secs_f64() + ROUNDING_RAD_PER_S;
        if speed > 0.0 && speed > self.speed && speed > with_tolerance {
            return Some(MotionQuantity::Acceleration);
        }
        if self.is_too_sudden(speed, times, motion) {
            return Some(MotionQuantity::Jerk);
        }
        // In the other direction the speed falls: this is free.
        self.reach = if speed > 0.0 { reach.max(0.0).min(speed) } else { speed };
        self.speed = speed;
        None
    }

    /// Whether a rise is faster than the limit of jerk allows. A rise begins when the speed has fallen, or was constant for longer
    /// than two commands of a rise can show the same set-point.
    fn is_too_sudden(&mut self, speed: f64, times: &Times, motion: &AxisMotion) -> bool {
        if speed <= self.speed {
            let is_constant = times.now.saturating_since(self.risen) > times.tolerance;
            if speed < self.speed || is_constant {
                // The lowest speed may have been as early as the last command.
                self.rise = Some((times.before, speed));
            }
            return false;
        }
        self.risen = times.now;
        let Some((began, from)) = self.rise else { return false };
        let rising_s = times.now.seconds_since(began) + times.tolerance.as_secs_f64();
        if speed <= from + risen_after(rising_s, motion) + ROUNDING_RAD_PER_S {
            return false;
        }
        // A stop from the other direction may be as sudden as it must.
        self.rise = None;
        speed > 0.0
    }
}

/// The largest rise of speed after a time, from an acceleration of 0: half of jerk times time squared, until the acceleration has
/// reached its limit.
fn risen_after(time_s: f64, motion: &AxisMotion) -> f64 {
    let AxisMotion { acceleration_max_rad_per_s2, jerk_max_rad_per_s3, .. } = *motion;
    let full_after_s = acceleration_max_rad_per_s2 / jerk_max_rad_per_s3;
    if time_s < full_after_s {
        jerk_max_rad_per_s3 * time_s * time_s / 2.0
    } else {
        acceleration_max_rad_per_s2 * (time_s - full_after_s / 2.0)
    }
}
