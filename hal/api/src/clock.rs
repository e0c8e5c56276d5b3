//! The clock trait.

use pb3dp_geometry::MonotonicTime;

/// A monotonic clock.
///
/// # For backend authors
/// `now` never goes back and never blocks. `sleep_until` returns at or after `deadline` on this same clock, at once if it has
/// passed; a virtual clock advances itself to `deadline`. All timestamps of one program run come from one clock.
pub trait Clock: Send + Sync {
    /// The current time.
    fn now(&self) -> MonotonicTime;

    /// Blocks the calling thread until `deadline`.
    fn sleep_until(&self, deadline: MonotonicTime);
}
