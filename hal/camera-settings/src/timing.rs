//! When an image was exposed, from the stamp of its buffer.

use std::time::Duration;

/// What the stamp of a buffer means (`V4L2_BUF_FLAG_TIMESTAMP_*`, `V4L2_BUF_FLAG_TSTAMP_SRC_*`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampSource {
    /// `CLOCK_MONOTONIC` when the last pixel of the image had been received.
    EndOfFrame,
    /// `CLOCK_MONOTONIC` when the exposure began.
    StartOfExposure,
    /// Any other clock, or one that the driver does not tell of.
    Unknown,
}

/// What is known of a camera besides its stamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StampModel {
    /// From the end of the exposure until the last pixel has been received, for drivers that stamp the end of a frame.
    pub readout: Duration,
    /// By how much a stamp is later than what it stands for: of a driver that stamps when the first data arrive, say.
    pub delay: Duration,
}

impl StampModel {
    /// The middle of the exposure on the clock of the stamp, nanoseconds; `None` if it is not known what the stamp means.
    ///
    /// Kernel documentation, "Buffers", `V4L2_BUF_FLAG_TSTAMP_SRC_*`: a stamp is the begin of the exposure, or the moment at which the last
    /// pixel of the frame has been received.
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

/// A duration as a signed number; those of 292 years and more are all the same.
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
