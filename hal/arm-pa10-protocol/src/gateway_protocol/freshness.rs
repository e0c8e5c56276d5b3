//! How late frames are, although the clocks of the two sides have nothing in common.

use std::time::Duration;

/// A bucket lasts this long, µs: clocks that differ by 100 ppm drift apart by 1 ms within two of them.
const BUCKET_US: u64 = 5_000_000;

/// Measures how much longer a frame was under way than the quickest one of late.
///
/// The difference between the receiver's and the sender's clock is unknown, but constant for seconds: the smallest difference
/// between arrival and timestamp in the present and the last bucket of 5 s belongs to the quickest frame. What a frame exceeds it
/// by is delay: frames that waited in a buffer show. All times in µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DelayMeter {
    bucket_start_us: Option<u64>,
    present_min_us: Option<i128>,
    last_min_us: Option<i128>,
}

impl DelayMeter {
    /// The delay of a frame beyond that of the quickest one.
    pub fn handle(&mut self, sent_us: u64, arrived_us: u64) -> Duration {
        let start = *self.bucket_start_us.get_or_insert(arrived_us);
        let elapsed = arrived_us.saturating_sub(start);
        if elapsed >= BUCKET_US {
            // After a long silence both buckets are old.
            self.last_min_us = if elapsed < 2 * BUCKET_US { self.present_min_us } else { None };
            self.present_min_us = None;
            self.bucket_start_us = Some(arrived_us);
        }
        let difference = i128::from(arrived_us) - i128::from(sent_us);
        let present = self.present_min_us.map_or(difference, |least| least.min(difference));
        self.present_min_us = Some(present);
        let quickest = self.last_min_us.map_or(present, |least| least.min(present));
        Duration::from_micros(u64::try_from(difference - quickest).unwrap_or(u64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_that_waited_shows_whatever_the_clocks_say() {
        for offset_us in [0u64, 7_000_000_000, 1 << 60] {
            let mut meter = DelayMeter::default();
            for frame in 0..300 {
                let sent = 1_000_000 + 10_000 * frame;
                let waited = if frame == 200 { 35_000 } else { 400 + frame % 3 * 10 };
                let delay = meter.handle(sent, sent + offset_us + waited);
                if frame == 200 {
                    assert_eq!(delay, Duration::from_micros(34_600));
                } else {
                    assert!(delay <= Duration::from_micros(20), "{frame}: {delay:?}");
                }
            }
        }
    }

    #[test]
    fn clocks_may_drift_for_hours() {
        for ppm in [-100i64, 100] {
            let mut meter = DelayMeter::default();
            for frame in 0..360_000i64 {
                let sent = 10_000 * frame;
                let arrived = 50_000_000_000 + sent + sent * ppm / 1_000_000;
                let delay = meter.handle(sent as u64, arrived as u64);
                assert!(delay <= Duration::from_millis(2), "{frame}: {delay:?}");
            }
        }
    }

    #[test]
    fn after_a_long_silence_it_starts_anew() {
        let mut meter = DelayMeter::default();
        meter.handle(0, 100);
        assert_eq!(meter.handle(1_000_000, 21_000_000), Duration::ZERO);
    }
}
