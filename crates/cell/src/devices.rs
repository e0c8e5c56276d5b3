//! An arm with its limiter, and the monitor of its link.

use std::time::Duration;

use pb3dp_hal_api::{Arm, ArmPower};
use pb3dp_hal_middleware::{Limiter, LimiterStatistics};
use pb3dp_hal_platform::jitter::Jitter;
use pb3dp_kinematics::DOF;

/// An arm with its limiter: motion, power, and limiter statistics.
pub trait ArmControl: Arm + ArmPower {
    /// How often the limiter has intervened.
    fn statistics(&self) -> LimiterStatistics;
}

impl<A: Arm + ArmPower> ArmControl for Limiter<A> {
    fn statistics(&self) -> LimiterStatistics {
        Self::statistics(self)
    }
}

/// Timing and completeness of the exchanges on an arm's link.
pub trait LinkMonitor: Send {
    /// Period of the link cycles.
    fn period(&self) -> Duration;

    /// Lateness of the link cycles.
    fn lateness(&self) -> Jitter;

    /// Missed cycles and lost replies.
    fn counts(&self) -> LinkCounts;

    /// Limits of all motion that the gateway has stated; `None` without a gateway.
    fn gateway_limits(&self) -> Option<GatewayLimits>;
}

/// Limits beyond which a gateway stops its arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatewayLimits {
    /// Largest speeds, rad/s.
    pub speed_max_rad_per_s: [f64; DOF],
    /// Smallest and largest angles, radians.
    pub range_rad: [[f64; DOF]; 2],
}

/// Missed cycles and lost replies of an arm's link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Cycles skipped because their time had passed.
    pub missed: u64,
    /// Replies that did not arrive in time.
    pub replies_lost: u64,
}
