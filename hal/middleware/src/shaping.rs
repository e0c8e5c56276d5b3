//! Shapes a desired joint velocity so that it keeps every limit. Pure functions; rad, rad/s, rad/s^2, rad/s^3, s.

use pb3dp_kinematics::{DOF, JointLimits, JointVector};

use crate::stopping::{DriveLimit, DriveLimits, braking_speed};

/// Allowed velocities at a position, with the reason.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SpeedCaps {
    pub lower: JointVector,
    pub upper: JointVector,
    /// Whether the distance to a limit, and not the joint's speed limit, decides: downwards and upwards.
    pub by_position: [[bool; 2]; DOF],
}

/// Set-point of an arm: a velocity, and its rate of change until it is reached.
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

/// Remaining range, and the part of it that earlier set-points use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StopDistance {
    /// Distance from the measured angles down and up to the limits, rad; negative outside.
    pub to_ends: [JointVector; 2],
    /// Largest speeds downwards and upwards of set-points that the measured angles may not show yet, rad/s.
    pub peaks: [JointVector; 2],
    /// Time for which joints may still move with these speeds, s.
    pub reaction_s: f64,
}

/// Result for a desired velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shaped {
    pub set_point: SetPoint,
    pub speed_limited: bool,
    pub position_limited: bool,
    pub acceleration_limited: bool,
}

/// Allowed changes of velocity until the next set-point.
pub(crate) struct CycleInput<'a> {
    pub previous: &'a SetPoint,
    pub dt_s: f64,
    pub drives: &'a DriveLimits,
    /// Speed limits, rad/s.
    pub speeds: &'a JointVector,
}

/// Allowed velocities for joints at `position`: inside the range of `limits`, up to `speeds`, rad/s. `reaction_s` excludes the time
/// for the jerk.
pub(crate) fn caps(
    position: &JointVector,
    limits: &JointLimits,
    speeds: &JointVector,
    drives: &DriveLimits,
    reaction_s: f64,
) -> SpeedCaps {
    let mut caps =
        SpeedCaps { lower: JointVector::zeros(), upper: JointVector::zeros(), by_position: [[false; 2]; DOF] };
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

/// The set-point nearest to `desired` that keeps the caps if possible, and always the speeds, accelerations and jerks of `step`
/// and, if given, the range: each joint can stop inside it afterwards.
///
/// Too fast: the whole vector is scaled, so that the hand keeps its direction. Too sudden: the whole vector is scaled as much as
/// that helps; if no multiple of it can be reached at once (the direction changes), each joint changes up to its limit. Without a
/// range the state of the arm is unknown: each joint stops as quickly as allowed.
pub(crate) fn shape(
    desired: &JointVector,
    caps: &SpeedCaps,
    step: &CycleInput<'_>,
    stop_distance: Option<&StopDistance>,
) -> Shaped {
    let (target, mut shaped) = scaled_to_caps(desired, caps);
    let wanted = if stop_distance.is_some() { target } else { JointVector::zeros() };
    let mut intervals = [(0.0, 0.0); DOF];
    for (i, interval) in intervals.iter_mut().enumerate() {
        let joint = step.joint(i);
        let (lowest, highest) = joint.reachable();
        let (lowest, highest) = match stop_distance {
            Some(stop_distance) => joint.within(stop_distance, i, (lowest, highest)),
            None => (lowest, highest),
        };
        shaped.position_limited |= !(lowest..=highest).contains(&joint.towards(wanted[i], joint.reachable()));
        let nearest = joint.towards(wanted[i], (lowest, highest));
        *interval = if wanted[i] >= joint.velocity { (lowest, nearest) } else { (nearest, highest) };
    }
    let along = match stop_distance {
        Some(_) if target != JointVector::zeros() => nearest_multiple(&target, 1.0, &intervals),
        // During deceleration the hand keeps its direction.
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
        // Two commands at the same time allow no change.
        let acceleration = if step.dt_s > 0.0 { change / step.dt_s } else { joint.acceleration };
        shaped.set_point.acceleration[i] = acceleration.clamp(least, most);
    }
    shaped.acceleration_limited = differ(&shaped.set_point.velocity, &wanted);
    shaped
}

/// Whether two velocities differ by more than rounding.
pub(crate) fn differ(one: &JointVector, other: &JointVector) -> bool {
    (one - other).amax() > 1e-12
}

/// A multiple of `desired`, at most 1, within the caps.
fn scaled_to_caps(desired: &JointVector, caps: &SpeedCaps) -> (JointVector, Shaped) {
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

/// The multiple of `direction` inside all intervals that is nearest to `wanted` times it, if there is one.
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

/// One joint of a [`CycleInput`].
struct JointStep {
    velocity: f64,
    acceleration: f64,
    dt_s: f64,
    drive: DriveLimit,
    speed: f64,
}

impl CycleInput<'_> {
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
    /// Accelerations within the limits of jerk and acceleration.
    fn accelerations(&self) -> (f64, f64) {
        let (most, change) = (self.drive.acceleration, self.drive.jerk * self.dt_s);
        ((self.acceleration - change).clamp(-most, most), (self.acceleration + change).clamp(-most, most))
    }

    /// The reachable velocities, none of which leads beyond the joint's speed limit later.
    fn reachable(&self) -> (f64, f64) {
        let (least, most) = self.accelerations();
        let lowest = self.drive.towards(-self.speed - self.velocity, self.dt_s).clamp(least, most);
        let highest = self.drive.towards(self.speed - self.velocity, self.dt_s).clamp(least, most);
        (self.velocity + lowest * self.dt_s, self.velocity + highest * self.dt_s)
    }

    /// The velocity on the quickest path to `wanted` that does not pass it.
    fn towards(&self, wanted: f64, (lowest, highest): (f64, f64)) -> f64 {
        let (least, most) = self.accelerations();
        let acceleration = self.drive.towards(wanted - self.velocity, self.dt_s).clamp(least, most);
        (self.velocity + acceleration * self.dt_s).clamp(lowest, highest)
    }

    /// The part of an interval of velocities from which the joint can stop in range; if there is none, the velocity that stops
    /// soonest.
    fn within(&self, stop_distance: &StopDistance, i: usize, (lowest, highest): (f64, f64)) -> (f64, f64) {
        let to_rest = self.towards(0.0, (lowest, highest));
        let lower = -self.farthest(-to_rest, -lowest, |velocity| self.has_room(stop_distance, i, 0, velocity));
        let upper = self.farthest(to_rest, highest, |velocity| self.has_room(stop_distance, i, 1, velocity));
        (lower, upper)
    }

    /// The farthest number between `near` and `far` for which `is_good` holds; `near` if there is none.
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

    /// Whether the joint stays in its range if it moves with this speed to `side` (0 downwards, 1 upwards) and then stops. Outside
    /// the range it may only come back.
    fn has_room(&self, stop_distance: &StopDistance, i: usize, side: usize, speed: f64) -> bool {
        let upwards = [-1.0, 1.0][side];
        let acceleration = match self.dt_s > 0.0 {
            true => (speed - upwards * self.velocity) / self.dt_s,
            false => upwards * self.acceleration,
        };
        // An acceleration ends within the limit of jerk: until then the joint still gains speed, and each of these speeds may last.
        let gained = acceleration.max(0.0).powi(2) / (2.0 * self.drive.jerk);
        let meanwhile = stop_distance.reaction_s * stop_distance.peaks[side][i].max(speed + gained).max(0.0);
        meanwhile + self.drive.way_to_rest(speed, acceleration) <= stop_distance.to_ends[side][i].max(0.0)
    }
}

#[cfg(test)]
mod tests;
