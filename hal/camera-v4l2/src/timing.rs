//! Exposure time of an image, computed from the buffer timestamp.

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use crate::video::VideoSystem;

/// Number of clock comparisons; the closest one counts.
const COMPARISONS: usize = 8;

/// Map from the timestamp clock to the program clock; both are the same clock with different origins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ClockMap {
    program_less_stamps: i64,
}

impl ClockMap {
    /// Compares the two clocks.
    pub(crate) fn measure(system: &dyn VideoSystem, clock: &dyn Clock) -> Self {
        let comparison = |_| {
            let before = clock.now().as_nanos() as i64;
            let stamp = system.monotonic_nanos();
            let after = clock.now().as_nanos() as i64;
            (after - before, before + (after - before) / 2 - stamp)
        };
        let best = (0..COMPARISONS).map(comparison).min_by_key(|(took, _)| *took);
        Self { program_less_stamps: best.map_or(0, |(_, offset)| offset) }
    }

    /// `None` for a time before the program's origin.
    pub(crate) fn program_time(self, stamp_nanos: i64) -> Option<MonotonicTime> {
        let nanos = stamp_nanos.checked_add(self.program_less_stamps)?;
        u64::try_from(nanos).ok().map(MonotonicTime::from_nanos)
    }
}
