//! Exposure schedule of simulated cameras.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock};

use crate::SimCameraConfig;

/// Exposures at fixed times: `k` begins `k` periods after the first.
pub(crate) struct ExposureSchedule {
    clock: Arc<dyn Clock>,
    start: MonotonicTime,
    period: Duration,
    exposure: Duration,
    next_sequence: u64,
}

impl ExposureSchedule {
    /// The first exposure begins now.
    pub(crate) fn from_now(clock: Arc<dyn Clock>, config: &SimCameraConfig) -> Self {
        Self { start: clock.now(), clock, period: config.period, exposure: config.exposure, next_sequence: 0 }
    }

    /// Waits for the end of the newest exposure that was not yet delivered; returns its number and start time. The exposure is
    /// not offered again, whatever the caller does with it.
    ///
    /// # Errors
    /// `Timeout` if it ends later than `timeout` from now.
    pub(crate) fn wait_for_next(&mut self, name: &str, timeout: Duration) -> Result<(u64, MonotonicTime), CameraError> {
        let now = self.clock.now();
        let sequence = self.due_sequence(now);
        let start = self.exposure_start(sequence);
        let ready = start + self.exposure;
        if ready > now + timeout {
            self.clock.sleep_until(now + timeout);
            let message = format!("{name}: no pair within {timeout:?}; the next one is due later");
            return Err(CameraError::new(CameraErrorKind::Timeout, message));
        }
        self.clock.sleep_until(ready);
        self.next_sequence = sequence.saturating_add(1);
        Ok((sequence, start))
    }

    /// Start time of an exposure.
    fn exposure_start(&self, sequence: u64) -> MonotonicTime {
        let nanos = self.period.as_nanos().saturating_mul(u128::from(sequence));
        self.start + Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
    }

    /// The newest exposure that is complete at `now`, or the next one that was not yet delivered.
    fn due_sequence(&self, now: MonotonicTime) -> u64 {
        let since_first_end = now.saturating_since(self.start + self.exposure);
        let complete = since_first_end.as_nanos() / self.period.as_nanos();
        self.next_sequence.max(u64::try_from(complete).unwrap_or(u64::MAX))
    }
}
