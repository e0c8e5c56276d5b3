//! How many of the last exchanges or samples failed: failures that are never consecutive count as well.

/// Number of exchanges or samples that are looked back at: one second of a host at 100 Hz.
const WINDOW: u32 = 100;

/// The outcomes of the last 100 exchanges or samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecentFailures {
    /// One bit for each, the newest in the lowest; 1 is a failure.
    failed: u128,
}

impl RecentFailures {
    /// The number of outcomes that are kept.
    pub const WINDOW: u32 = WINDOW;

    /// Adds the newest outcome; returns how many of the last 100 failed.
    pub fn push(&mut self, has_failed: bool) -> u32 {
        const KEPT: u128 = (1 << WINDOW) - 1;
        self.failed = ((self.failed << 1) | u128::from(has_failed)) & KEPT;
        self.count()
    }

    /// How many of the last 100 failed.
    pub fn count(&self) -> u32 {
        self.failed.count_ones()
    }

    /// Forgets all outcomes.
    pub fn clear(&mut self) {
        self.failed = 0;
    }
}
