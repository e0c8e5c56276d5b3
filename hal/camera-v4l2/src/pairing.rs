//! Pairing of left and right images, and the drift between the two cameras.

use pb3dp_camera_settings::nanos;
use std::time::Duration;

/// Decision about the newest image of each side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// They belong together.
    Pair,
    /// A later left image fits the right one better.
    LeftIsOld,
    /// A later right image fits the left one better.
    RightIsOld,
    /// No other image would match better, but these are too far apart.
    TooFar,
}

/// Compares two images by the middles of their exposures.
///
/// Later images arrive one `period` after another. If the older one is more than half a period behind, its successor is nearer to
/// the other image; otherwise no nearer image follows.
pub fn judge(left_nanos: i64, right_nanos: i64, period: Duration, skew_max: Duration) -> Verdict {
    let skew = right_nanos.saturating_sub(left_nanos);
    if skew.saturating_abs() <= nanos(skew_max) {
        Verdict::Pair
    } else if skew.saturating_abs() <= nanos(period) / 2 {
        Verdict::TooFar
    } else if skew > 0 {
        Verdict::LeftIsOld
    } else {
        Verdict::RightIsOld
    }
}

/// Number of pairs used for the drift estimate: 17 s at 30 per second.
const WINDOW: usize = 512;

/// Minimum number of pairs.
const WINDOW_MIN: usize = 60;

/// Drift between the two cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Present skew (right minus left exposure) from the fitted line, seconds; between minus and plus half a period.
    pub skew_s: f64,
    /// Change of the skew, seconds per second; zero for synchronised cameras.
    pub rate: f64,
    /// Scatter of the skew about the line (rms), seconds.
    pub scatter_s: f64,
}

impl Drift {
    /// Seconds until the skew exceeds a limit in either direction; zero if it exceeds it now, `None` if it never will.
    pub fn seconds_until(&self, skew_max: Duration) -> Option<f64> {
        let limit = skew_max.as_secs_f64();
        if self.skew_s.abs() > limit {
            return Some(0.0);
        }
        let way = if self.rate > 0.0 { limit - self.skew_s } else { limit + self.skew_s };
        Some(way / self.rate.abs()).filter(|seconds| seconds.is_finite())
    }
}

/// Fits a straight line to the skew of the last pairs. The skew of free-running cameras repeats after a period; it is unwrapped.
#[derive(Clone, Debug)]
pub struct DriftEstimator {
    period_s: f64,
    /// Times and unwrapped skews, seconds, relative to the first.
    samples: [(f64, f64); WINDOW],
    count: usize,
    first_nanos: i64,
    last_unwrapped_s: f64,
}

impl DriftEstimator {
    /// An estimator for images with this period.
    pub fn new(period: Duration) -> Self {
        let period_s = period.as_secs_f64();
        Self { period_s, samples: [(0.0, 0.0); WINDOW], count: 0, first_nanos: 0, last_unwrapped_s: 0.0 }
    }

    /// Adds a pair, delivered or refused.
    pub fn add(&mut self, left_nanos: i64, skew_nanos: i64) {
        let skew_s = skew_nanos as f64 * 1e-9;
        if self.count == 0 {
            self.first_nanos = left_nanos;
            self.last_unwrapped_s = skew_s;
        }
        let periods = ((self.last_unwrapped_s - skew_s) / self.period_s).round();
        let unwrapped_s = skew_s + periods * self.period_s;
        let at_s = left_nanos.saturating_sub(self.first_nanos) as f64 * 1e-9;
        self.samples[self.count % WINDOW] = (at_s, unwrapped_s);
        self.count += 1;
        self.last_unwrapped_s = unwrapped_s;
    }

    /// The line through the last pairs; `None` before there are enough.
    pub fn drift(&self) -> Option<Drift> {
        let samples = &self.samples[..self.count.min(WINDOW)];
        if samples.len() < WINDOW_MIN {
            return None;
        }
        let n = samples.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| samples.iter().map(of).sum::<f64>() / n;
        let (at, skew) = (mean(|sample| sample.0), mean(|sample| sample.1));
        let sum = |of: &dyn Fn(f64, f64) -> f64| samples.iter().map(|(t, s)| of(t - at, s - skew)).sum::<f64>();
        let spread = sum(&|t, _| t * t);
        if spread <= 0.0 {
            return None;
        }
        let rate = sum(&|t, s| t * s) / spread;
        let scatter_s = (sum(&|t, s| (s - rate * t).powi(2)) / n).sqrt();
        let (last_s, _) = samples[(self.count - 1) % WINDOW];
        let now_s = skew + rate * (last_s - at);
        let skew_s = now_s - (now_s / self.period_s).round() * self.period_s;
        Some(Drift { skew_s, rate, scatter_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_nanos(33_333_333);
    const LIMIT: Duration = Duration::from_millis(5);

    #[test]
    fn the_older_image_waits_for_its_better_partner_and_no_longer() {
        let verdict = |skew_millis: i64| judge(1_000_000_000, 1_000_000_000 + skew_millis * 1_000_000, PERIOD, LIMIT);
        for (skew_millis, expected) in [
            (0, Verdict::Pair),
            (5, Verdict::Pair),
            (-5, Verdict::Pair),
            (6, Verdict::TooFar),
            (-16, Verdict::TooFar),
            (17, Verdict::LeftIsOld),
            (-28, Verdict::RightIsOld),
            (400, Verdict::LeftIsOld),
        ] {
            assert_eq!(verdict(skew_millis), expected, "{skew_millis} ms");
        }
        assert_eq!(judge(i64::MIN, i64::MAX, PERIOD, LIMIT), Verdict::LeftIsOld);
    }

    #[test]
    fn a_drift_is_found_though_the_skew_comes_back_after_a_period() {
        let mut estimator = DriftEstimator::new(PERIOD);
        assert_eq!(estimator.drift(), None);
        let period = PERIOD.as_nanos() as i64;
        // 200 parts per million: 6.7 microseconds per pair, starting at 15 ms; beyond half a period the skew becomes negative.
        for k in 0..700 {
            let skew = 15_000_000 + k * period / 5000 + if k % 2 == 0 { 40_000 } else { -40_000 };
            let wrapped = if skew > period / 2 { skew - period } else { skew };
            estimator.add(500_000_000 + k * period, wrapped);
        }
        let drift = estimator.drift().unwrap();
        assert!((drift.rate - 2e-4).abs() < 2e-6, "{drift:?}");
        assert!((drift.scatter_s - 40e-6).abs() < 2e-6, "{drift:?}");
        let expected = 0.015 + 699.0 * 33.333_333e-3 * 2e-4 - 33.333_333e-3;
        assert!((drift.skew_s - expected).abs() < 2e-5, "{drift:?}, expected {expected}");
        assert_eq!(drift.seconds_until(LIMIT), Some(0.0));
    }

    #[test]
    fn the_time_until_a_limit_depends_on_the_direction() {
        let seconds = |skew_s, rate| Drift { skew_s, rate, scatter_s: 0.0 }.seconds_until(LIMIT);
        assert!((seconds(0.001, 1e-4).unwrap() - 40.0).abs() < 1e-6);
        assert!((seconds(0.001, -1e-4).unwrap() - 60.0).abs() < 1e-6);
        assert_eq!(seconds(0.001, 0.0), None);
    }
}
