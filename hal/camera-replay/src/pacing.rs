//! Delivery timing of a replay.

use std::fmt;
use std::sync::Arc;

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
}

impl fmt::Debug for Pacing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unpaced => "Unpaced",
            Self::Original(_) => "Original",
            Self::Live(_) => "Live",
        })
    }
}
