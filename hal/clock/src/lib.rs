//! The two clocks: [`SystemClock`] for the machine's monotonic time, [`VirtualClock`] for deterministic simulation.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

/// Monotonic time of the machine; its origin is the time of creation.
#[derive(Debug)]
pub struct SystemClock {
    origin: Instant,
}

impl SystemClock {
    /// A clock that starts now, at zero.
    pub fn new() -> Self {
        Self { origin: Instant::now() }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    fn now(&self) -> MonotonicTime {
        MonotonicTime::ZERO + self.origin.elapsed()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        loop {
            let left = deadline.saturating_since(self.now());
            if left == Duration::ZERO {
                return;
            }
            std::thread::sleep(left);
        }
    }
}

/// Virtual time that advances only when a thread sleeps; for deterministic, faster-than-real-time runs in one thread.
#[derive(Debug, Default)]
pub struct VirtualClock {
    nanos: AtomicU64,
}

impl VirtualClock {
    /// A clock at zero.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> MonotonicTime {
        MonotonicTime::from_nanos(self.nanos.load(Ordering::SeqCst))
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.nanos.fetch_max(deadline.as_nanos(), Ordering::SeqCst);
    }
}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
