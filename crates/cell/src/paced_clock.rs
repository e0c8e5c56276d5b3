//! A virtual clock at wall-clock speed: one simulated second takes at least one second. Results do not change.

use std::time::{Duration, Instant};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::VirtualClock;

/// A virtual clock whose sleepers also wait for the wall clock.
#[derive(Debug)]
pub struct PacedClock {
    virtual_clock: VirtualClock,
    origin: Instant,
}

impl PacedClock {
    /// A clock at zero that starts now.
    pub fn new() -> Self {
        Self { virtual_clock: VirtualClock::new(), origin: Instant::now() }
    }
}

impl Default for PacedClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for PacedClock {
    fn now(&self) -> MonotonicTime {
        self.virtual_clock.now()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        let due = self.origin + Duration::from_nanos(deadline.as_nanos());
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        self.virtual_clock.sleep_until(deadline);
    }
}
