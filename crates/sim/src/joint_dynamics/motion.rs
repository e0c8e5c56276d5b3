//! The motion of one joint under one command, in closed form.

/// More than enough halvings or doublings for the 64 bits of a time.
const SEARCH_STEPS: usize = 128;

/// What the drive of one joint can do: rad, rad/s, rad/s^2, s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    pub acceleration_max: f64,
    pub time_constant: f64,
    pub velocity_max: f64,
    /// Dry friction, as the speed by which it makes the joint miss its command; a smaller command does not move it.
    pub friction: f64,
    /// Lower and upper end stop.
    pub stops: [f64; 2],
}

impl Drive {
    pub fn saturate(&self, velocity: f64) -> f64 {
        velocity.clamp(-self.velocity_max, self.velocity_max)
    }

    /// The velocity that a joint tends to against its friction, which points against its motion.
    fn against_friction(&self, velocity: f64, command: f64) -> f64 {
        if velocity == 0.0 {
            command - command.clamp(-self.friction, self.friction)
        } else {
            command - self.friction.copysign(velocity)
        }
    }
}

/// The path of a joint from a state under a constant command, end stops included.
///
/// At a stop the joint is at rest; it leaves it if the command leads away. With friction it may come to rest at a turn. So there
/// are at most four parts: to a turn, to a stop, from it to the other, and rest there.
#[derive(Clone, Debug)]
pub(super) struct JointPath {
    first: Part,
    then: [Option<Part>; 3],
}

#[derive(Clone, Copy, Debug)]
struct Part {
    /// Seconds after the start of the path.
    from: f64,
    motion: Motion,
}

impl JointPath {
    pub fn new(drive: &Drive, position: f64, velocity: f64, command: f64) -> Self {
        let towards = drive.against_friction(velocity, command);
        let first = Part { from: 0.0, motion: Motion::new(drive, position, velocity, towards) };
        let mut then = [None; 3];
        let mut part = first;
        for slot in &mut then {
            let Some((after, position)) = part.motion.ends(drive) else { break };
            let mut towards = drive.against_friction(0.0, command);
            // Against a stop the drive pushes in vain: as if it were told to rest.
            if (position == drive.stops[1] && towards >= 0.0) || (position == drive.stops[0] && towards <= 0.0) {
                towards = 0.0;
            }
            part = Part { from: part.from + after, motion: Motion::new(drive, position, 0.0, towards) };
            *slot = Some(part);
        }
        Self { first, then }
    }

    /// Position and velocity, `elapsed` seconds after the start.
    pub fn at(&self, drive: &Drive, elapsed: f64) -> (f64, f64) {
        let begun = self.then.iter().flatten().rev().find(|part| part.from <= elapsed);
        let part = begun.unwrap_or(&self.first);
        let (position, velocity) = part.motion.at(drive, elapsed - part.from);
        // The search for the stop is exact but for rounding; the stop is exact.
        (position.clamp(drive.stops[0], drive.stops[1]), velocity)
    }
}

/// Free motion: first at the largest acceleration, until the velocity error is one that the lag needs less for; then the
/// error decays with the time constant.
#[derive(Clone, Copy, Debug)]
struct Motion {
    position: f64,
    velocity: f64,
    command: f64,
    /// Acceleration of the first phase, with its sign.
    acceleration: f64,
    /// Length of the first phase, s.
    saturated_for: f64,
    /// Velocity error (command minus velocity) and position at its end.
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

    /// After how many seconds the motion ends, and where: at a stop, or where friction changes its direction.
    fn ends(&self, drive: &Drive) -> Option<(f64, f64)> {
        let turn = self.turns_after(drive);
        if drive.friction == 0.0 || turn.is_infinite() {
            return self.reaches_stop(drive);
        }
        let stop = drive.stops[usize::from(self.velocity > 0.0)];
        let stopped = self.reaches(drive, stop, 0.0, turn).map(|after| (after, stop));
        Some(stopped.unwrap_or_else(|| (turn, self.at(drive, turn).0)))
    }

    /// After how many seconds the motion first runs into a stop, and into which.
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

    /// After how many seconds the velocity changes its sign; infinite if it never does.
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

    /// The first time within `from..=to`, an interval without a turn, at which `stop` is passed; found by halving.
    fn reaches(&self, drive: &Drive, stop: f64, from: f64, to: f64) -> Option<f64> {
        let outwards = if stop == drive.stops[1] { 1.0 } else { -1.0 };
        // A joint that rests on the stop has reached it; one that only comes to rest there has as well.
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
