//! Delivery timing of a replay.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use pb3dp_hal_api::Clock;

/// Delivery timing.
#[derive(Clone, Default)]
pub enum Pacing {
    /// At once, whenever a pair is requested; `exposed_at` is the time of the recording.
    #[default]
    Unpaced,
    /// At the recorded intervals on this clock, beginning with the first call; `exposed_at` is the time on this clock. A caller
    /// that is too slow gets every pair late; none is dropped.
    Original(Arc<dyn Clock>),
    /// As `Original`, but like a real camera: of the pairs that are due, a caller that is too slow gets the newest, and the sequence
    /// numbers skip the others.
    Live(Arc<dyn Clock>),
    /// One pair for each step released through a clone of this stepper; `exposed_at` is the time of the recording. A call without
    /// a step waits in real time until its timeout.
    Stepped(Stepper),
}

impl fmt::Debug for Pacing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unpaced => "Unpaced",
            Self::Original(_) => "Original",
            Self::Live(_) => "Live",
            Self::Stepped(_) => "Stepped",
        })
    }
}

/// Releases the pairs of a replay one by one. Clones are handles of the same replay.
#[derive(Clone, Debug, Default)]
pub struct Stepper {
    shared: Arc<Steps>,
}

#[derive(Debug, Default)]
struct Steps {
    open: Mutex<u64>,
    more: Condvar,
}

impl Stepper {
    /// A stepper without released steps.
    pub fn new() -> Self {
        Self::default()
    }

    /// Releases one more pair; a damaged pair counts.
    pub fn step(&self) {
        let mut open = self.shared.open.lock().unwrap_or_else(PoisonError::into_inner);
        *open = open.saturating_add(1);
        self.shared.more.notify_one();
    }

    /// Consumes a step, waiting for one up to `timeout`; returns whether there was one.
    pub(crate) fn take(&self, timeout: Duration) -> bool {
        let open = self.shared.open.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.shared.more.wait_timeout_while(open, timeout, |open| *open == 0);
        let (mut open, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let taken = *open > 0;
        *open = open.saturating_sub(1);
        taken
    }
}
