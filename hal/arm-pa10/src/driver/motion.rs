//! The velocity of a cycle.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

use pb3dp_arm_pa10_protocol::watchdog::{CommandWatchdog, Staleness};

/// A velocity that was commanded at this time, and fades without a successor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VelocityCommand {
    pub velocity_rad_per_s: JointVector,
    pub since: MonotonicTime,
}

/// Deceleration from a velocity to standstill, each joint within its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ramp {
    from_rad_per_s: JointVector,
    since: MonotonicTime,
    durations_s: JointVector,
}

impl VelocityCommand {
    /// The velocity at a time, rad/s.
    pub fn velocity_rad_per_s(&self, now: MonotonicTime, watchdog: &CommandWatchdog) -> JointVector {
        match watchdog.judge(now.saturating_since(self.since)) {
            Staleness::Fresh => self.velocity_rad_per_s,
            Staleness::Ramp(part) => self.velocity_rad_per_s * part,
            Staleness::Expired => JointVector::zeros(),
        }
    }

    /// Age beyond the watchdog's limit.
    pub fn expired(&self, now: MonotonicTime, watchdog: &CommandWatchdog) -> Option<Duration> {
        let age = now.saturating_since(self.since);
        (watchdog.judge(age) == Staleness::Expired).then_some(age)
    }
}

impl Ramp {
    /// Each joint with its own deceleration: no joint moves for longer because another one is faster, so the range that the
    /// limiter reserved is sufficient. The hand may deviate slightly from its path.
    pub fn decelerate(
        from_rad_per_s: JointVector,
        deceleration_rad_per_s2: &JointVector,
        since: MonotonicTime,
    ) -> Self {
        let durations_s = from_rad_per_s.abs().component_div(deceleration_rad_per_s2);
        Self { from_rad_per_s, since, durations_s }
    }

    /// All joints by the same factor within this time.
    pub fn stop_within(from_rad_per_s: JointVector, duration: Duration, since: MonotonicTime) -> Self {
        Self { from_rad_per_s, since, durations_s: JointVector::repeat(duration.as_secs_f64()) }
    }

    /// The velocity at a time, rad/s.
    pub fn velocity_rad_per_s(&self, now: MonotonicTime) -> JointVector {
        let elapsed_s = now.saturating_since(self.since).as_secs_f64();
        self.from_rad_per_s.zip_map(&self.durations_s, |from, duration_s| {
            if elapsed_s < duration_s { from * (1.0 - elapsed_s / duration_s) } else { 0.0 }
        })
    }

    /// Whether the ramp has ended.
    pub fn is_at_rest(&self, now: MonotonicTime) -> bool {
        now.saturating_since(self.since).as_secs_f64() >= self.durations_s.max()
    }
}
