//! Statistics of the times of repeated calls.

use pb3dp_record::metrics::percentile;
use serde_json::{Value, json};

use pb3dp_hal_platform::cpu_time::timed;

/// CPU times of one thread, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    /// Number of calls.
    pub count: usize,
    /// Minimum.
    pub min_ms: f64,
    /// Median.
    pub median_ms: f64,
    /// 90th percentile.
    pub p90_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
    /// Maximum.
    pub max_ms: f64,
}

impl Times {
    /// Statistics of some times; `None` if there are none.
    pub fn of(samples_ms: &[f64]) -> Option<Self> {
        let at = |percent| percentile(samples_ms, percent);
        Some(Self {
            count: samples_ms.len(),
            min_ms: at(0.0)?,
            median_ms: at(50.0)?,
            p90_ms: at(90.0)?,
            p99_ms: at(99.0)?,
            max_ms: at(100.0)?,
        })
    }

    /// As saved.
    pub fn to_json(self) -> Value {
        json!({
            "count": self.count,
            "min_ms": self.min_ms,
            "median_ms": self.median_ms,
            "p90_ms": self.p90_ms,
            "p99_ms": self.p99_ms,
            "max_ms": self.max_ms,
        })
    }
}

/// Warm-up calls, which do not count: buffers grow, and caches fill.
const WARM_UP: usize = 5;

/// Times of `rounds` calls after the warm-up.
///
/// # Errors
/// Errors of the calls.
pub fn repeat(rounds: usize, mut work: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<Times> {
    let mut samples = Vec::with_capacity(rounds.max(1));
    for round in 0..WARM_UP + rounds.max(1) {
        let (outcome, ms) = timed(&mut work);
        outcome?;
        if round >= WARM_UP {
            samples.push(ms);
        }
    }
    Times::of(&samples).ok_or_else(|| anyhow::anyhow!("a measured time is NaN"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summaries_are_order_statistics() {
        let times = Times::of(&[3.0, 1.0, 2.0, 11.0, 4.0]).expect("not empty");
        // NumPy: percentile([3, 1, 2, 11, 4], [90, 99]) = [8.2, 10.72].
        assert_eq!((times.count, times.min_ms, times.median_ms, times.max_ms), (5, 1.0, 3.0, 11.0));
        assert!((times.p90_ms - 8.2).abs() < 1e-12 && (times.p99_ms - 10.72).abs() < 1e-12);
        assert_eq!(Times::of(&[]), None);
    }

    #[test]
    fn the_first_calls_do_not_count_and_errors_are_passed_on() {
        let mut calls = 0;
        let times = repeat(7, || {
            calls += 1;
            Ok(())
        });
        assert_eq!((times.expect("no error").count, calls), (7, 7 + WARM_UP));
        let error = repeat(3, || anyhow::bail!("no pair")).expect_err("passed on");
        assert_eq!(error.to_string(), "no pair");
    }
}
