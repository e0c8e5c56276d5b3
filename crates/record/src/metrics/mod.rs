//! Error measures: statistics of samples, planes against the ground truth of cases, motions against the ground truth of
//! sequences, and the response of one time series to another.
//!
//! Percentiles interpolate linearly between order statistics (position `p (n - 1)` among the sorted samples, the default of
//! NumPy), so that figures agree with tables made with the usual Python tools.

pub mod motion;
pub mod plane;
pub mod response;
pub mod series;
pub mod table;

pub use motion::{MotionErrors, MotionSummary, compare_motion};
pub use plane::{DisparityAgreement, EvaluatedCase, Group, PlaneError, PlaneEstimate, compare_plane};
pub use response::{SineResponse, overshoot, settled_from, sine_response};
pub use series::{Lag, lag_by_cross_correlation};
pub use table::{GroupSummary, summarize};

/// Summary of a sample of errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Number of samples.
    pub count: usize,
    /// Median.
    pub median: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Root of the mean square.
    pub rms: f64,
    /// Largest value.
    pub max: f64,
}

impl Statistics {
    /// Statistics of a sample, in its unit; use absolute values for signed errors. `None` if the sample is empty or contains NaN.
    pub fn of(samples: &[f64]) -> Option<Self> {
        let sorted = sorted(samples)?;
        Some(Self {
            count: sorted.len(),
            median: at_share(&sorted, 0.5),
            p90: at_share(&sorted, 0.9),
            p95: at_share(&sorted, 0.95),
            rms: rms(samples)?,
            max: *sorted.last()?,
        })
    }
}

/// The percentile of a sample, `percent` from 0 to 100 (clamped), by linear interpolation between order statistics. `None` if the
/// sample is empty or contains NaN.
pub fn percentile(samples: &[f64], percent: f64) -> Option<f64> {
    Some(at_share(&sorted(samples)?, (percent / 100.0).clamp(0.0, 1.0)))
}

/// The median of a sample; `None` as [`percentile`].
pub fn median(samples: &[f64]) -> Option<f64> {
    percentile(samples, 50.0)
}

/// Root of the mean square; `None` if the sample is empty.
pub fn rms(samples: &[f64]) -> Option<f64> {
    let mean_square = samples.iter().map(|x| x * x).sum::<f64>() / samples.len() as f64;
    (!samples.is_empty()).then(|| mean_square.sqrt())
}

/// Largest absolute value; `None` if the sample is empty.
pub fn max_abs(samples: &[f64]) -> Option<f64> {
    samples.iter().map(|x| x.abs()).reduce(f64::max)
}

fn sorted(samples: &[f64]) -> Option<Vec<f64>> {
    if samples.is_empty() || samples.iter().any(|x| x.is_nan()) {
        return None;
    }
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    Some(sorted)
}

fn at_share(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(found: Option<f64>, expected: f64) {
        let found = found.unwrap();
        assert!((found - expected).abs() < 1e-12, "{found} is not {expected}");
    }

    #[test]
    fn percentiles_agree_with_numpy() {
        // numpy.percentile([3.2, 0.1, 7.5, 1.4, 2.2, 9.9, 0.4], [50, 90, 95, 25]) = [2.2, 8.46, 9.18, 0.9]
        let samples = [3.2, 0.1, 7.5, 1.4, 2.2, 9.9, 0.4];
        check(median(&samples), 2.2);
        check(percentile(&samples, 90.0), 8.46);
        check(percentile(&samples, 95.0), 9.18);
        check(percentile(&samples, 25.0), 0.9);
        check(percentile(&samples, 0.0), 0.1);
        check(percentile(&samples, 100.0), 9.9);
        check(median(&[4.0, 1.0]), 2.5);
        check(median(&[4.0]), 4.0);
    }

    #[test]
    fn statistics_hold_rms_and_max() {
        // sqrt((9 + 16 + 144) / 3) = sqrt(169 / 3)
        let s = Statistics::of(&[3.0, 4.0, 12.0]).unwrap();
        check(Some(s.rms), (169.0_f64 / 3.0).sqrt());
        assert_eq!((s.count, s.max, s.median), (3, 12.0, 4.0));
        check(max_abs(&[1.0, -5.0, 3.0]), 5.0);
    }

    #[test]
    fn empty_and_undefined_samples_have_none() {
        assert_eq!((median(&[]), rms(&[]), max_abs(&[])), (None, None, None));
        assert_eq!(Statistics::of(&[1.0, f64::NAN]), None);
    }
}
