//! The motion of one joint under one command, in closed form.

use std::cell::OnceCell;

/// More halvings or doublings than the 64 bits of a time need.
const SEARCH_STEPS: usize = 128;

/// Capabilities of the drive of one joint: rad, rad/s, rad/s^2, s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    pub acceleration_max: f64,
    pub time_constant: f64,
    pub velocity_max: f64,
    /// Dry friction as a velocity error; a smaller command does not move the joint.
    pub friction: f64,
    /// Lower and upper end stop.
    pub stops: [f64; 2],
}

impl Drive {
    pub fn saturate(&self, velocity: f64) -> f64 {
        velocity.clamp(-self.velocity_max, self.velocity_max)
    }

    /// Steady-state velocity with friction, which acts against the motion.
    fn against_friction(&self, velocity: f64, command: f64) -> f64 {
        if velocity == 0.0 {
            command - command.clamp(-self.friction, self.friction)
        } else {
            command - self.friction.copysign(velocity)
        }
    }
}

/// The trajectory of a joint from a state under a constant command, end stops included.
///
/// A joint at a stop is stationary and leaves it if the command points away. With friction it may stop at a turning point. There
/// are therefore at most four parts: to a turning point, to a stop, from it to the other stop, and stationary there.
#[derive(Clone, Debug)]
pub(super) struct JointPath {
    command: f64,
    first: Motion,
    /// Minimum duration of the first part, seconds.
    first_lasts: f64,
    /// The other parts, computed only if the trajectory is needed for longer; usually the next command comes much earlier.
    then: OnceCell<Box<[Part]>>,
}

/// A part of a trajectory after the first one.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Seconds after the start of the path.
    from: f64,
    motion: Motion,
}

impl JointPath {
    pub fn new(drive: &Drive, position: f64, velocity: f64, command: f64) -> Self {
        let first = Motion::new(drive, position, velocity, drive.against_friction(velocity, command));
        Self { command, first, first_lasts: first.lasts(drive), then: OnceCell::new() }
    }

    /// Position and velocity, `elapsed` seconds after the start.
    pub fn at(&self, drive: &Drive, elapsed: f64) -> (f64, f64) {
        let (position, velocity) = if elapsed < self.first_lasts {
            self.first.at(drive, elapsed)
        } else {
            let then = self.then.get_or_init(|| self.after_first(drive));
            match then.iter().rev().find(|part| part.from <= elapsed) {
                Some(part) => part.motion.at(drive, elapsed - part.from),
                None => self.first.at(drive, elapsed),
            }
        };
        // The search for the stop has rounding errors; the stop itself is exact.
        (position.clamp(drive.stops[0], drive.stops[1]), velocity)
    }

    fn after_first(&self, drive: &Drive) -> Box<[Part]> {
        let mut part = Part { from: 0.0, motion: self.first };
        let next = || {
            let (after, position) = part.motion.ends(drive)?;
            let mut towards = drive.against_friction(0.0, self.command);
            // The drive pushes against a stop without effect: the same as a zero command.
            if (position == drive.stops[1] && towards >= 0.0) || (position == drive.stops[0] && towards <= 0.0) {
                towards = 0.0;
            }
            part = Part { from: part.from + after, motion: Motion::new(drive, position, 0.0, towards) };
            Some(part)
        };
        std::iter::from_fn(next).take(3).collect()
    }
}

/// Free motion: first at the largest acceleration, until the lag alone needs less; then the velocity error decays with the time
/// constant.
#[derive(Clone, Copy, Debug)]
struct Motion {
    position: f64,
    velocity: f64,
    command: f64,
    /// Acceleration of the first phase, with its sign.
    acceleration: f64,
    /// Length of the first phase, s.
    saturated_for: f64,
    /// Velocity error (command minus velocity) and position at the end of the first phase.
    error_then: f64,
    position_then: f64,
}

impl Motion {
    fn new(drive: &Drive, position: f64, velocity: f64, command: f64) -> Self {
        let error = command - velocity;
        let acceleration = drive.acceleration_max.copysign(error);
        let error_followed = drive.acceleration_max * drive.time_constant;
        let saturated_for = ((error.abs() - error_followed) / drive.acceleration_max).max(0.0);
        let error_then = if saturated_for > 0.0 { error_followed.copysign(error) } else { error };
        let position_then = position + (velocity + 0.5 * acceleration * saturated_for) * saturated_for;
        Self { position, velocity, command, acceleration, saturated_for, error_then, position_then }
    }

    /// Position and velocity after `t` seconds.
    fn at(&self, drive: &Drive, t: f64) -> (f64, f64) {
        if t < self.saturated_for {
            let velocity = self.velocity + self.acceleration * t;
            return (self.position + 0.5 * (self.velocity + velocity) * t, velocity);
        }
        let t = t - self.saturated_for;
        if drive.time_constant == 0.0 {
            return (self.position_then + self.command * t, self.command);
        }
        // 1 - exp(-t/tau), accurate for short times.
        let settled = -(-t / drive.time_constant).exp_m1();
        let position = self.position_then + self.command * t - self.error_then * drive.time_constant * settled;
        (position, self.command - self.error_then * (1.0 - settled))
    }

