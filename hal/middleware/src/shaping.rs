//! From a desired joint velocity to one that keeps every limit. Pure functions; rad, rad/s, rad/s^2, rad/s^3, s.

use pb3dp_kinematics::{DOF, JointLimits, JointVector};

use crate::stopping::{DriveLimit, DriveLimits, braking_speed};

/// The velocities that are allowed at a place, and why.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Caps {
    pub lower: JointVector,
    pub upper: JointVector,
    /// Whether the way to a limit, and not the joint's speed, is what limits: downwards and upwards.
    pub by_position: [[bool; 2]; DOF],
}

/// Command of an arm: a velocity, and how it changes until it is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SetPoint {
    pub velocity: JointVector,
    pub acceleration: JointVector,
}

impl SetPoint {
    pub(crate) fn rest() -> Self {
        Self { velocity: JointVector::zeros(), acceleration: JointVector::zeros() }
    }
}

/// The room that is left, and what of it is used up already.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Room {
    /// From the measured angles down and up to the ends of the range, rad; negative outside.
    pub to_ends: [JointVector; 2],
    /// Largest speeds downwards and upwards of the set-points that may not be in the measured angles yet, rad/s.
    pub peaks: [JointVector; 2],
    /// For how long joints may still move like that, s.
    pub reaction_s: f64,
}

/// What became of a desired velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shaped {
    pub set_point: SetPoint,
    pub speed_limited: bool,
    pub position_limited: bool,
    pub acceleration_limited: bool,
}

/// How velocities may change until the next set-point.
pub(crate) struct Step<'a> {
    pub previous: &'a SetPoint,
    pub dt_s: f64,
    pub drives: &'a DriveLimits,
    /// Largest speeds, rad/s.
    pub speeds: &'a JointVector,
}

/// Allowed velocities for joints at `position`: within the range of `limits`, up to `speeds`, rad/s. `reaction_s` is without the time
/// that the jerk takes.
pub(crate) fn caps(
    position: &JointVector,
    limits: &JointLimits,
    speeds: &JointVector,
    drives: &DriveLimits,
    reaction_s: f64,
) -> Caps {
    let mut caps = Caps { lower: JointVector::zeros(), upper: JointVector::zeros(), by_position: [[false; 2]; DOF] };
    for i in 0..DOF {
        let (drive, speed) = (drives.of(i), speeds[i]);
        let fastest = |distance: f64| braking_speed(distance, drive.acceleration, reaction_s + drive.rounding_s());
        let towards_min = fastest(position[i] - limits.position_min_rad()[i]);
        let towards_max = fastest(limits.position_max_rad()[i] - position[i]);
        caps.lower[i] = -towards_min.min(speed);
        caps.upper[i] = towards_max.min(speed);
        caps.by_position[i] = [towards_min < speed, towards_max < speed];
    }
    caps
}

/// The set-point nearest to `desired` that keeps the caps where that is possible, and in any case the speeds, accelerations and
/// jerks of `step` and, if there is any, the room: brought to rest afterwards, no joint leaves it.
///
/// Too fast: the whole vector is scaled, so that the hand keeps its direction. Too sudden: the whole vector is scaled as much as
/// that helps; where no multiple of it can be reached at once (the direction changes), each joint goes up to its limit.
/// Without room nothing is known of the arm: each joint comes to rest as quickly as it may.
pub(crate) fn shape(desired: &JointVector, caps: &Caps, step: &Step<'_>, room: Option<&Room>) -> Shaped {
    let (target, mut shaped) = scaled_to_caps(desired, caps);
    let wanted = if room.is_some() { target } else { JointVector::zeros() };
    let mut intervals = [(0.0, 0.0); DOF];
    for (i, interval) in intervals.iter_mut().enumerate() {
        let joint = step.joint(i);
        let (lowest, highest) = joint.reachable();
        let (lowest, highest) = match room {
            Some(room) => joint.within(room, i, (lowest, highest)),
            None => (lowest, highest),
        };
        shaped.position_limited |= !(lowest..=highest).contains(&joint.towards(wanted[i], joint.reachable()));
        let nearest = joint.towards(wanted[i], (lowest, highest));
        *interval = if wanted[i] >= joint.velocity { (lowest, nearest) } else { (nearest, highest) };
    }
    let along = match room {
        Some(_) if target != JointVector::zeros() => nearest_multiple(&target, 1.0, &intervals),
        // On the way to rest the hand keeps the direction that it has.
        Some(_) => nearest_multiple(&step.previous.velocity, 0.0, &intervals),
        None => None,
    };
    for (i, &(lowest, highest)) in intervals.iter().enumerate() {
        let velocity = along.as_ref().map_or(wanted[i], |along| along[i]).clamp(lowest, highest);
        shaped.set_point.velocity[i] = velocity.clamp(-step.speeds[i], step.speeds[i]);
    }
    for i in 0..DOF {
        let joint = step.joint(i);
        let (least, most) = joint.accelerations();
        let change = shaped.set_point.velocity[i] - joint.velocity;
        // Commands at one moment leave no time for a change.
        let acceleration = if step.dt_s > 0.0 { change / step.dt_s } else { joint.acceleration };
        shaped.set_point.acceleration[i] = acceleration.clamp(least, most);
    }
    shaped.acceleration_limited = differ(&shaped.set_point.velocity, &wanted);
    shaped
}

