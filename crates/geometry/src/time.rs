//! Time on a monotonic clock.

use std::ops::{Add, Sub};
use std::time::Duration;

/// A point in time on one monotonic clock: nanoseconds since that clock's origin.
///
/// Clocks are injected (`pb3dp-hal-api`'s `Clock`); this type only holds their readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MonotonicTime {
    nanos: u64,
}

impl MonotonicTime {
    /// The clock's origin.
    pub const ZERO: Self = Self { nanos: 0 };

    /// A time from nanoseconds since the clock's origin.
    pub const fn from_nanos(nanos: u64) -> Self {
        Self { nanos }
    }

    /// A time from seconds since the clock's origin, rounded to nanoseconds; negative values and NaN give zero;
    /// values that are too large give the largest time.
    pub fn from_secs_f64(secs: f64) -> Self {
        Self { nanos: (secs * 1e9).round() as u64 }
    }

    /// Nanoseconds since the clock's origin.
    pub const fn as_nanos(self) -> u64 {
        self.nanos
    }

    /// Seconds since the clock's origin.
    pub fn as_secs_f64(self) -> f64 {
        self.nanos as f64 * 1e-9
    }

    /// Signed seconds from `earlier` to `self`.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (i128::from(self.nanos) - i128::from(earlier.nanos)) as f64 * 1e-9
    }

    /// Time from `earlier` to `self`, zero if `earlier` is later.
    pub fn saturating_since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.nanos.saturating_sub(earlier.nanos))
    }
}

impl Add<Duration> for MonotonicTime {
    type Output = Self;
    fn add(self, step: Duration) -> Self {
        let nanos = u64::try_from(step.as_nanos()).unwrap_or(u64::MAX);
        Self { nanos: self.nanos.saturating_add(nanos) }
    }
}

impl Sub<Duration> for MonotonicTime {
    type Output = Self;
    fn sub(self, step: Duration) -> Self {
        let nanos = u64::try_from(step.as_nanos()).unwrap_or(u64::MAX);
        Self { nanos: self.nanos.saturating_sub(nanos) }
    }
}