    /// Lower bound of the duration, seconds: to the nearer stop at the largest speed, or to a turning point with friction.
    fn lasts(&self, drive: &Drive) -> f64 {
        /// Much larger than rounding errors of a position.
        const ROUNDING_RAD: f64 = 1e-9;
        let [lower, upper] = drive.stops;
        let room = (self.position - lower).min(upper - self.position);
        // The velocity changes monotonically from the present to the commanded value.
        let speed = self.velocity.abs().max(self.command.abs());
        // Written so that NaN gives no time.
        let until_stop = if room > ROUNDING_RAD { 0.99 * room / speed } else { 0.0 };
        if drive.friction == 0.0 { until_stop } else { until_stop.min(self.turns_after(drive)) }
    }

    /// When and where the motion ends, seconds: at a stop, or where friction changes its direction.
    fn ends(&self, drive: &Drive) -> Option<(f64, f64)> {
        let turn = self.turns_after(drive);
        if drive.friction == 0.0 || turn.is_infinite() {
            return self.reaches_stop(drive);
        }
        let stop = drive.stops[usize::from(self.velocity > 0.0)];
        let stopped = self.reaches(drive, stop, 0.0, turn).map(|after| (after, stop));
        Some(stopped.unwrap_or_else(|| (turn, self.at(drive, turn).0)))
    }

    /// When the motion first reaches a stop, seconds, and which one.
    fn reaches_stop(&self, drive: &Drive) -> Option<(f64, f64)> {
        let turn = self.turns_after(drive);
        if self.velocity != 0.0 {
            let stop = drive.stops[usize::from(self.velocity > 0.0)];
            if let Some(after) = self.reaches(drive, stop, 0.0, turn) {
                return Some((after, stop));
            }
        }
        if (self.velocity == 0.0 || turn.is_finite()) && self.command != 0.0 {
            let stop = drive.stops[usize::from(self.command > 0.0)];
            let from = if self.velocity == 0.0 { 0.0 } else { turn };
            return self.reaches(drive, stop, from, f64::INFINITY).map(|after| (after, stop));
        }
        None
    }

    /// When the velocity changes its sign, seconds; infinite if it never does.
    fn turns_after(&self, drive: &Drive) -> f64 {
        if self.velocity * self.command >= 0.0 {
            return f64::INFINITY;
        }
        let saturated = self.velocity.abs() / drive.acceleration_max;
        if saturated <= self.saturated_for {
            return saturated;
        }
        self.saturated_for + drive.time_constant * (self.error_then / self.command).ln()
    }

    /// The first time within `from..=to`, an interval without a turning point, at which `stop` is passed; found by bisection.
    fn reaches(&self, drive: &Drive, stop: f64, from: f64, to: f64) -> Option<f64> {
        let outwards = if stop == drive.stops[1] { 1.0 } else { -1.0 };
        // A joint on the stop has reached it; so has one that only stops there.
        let beyond = |t: f64| (self.at(drive, t).0 - stop) * outwards >= 0.0;
        if beyond(from) {
            return Some(from);
        }
        let mut later = to;
        if to.is_infinite() {
            let mut step = 1.0;
            later = (0..SEARCH_STEPS)
                .map_while(|_| {
                    let tried = from + step;
                    step *= 2.0;
                    tried.is_finite().then_some(tried)
                })
                .find(|&t| beyond(t))?;
        } else if !beyond(to) {
            return None;
        }
        let mut earlier = from;
        for _ in 0..SEARCH_STEPS {
            let middle = 0.5 * (earlier + later);
            if middle <= earlier || middle >= later {
                break;
            }
            if beyond(middle) { later = middle } else { earlier = middle }
        }
        Some(later)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

        /// The next part is computed on demand only, so it must not begin before the lower bound.
        #[test]
        fn no_motion_ends_before_it_lasts(
            position in -1.0..=1.0f64, velocity in -2.0..2.0f64, command in -2.0..2.0f64, still in 0usize..4,
            friction in prop_oneof![Just(0.0), 0.001..0.3f64], time_constant in prop_oneof![Just(0.0), 0.01..0.3f64],
        ) {
            let drive = Drive { acceleration_max: 3.0, time_constant, velocity_max: 2.0, friction, stops: [-1.0, 1.0] };
            let velocity = if still & 1 == 0 { velocity } else { 0.0 };
            let command = if still & 2 == 0 { command } else { 0.0 };
            let motion = Motion::new(&drive, position, velocity, drive.against_friction(velocity, command));
            let lasts = motion.lasts(&drive);
            if let Some((after, _)) = motion.ends(&drive) {
                prop_assert!(lasts <= after, "{lasts} s, but ends after {after} s");
            }
            let nearest = 1.0 - position.abs();
            let is_turning = friction > 0.0 && velocity * motion.command < 0.0;
            prop_assert!(nearest < 0.01 || is_turning || lasts >= nearest / 2.5, "{lasts} s for {nearest} rad");
        }
    }
}