/// Whether velocities differ by more than rounding.
pub(crate) fn differ(one: &JointVector, other: &JointVector) -> bool {
    (one - other).amax() > 1e-12
}

/// A multiple of `desired`, at most 1, within the caps.
fn scaled_to_caps(desired: &JointVector, caps: &Caps) -> (JointVector, Shaped) {
    let mut shaped = Shaped {
        set_point: SetPoint::rest(),
        speed_limited: false,
        position_limited: false,
        acceleration_limited: false,
    };
    let mut scale = 1.0f64;
    for i in 0..DOF {
        let upwards = desired[i] > 0.0;
        let cap = if upwards { caps.upper[i] } else { -caps.lower[i] };
        if desired[i].abs() > cap {
            scale = scale.min(cap / desired[i].abs());
            let by_position = caps.by_position[i][usize::from(upwards)];
            shaped.position_limited |= by_position;
            shaped.speed_limited |= !by_position;
        }
    }
    (desired * scale, shaped)
}

/// The multiple of `direction` that is within all intervals and nearest to `wanted` times it, if there is one.
fn nearest_multiple(direction: &JointVector, wanted: f64, intervals: &[(f64, f64); DOF]) -> Option<JointVector> {
    let (mut least, mut most) = (0.0f64, f64::INFINITY);
    for (i, &(lower, upper)) in intervals.iter().enumerate() {
        if direction[i] == 0.0 {
            if lower > 0.0 || upper < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (lower / direction[i], upper / direction[i]);
        least = least.max(a.min(b));
        most = most.min(a.max(b));
    }
    (least <= most).then(|| direction * wanted.clamp(least, most))
}

/// One joint of a [`Step`].
struct JointStep {
    velocity: f64,
    acceleration: f64,
    dt_s: f64,
    drive: DriveLimit,
    speed: f64,
}

impl Step<'_> {
    fn joint(&self, i: usize) -> JointStep {
        JointStep {
            velocity: self.previous.velocity[i],
            acceleration: self.previous.acceleration[i],
            dt_s: self.dt_s,
            drive: self.drives.of(i),
            speed: self.speeds[i],
        }
    }
}

impl JointStep {
    /// Accelerations that jerk and acceleration allow.
    fn accelerations(&self) -> (f64, f64) {
        let (most, change) = (self.drive.acceleration, self.drive.jerk * self.dt_s);
        ((self.acceleration - change).clamp(-most, most), (self.acceleration + change).clamp(-most, most))
    }

    /// The velocities that can be reached, none of which leads beyond the joint's speed later on.
    fn reachable(&self) -> (f64, f64) {
        let (least, most) = self.accelerations();
        let lowest = self.drive.towards(-self.speed - self.velocity, self.dt_s).clamp(least, most);
        let highest = self.drive.towards(self.speed - self.velocity, self.dt_s).clamp(least, most);
        (self.velocity + lowest * self.dt_s, self.velocity + highest * self.dt_s)
    }

    /// The velocity on the quickest way to `wanted` that does not pass it.
    fn towards(&self, wanted: f64, (lowest, highest): (f64, f64)) -> f64 {
        let (least, most) = self.accelerations();
        let acceleration = self.drive.towards(wanted - self.velocity, self.dt_s).clamp(least, most);
        (self.velocity + acceleration * self.dt_s).clamp(lowest, highest)
    }

    /// The part of an interval of velocities that leaves room to come to rest. Where none does, what comes to rest soonest.
    fn within(&self, room: &Room, i: usize, (lowest, highest): (f64, f64)) -> (f64, f64) {
        let to_rest = self.towards(0.0, (lowest, highest));
        let lower = -self.farthest(-to_rest, -lowest, |velocity| self.has_room(room, i, 0, velocity));
        let upper = self.farthest(to_rest, highest, |velocity| self.has_room(room, i, 1, velocity));
        (lower, upper)
    }

    /// The farthest number between `near` and `far` for which `is_good` holds; `near` if it holds for none.
    fn farthest(&self, near: f64, far: f64, is_good: impl Fn(f64) -> bool) -> f64 {
        const HALVINGS: u32 = 24;
        if is_good(far) {
            return far;
        }
        let (mut good, mut bad) = (near, far);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (good + bad);
            if is_good(middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        good
    }

    /// Whether the joint, told to move with this speed to `side` (0 downwards, 1 upwards) and then to come to rest, stays
    /// within its room. Outside it may only come back.
    fn has_room(&self, room: &Room, i: usize, side: usize, speed: f64) -> bool {
        let upwards = [-1.0, 1.0][side];
        let acceleration = match self.dt_s > 0.0 {
            true => (speed - upwards * self.velocity) / self.dt_s,
            false => upwards * self.acceleration,
        };
        let meanwhile = room.reaction_s * room.peaks[side][i].max(speed).max(0.0);
        meanwhile + self.drive.way_to_rest(speed, acceleration) <= room.to_ends[side][i].max(0.0)
    }
}

#[cfg(test)]
mod tests;
