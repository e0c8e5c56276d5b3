//! How a response follows a reference: gain and phase of sinusoids, settling after a step.

use nalgebra::{Matrix3, Vector3};

/// Gain and phase of a response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SineResponse {
    /// Amplitude of the response divided by that of the reference.
    pub gain: f64,
    /// Phase of the response minus that of the reference, radians, -pi to pi: negative if the response is delayed.
    pub phase_rad: f64,
}

impl SineResponse {
    /// The gain in decibels.
    pub fn gain_db(&self) -> f64 {
        20.0 * self.gain.log10()
    }
}

/// Gain and phase of `response` against `reference`, both sampled every `period_s`, at the frequency of one turn in `turn_s`
/// seconds: a sinusoid of that frequency and a constant are fitted to each by least squares.
///
/// `None` if the lengths differ, if the series are shorter than half a turn, or if the reference has no component at the
/// frequency.
pub fn sine_response(reference: &[f64], response: &[f64], period_s: f64, turn_s: f64) -> Option<SineResponse> {
    let covers_half_a_turn = period_s > 0.0 && turn_s > 0.0 && reference.len() as f64 * period_s >= 0.5 * turn_s;
    if reference.len() != response.len() || !covers_half_a_turn {
        return None;
    }
    let omega = std::f64::consts::TAU * period_s / turn_s;
    let ([a_sin, a_cos], [b_sin, b_cos]) = (sine_fit(reference, omega)?, sine_fit(response, omega)?);
    let (a, b) = (a_sin.hypot(a_cos), b_sin.hypot(b_cos));
    // A sin(wt + p) has the components A cos p and A sin p; the phase of b / a as complex numbers.
    let phase_rad = (b_cos * a_sin - b_sin * a_cos).atan2(b_sin * a_sin + b_cos * a_cos);
    (a > 0.0).then(|| SineResponse { gain: b / a, phase_rad })
}

/// Sine and cosine components at `omega` times the index, with a constant.
fn sine_fit(series: &[f64], omega: f64) -> Option<[f64; 2]> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (index, value) in series.iter().enumerate() {
        let (sin, cos) = (omega * index as f64).sin_cos();
        let row = Vector3::new(sin, cos, 1.0);
        normal += row * row.transpose();
        right += row * *value;
    }
    let parts = normal.cholesky()?.solve(&right);
    Some([parts.x, parts.y])
}

/// Settling: index of the first sample from which on all errors stay within their bounds. `None` if the last sample is outside.
///
/// Each series has one absolute error per sample, and its bound.
pub fn settled_from(series: &[(&[f64], f64)]) -> Option<usize> {
    let length = series.iter().map(|(errors, _)| errors.len()).min().filter(|length| *length > 0)?;
    let is_outside =
        |index: &usize| series.iter().any(|(errors, bound)| !(0.0..=*bound).contains(&errors[*index].abs()));
    let last_outside = (0..length).rev().find(is_outside);
    match last_outside {
        None => Some(0),
        Some(index) if index + 1 == length => None,
        Some(index) => Some(index + 1),
    }
}

/// Overshoot of a response, as a share of the step from `from` to `to`; 0 if there is none.
pub fn overshoot(response: &[f64], from: f64, to: f64) -> f64 {
    let share_beyond = |value: &f64| (value - to) / (to - from);
    response.iter().map(share_beyond).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_and_phase_are_those_that_were_put_in() {
        // Neither a whole number of turns nor of samples per turn, with offsets, and a first-order lag of 0.12 s in closed form.
        let (period_s, turn_s, lag_s) = (0.01, 2.345, 0.12);
        let omega = std::f64::consts::TAU / turn_s;
        let (gain, phase) = (1.0 / (1.0 + (omega * lag_s).powi(2)).sqrt(), -(omega * lag_s).atan());
        let series = |amplitude: f64, phase: f64, offset: f64| -> Vec<f64> {
            (0..777).map(|i| offset + amplitude * (omega * f64::from(i) * period_s + 0.7 + phase).sin()).collect()
        };
        let found =
            sine_response(&series(100.0, 0.0, 3.0), &series(100.0 * gain, phase, -40.0), period_s, turn_s).unwrap();
        assert!((found.gain - gain).abs() < 1e-9 && (found.phase_rad - phase).abs() < 1e-9, "{found:?}");
        assert!((found.gain_db() - 20.0 * gain.log10()).abs() < 1e-7);
        let ahead = sine_response(&series(1.0, 0.0, 0.0), &series(2.0, 0.4, 0.0), period_s, turn_s).unwrap();
        assert!((ahead.gain - 2.0).abs() < 1e-9 && (ahead.phase_rad - 0.4).abs() < 1e-9, "{ahead:?}");
    }

    #[test]
    fn what_can_not_be_fitted_has_no_response() {
        let series = [1.0, 2.0, 3.0, 2.0, 1.0, 0.5];
        assert_eq!(sine_response(&series, &series[1..], 0.1, 0.6), None);
        assert_eq!(sine_response(&series, &series, 0.1, 2.0), None, "less than half a turn");
        assert_eq!(sine_response(&series, &series, 0.0, 0.6), None);
    }

    #[test]
    fn a_response_has_settled_when_it_stays_inside() {
        let position = [50.0, 20.0, 0.9, 1.1, 0.8, 0.2];
        let angle = [15.0, 0.2, 0.2, 0.1, 0.4, 0.3];
        assert_eq!(settled_from(&[(&position, 1.0)]), Some(4));
        assert_eq!(settled_from(&[(&position, 1.0), (&angle, 0.3)]), Some(5));
        assert_eq!(settled_from(&[(&position, 0.1)]), None);
        assert_eq!(settled_from(&[(&position, 60.0)]), Some(0));
        assert_eq!(settled_from(&[(&[f64::NAN], 60.0)]), None);
        assert_eq!(settled_from(&[]), None);
    }

    #[test]
    fn overshoot_counts_in_the_direction_of_the_step() {
        assert!((overshoot(&[0.0, 30.0, 52.5, 49.0], 0.0, 50.0) - 0.05).abs() < 1e-12);
        assert!((overshoot(&[10.0, -6.0, -4.0], 10.0, -5.0) - 1.0 / 15.0).abs() < 1e-12);
        assert_eq!(overshoot(&[0.0, 30.0, 49.0], 0.0, 50.0), 0.0);
    }
}
