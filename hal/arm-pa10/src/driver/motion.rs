//! The commanded velocity of a cycle.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

use pb3dp_arm_pa10_protocol::watchdog::{CommandWatchdog, Staleness};

/// Source of the velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// None.
    Rest,
    /// Commanded at this time, and fading without a successor.
    Follow { velocity_rad_per_s: JointVector, since: MonotonicTime },
    /// Deceleration from this velocity to standstill, each joint within its own time, s.
    Ramp { from_rad_per_s: JointVector, since: MonotonicTime, durations_s: JointVector },
}

impl Motion {
    /// From a velocity to standstill, each joint with its own deceleration: no joint moves for longer because another one is
    /// faster, so the range that the limiter reserved is sufficient. The hand may deviate slightly from its path.
    pub fn decelerate(
        from_rad_per_s: JointVector,
        deceleration_rad_per_s2: &JointVector,
        since: MonotonicTime,
    ) -> Self {
        let durations_s = from_rad_per_s.abs().component_div(deceleration_rad_per_s2);
        Self::Ramp { from_rad_per_s, since, durations_s }
    }

    /// From a velocity to standstill within this time: all joints by the same factor.
    pub fn stop_within(from_rad_per_s: JointVector, duration: Duration, since: MonotonicTime) -> Self {
        Self::Ramp { from_rad_per_s, since, durations_s: JointVector::repeat(duration.as_secs_f64()) }
    }

    /// The velocity at a time, rad/s.
    pub fn velocity_rad_per_s(&self, now: MonotonicTime, watchdog: &CommandWatchdog) -> JointVector {
        match self {
            Self::Rest => JointVector::zeros(),
            Self::Follow { velocity_rad_per_s, since } => match watchdog.judge(now.saturating_since(*since)) {
                Staleness::Fresh => *velocity_rad_per_s,
                Staleness::Ramp(part) => velocity_rad_per_s * part,
                Staleness::Expired => JointVector::zeros(),
            },
            Self::Ramp { from_rad_per_s, since, durations_s } => {
                let elapsed_s = now.saturating_since(*since).as_secs_f64();
                from_rad_per_s.zip_map(durations_s, |from, duration_s| {
                    if elapsed_s < duration_s { from * (1.0 - elapsed_s / duration_s) } else { 0.0 }
                })
            }
        }
    }

    /// Whether a ramp, if there is one, has ended.
    pub fn is_at_rest(&self, now: MonotonicTime) -> bool {
        match self {
            Self::Rest => true,
            Self::Follow { .. } => false,
            Self::Ramp { since, durations_s, .. } => now.saturating_since(*since).as_secs_f64() >= durations_s.max(),
        }
    }

    /// Age of a velocity beyond the watchdog's limit.
    pub fn expired(&self, now: MonotonicTime, watchdog: &CommandWatchdog) -> Option<Duration> {
        let Self::Follow { since, .. } = self else { return None };
        let age = now.saturating_since(*since);
        (watchdog.judge(age) == Staleness::Expired).then_some(age)
    }
}
