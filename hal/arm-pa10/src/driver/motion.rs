//! The velocity that is sent in a cycle.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

use crate::watchdog::{CommandWatchdog, Staleness};

/// Where the velocity comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// None.
    Rest,
    /// Followed since this time, and fading if no other comes.
    Follow { velocity_rad_per_s: JointVector, since: MonotonicTime },
    /// On the way from this velocity to rest: all joints by the same part, so the hand keeps its way.
    Ramp { from_rad_per_s: JointVector, since: MonotonicTime, duration: Duration },
}

impl Motion {
    /// From a velocity to rest, with no joint braking harder than this.
    pub fn decelerate(
        from_rad_per_s: JointVector,
        deceleration_rad_per_s2: &JointVector,
        since: MonotonicTime,
    ) -> Self {
        let seconds = from_rad_per_s.abs().component_div(deceleration_rad_per_s2).max();
        Self::Ramp { from_rad_per_s, since, duration: Duration::from_secs_f64(seconds) }
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
            Self::Ramp { from_rad_per_s, since, duration } => {
                let elapsed = now.saturating_since(*since);
                if elapsed >= *duration {
                    return JointVector::zeros();
                }
                from_rad_per_s * (1.0 - elapsed.as_secs_f64() / duration.as_secs_f64())
            }
        }
    }

    /// Whether a ramp, if there is one, has come to its end.
    pub fn is_at_rest(&self, now: MonotonicTime) -> bool {
        match self {
            Self::Rest => true,
            Self::Follow { .. } => false,
            Self::Ramp { since, duration, .. } => now.saturating_since(*since) >= *duration,
        }
    }

    /// Age of a velocity that is older than the watchdog allows.
    pub fn expired(&self, now: MonotonicTime, watchdog: &CommandWatchdog) -> Option<Duration> {
        let Self::Follow { since, .. } = self else { return None };
        let age = now.saturating_since(*since);
        (watchdog.judge(age) == Staleness::Expired).then_some(age)
    }
}
