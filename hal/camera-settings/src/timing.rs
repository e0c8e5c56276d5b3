//! Exposure time of an image, computed from the buffer timestamp.

use std::time::Duration;

/// The meaning of a buffer timestamp (`V4L2_BUF_FLAG_TIMESTAMP_*`, `V4L2_BUF_FLAG_TSTAMP_SRC_*`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampSource {
    /// `CLOCK_MONOTONIC` when the last pixel of the image had been received.
    EndOfFrame,
    /// `CLOCK_MONOTONIC` when the exposure began.
    StartOfExposure,
    /// Any other clock, or unknown.
    Unknown,
}

/// Timing properties of a camera in addition to its timestamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StampModel {
    /// Time from the end of the exposure until the last pixel was received, for drivers that stamp the end of a frame.
    pub readout: Duration,
    /// Delay of a timestamp relative to the event it stands for, for example for a driver that stamps the arrival of the first
    /// data.
    pub delay: Duration,
}

impl StampModel {
    /// The middle of the exposure on the clock of the timestamp, nanoseconds; `None` if the meaning of the timestamp is unknown.
    ///
    /// Kernel documentation, "Buffers", `V4L2_BUF_FLAG_TSTAMP_SRC_*`: a timestamp is the start of the exposure, or the time when
    /// the last pixel of the frame was received.
    pub fn mid_exposure_nanos(&self, stamp_nanos: i64, source: StampSource, exposure: Duration) -> Option<i64> {
        let half = nanos(exposure) / 2;
        let from_stamp = match source {
            StampSource::StartOfExposure => half,
            StampSource::EndOfFrame => -nanos(self.readout).saturating_add(half),
            StampSource::Unknown => return None,
        };
        Some(stamp_nanos.saturating_add(from_stamp).saturating_sub(nanos(self.delay)))
    }
}

/// A duration as a signed number; saturated at 292 years.
pub fn nanos(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_of_stamps_lead_to_the_middle_of_the_exposure() {
        let model = StampModel { readout: Duration::from_millis(16), delay: Duration::from_millis(3) };
        let exposure = Duration::from_millis(10);
        let at = |source| model.mid_exposure_nanos(100_000_000, source, exposure);
        // Exposed from 97 to 107 ms.
        assert_eq!(at(StampSource::StartOfExposure), Some(102_000_000));
        // Received until 97 ms, exposed until 81 ms.
        assert_eq!(at(StampSource::EndOfFrame), Some(76_000_000));
        assert_eq!(at(StampSource::Unknown), None);
    }
}
