//! Comparison of two time series, for the report of a run.

use super::{max_abs, rms};

/// Delay of a response behind its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// Lag, seconds; positive if the response is delayed.
    pub lag_s: f64,
    /// Correlation coefficient at that lag, -1 to 1.
    pub correlation: f64,
}

/// The lag of `response` behind `reference` by cross-correlation: the shift, within plus and minus `max_lag_s`, at which
/// the correlation coefficient of the overlapping parts is largest, refined below one sample by a parabola.
///
/// Both series are sampled every `period_s`, at the same times. `None` if the lengths differ, if the series are shorter than
/// twice the shift, or if they do not vary (there is no lag to find). A lag at the end of the range is returned unchanged; use a
/// wider range.
pub fn lag_by_cross_correlation(reference: &[f64], response: &[f64], period_s: f64, max_lag_s: f64) -> Option<Lag> {
    let usable = period_s > 0.0 && max_lag_s >= 0.0 && reference.len() == response.len();
    let reach = if usable { (max_lag_s / period_s).round() as usize } else { return None };
    if reference.len() < 3 || reference.len() < 2 * reach {
        return None;
    }
    let reach = reach as isize;
    let at = |shift: isize| correlation_at(reference, response, shift);
    let mut best: Option<(isize, f64)> = None;
    for shift in -reach..=reach {
        if let Some(found) = at(shift)
            && best.is_none_or(|(_, value)| found > value)
        {
            best = Some((shift, found));
        }
    }
    let (shift, correlation) = best?;
    let inside = shift > -reach && shift < reach;
    let vertex = if inside { parabola_vertex(at(shift - 1)?, correlation, at(shift + 1)?) } else { 0.0 };
    Some(Lag { lag_s: (shift as f64 + vertex) * period_s, correlation })
}

/// Correlation coefficient of `reference[i]` with `response[i + shift]` over the overlap.
fn correlation_at(reference: &[f64], response: &[f64], shift: isize) -> Option<f64> {
    let cut = shift.unsigned_abs();
    let overlap = reference.len() - cut;
    let (a, b) = match shift >= 0 {
        true => (&reference[..overlap], &response[cut..]),
        false => (&reference[cut..], &response[..overlap]),
    };
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        let (x, y) = (x - mean_a, y - mean_b);
        aa += x * x;
        bb += y * y;
        ab += x * y;
    }
    (aa > 0.0 && bb > 0.0).then(|| ab / (aa * bb).sqrt())
}

/// Position of the extremum of the parabola through (-1, a), (0, b), (1, c), within half a step.
fn parabola_vertex(a: f64, b: f64, c: f64) -> f64 {
    let curvature = a - 2.0 * b + c;
    if curvature.abs() < 1e-15 { 0.0 } else { (0.5 * (a - c) / curvature).clamp(-0.5, 0.5) }
}

/// Root mean square and largest absolute difference of two series, in their unit; `None` if they differ in length or are
/// empty.
pub fn difference(reference: &[f64], response: &[f64]) -> Option<(f64, f64)> {
    if reference.len() != response.len() {
        return None;
    }
    let differences: Vec<_> = reference.iter().zip(response).map(|(a, b)| b - a).collect();
    Some((rms(&differences)?, max_abs(&differences)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth move of 2 s from 0 to 0.1 and back, starting at `start_s`, with different profiles for the two directions.
    fn moved(at_s: f64, start_s: f64) -> f64 {
        let step = |s: f64| {
            let s = s.clamp(0.0, 1.0);
            s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        };
        0.1 * (step((at_s - start_s) / 2.0) - 0.8 * step((at_s - start_s - 5.0) / 3.0))
    }

    #[test]
    fn a_delay_of_a_fraction_of_a_sample_is_found() {
        let period_s = 1.0 / 30.0;
        for delay_s in [0.0, 0.2134, -0.1, 0.05] {
            let sample = |start_s: f64| (0..400).map(|i| moved(i as f64 * period_s, start_s)).collect::<Vec<_>>();
            let (reference, response) = (sample(2.0), sample(2.0 + delay_s));
            let lag = lag_by_cross_correlation(&reference, &response, period_s, 1.0).unwrap();
            assert!((lag.lag_s - delay_s).abs() < 0.002, "{} is not {delay_s}", lag.lag_s);
            assert!(lag.correlation > 0.9999);
        }
    }

    #[test]
    fn offset_and_scale_do_not_matter_but_constants_have_no_lag() {
        let reference: Vec<_> = (0..100).map(|i| (f64::from(i) * 0.1).sin()).collect();
        let response: Vec<_> = (0..100).map(|i| 7.0 + 3.0 * ((f64::from(i) - 4.0) * 0.1).sin()).collect();
        let lag = lag_by_cross_correlation(&reference, &response, 0.01, 0.2).unwrap();
        assert!((lag.lag_s - 0.04).abs() < 1e-3, "{lag:?}");
        assert_eq!(lag_by_cross_correlation(&reference, &[1.0; 100], 0.01, 0.2), None);
        assert_eq!(lag_by_cross_correlation(&reference, &response[1..], 0.01, 0.2), None);
        assert_eq!(lag_by_cross_correlation(&reference, &response, 0.0, 0.2), None);
    }

    #[test]
    fn difference_has_rms_and_max() {
        let (rms, max) = difference(&[1.0, 2.0, 3.0], &[1.0, 5.0, -1.0]).unwrap();
        assert!((rms - (25.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(max, 4.0);
        assert_eq!(difference(&[1.0], &[]), None);
    }
}
