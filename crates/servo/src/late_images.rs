//! Finds images that are older than their time stamps, before the loop that they close swings.
//!
//! An observation is placed in `base` with the joints at its time stamp. If the image is older by T, the motion of the hand within T appears
//! as a motion of the target, p(t) = target(t - T) + hand(t) - hand(t - T), and the hand follows itself. Placed with the joints of T
//! earlier, the target moves smoothly. So each observation is placed with several delays, and a smooth motion is fitted to the last places
//! of each. For each delay a one-sided cumulative sum (E. S. Page, Continuous inspection schemes, Biometrika 41, 1954) of the logarithm of
//! the ratio of both residuals grows while this delay explains the places better than the time stamp does.
//!
//! A target that starts, and that the hand follows, is also smoother with some delay for a moment: the motion of the hand cancels its
//! acceleration. A cubic motion explains such a start with any delay, so the sums of quadratic and of cubic residuals must both grow.

use nalgebra::Vector3;
use pb3dp_geometry::MonotonicTime;

/// Delays that are tried, seconds; the first one is what the time stamps state. Chosen: steps of less than a period of a camera at 30 Hz, up
/// to an age at which the pose is nearly stale anyway.
pub(crate) const DELAYS_S: [f64; 11] = [0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.175, 0.2, 0.225, 0.25];

/// Number of observations to which a motion is fitted: 0.23 s at 30 Hz, at which all constants here are chosen. A shorter time finds delays
/// later; over a longer one the acceleration of a healthy target changes more.
const WINDOW: usize = 8;
/// Degrees of the fitted motions.
const DEGREES: [usize; 2] = [2, 3];
/// Deviations from them that are no motion, metres: errors of calibration and of the joints' times. The noise of an observation is the same
/// with each delay.
const NOISE_M: [f64; 2] = [0.2e-3, 0.1e-3];
/// Most that one observation adds or takes.
const STEP_MAX: f64 = 1.5;
/// What each observation takes: a delay must explain the places much better, or its sum falls.
const DRIFT: f64 = 0.3;
/// Both sums must exceed these numbers. Fitted to the runs of tests/tests/late_images.rs, and to drawn hands like those of the tests below: of
/// 270 hands behind targets that start with up to 2.6 m/s^2, 8 exceed both, for at most 6 observations.
const EVIDENCE_MIN: [f64; 2] = [2.0, 0.9];
/// A later observation after such a gap begins anew, seconds: three periods of a camera at 30 Hz.
const GAP_MAX_S: f64 = 0.1;

/// What the last observations show with one delay.
type Evidence = [f64; DEGREES.len()];

/// The last observations, placed with each delay.
#[derive(Clone, Debug, Default)]
pub(crate) struct LateImages {
    times_s: [f64; WINDOW],
    places_m: [[Vector3<f64>; WINDOW]; DELAYS_S.len()],
    count: usize,
    evidence: [Evidence; DELAYS_S.len()],
}

impl LateImages {
    /// Forgets all observations.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    /// How much older than their time stamps the images are, seconds, if the observations show it.
    pub(crate) fn delay_s(&self) -> Option<f64> {
        let is_found = |evidence: &Evidence| evidence.iter().zip(EVIDENCE_MIN).all(|(sum, least)| *sum > least);
        let found = self.evidence.iter().zip(DELAYS_S).filter(|(evidence, _)| is_found(evidence));
        found.max_by(|(one, _), (other, _)| one[0].total_cmp(&other[0])).map(|(_, delay_s)| delay_s)
    }

    /// Adds the positions of the model in `base`, one with each of [`DELAYS_S`]; `None` if the joints at one of these times are unknown.
    pub(crate) fn take(&mut self, at: MonotonicTime, places_m: Option<[Vector3<f64>; DELAYS_S.len()]>) {
        let at_s = at.as_secs_f64();
        let Some(places_m) = places_m else { return self.clear() };
        if self.count > 0 && !(0.0..=GAP_MAX_S).contains(&(at_s - self.times_s[WINDOW - 1])) {
            self.clear();
        }
        self.times_s.rotate_left(1);
        self.times_s[WINDOW - 1] = at_s;
        for (kept, new) in self.places_m.iter_mut().zip(places_m) {
            kept.rotate_left(1);
            kept[WINDOW - 1] = new;
        }
        self.count = (self.count + 1).min(WINDOW);
        if self.count == WINDOW {
            self.weigh();
        }
    }

    fn weigh(&mut self) {
        let polynomials = orthonormal(&self.times_s);
        let squares = self.places_m.map(|places_m| residuals(&polynomials, &places_m));
        let [stated, ..] = squares;
        for (sums, squares) in self.evidence.iter_mut().zip(squares) {
            for (index, sum) in sums.iter_mut().enumerate() {
                let [stated, tried] = [stated, squares].map(|of| of[index] + NOISE_M[index].powi(2));
                *sum = (*sum + (stated / tried).ln().clamp(-STEP_MAX, STEP_MAX) - DRIFT).max(0.0);
            }
        }
    }
}

/// Orthonormal polynomials of degree 0 to 3 at these times (Gram-Schmidt). Times that are too few for a degree give zeros.
fn orthonormal(times_s: &[f64; WINDOW]) -> [[f64; WINDOW]; 4] {
    let middle_s = times_s.iter().sum::<f64>() / WINDOW as f64;
    let mut polynomials = [[0.0; WINDOW]; 4];
    for degree in 0..4 {
        let mut values = times_s.map(|time_s| (time_s - middle_s).powi(degree as i32));
        for lower in &polynomials[..degree] {
            let share: f64 = values.iter().zip(lower).map(|(value, lower)| value * lower).sum();
            values.iter_mut().zip(lower).for_each(|(value, lower)| *value -= share * lower);
        }
        let norm = values.iter().map(|value| value * value).sum::<f64>().sqrt();
        if norm > 0.0 {
            polynomials[degree] = values.map(|value| value / norm);
        }
    }
    polynomials
}

/// Mean squared distances from the motions of each of [`DEGREES`] that fit best, square metres.
fn residuals(polynomials: &[[f64; WINDOW]; 4], places_m: &[Vector3<f64>; WINDOW]) -> Evidence {
    let mut left_m = places_m.map(|place_m| place_m - places_m[0]);
    let mut squares = [0.0; DEGREES.len()];
    for (degree, polynomial) in polynomials.iter().enumerate() {
        let share = left_m.iter().zip(polynomial).map(|(left_m, value)| left_m * *value).sum::<Vector3<f64>>();
        left_m.iter_mut().zip(polynomial).for_each(|(left_m, value)| *left_m -= share * *value);
        if let Some(index) = DEGREES.iter().position(|wanted| *wanted == degree) {
            squares[index] = left_m.iter().map(Vector3::norm_squared).sum::<f64>() / WINDOW as f64;
        }
    }
    squares
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The delays that are found with images that are late by this time, and when; hand and target move as these functions say, metres.
    fn found(late_s: f64, hand: impl Fn(f64) -> f64, target: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        let mut late = LateImages::default();
        let look = |frame: u32| {
            let t_s = 1.0 + f64::from(frame) / 30.0;
            let apparent = target(t_s - late_s) - hand(t_s - late_s);
            let places = DELAYS_S.map(|delay_s| Vector3::new(0.1, apparent + hand(t_s - delay_s), 0.5));
            late.take(MonotonicTime::from_secs_f64(t_s), Some(places));
            late.delay_s().map(|delay_s| (delay_s, t_s))
        };
        (0..120).filter_map(look).collect()
    }

    #[test]
    fn a_hand_that_swings_before_a_target_at_rest_shows_the_delay() {
        let swings = |t_s: f64| 0.03 * (8.0 * t_s).sin();
        // The loop of a shorter delay swings faster.
        for (late_s, rate) in [(0.2, 8.0), (0.1, 10.0), (0.05, 14.0)] {
            let swings = |t_s: f64| 0.03 * (rate * t_s).sin();
            let (delay_s, at_s) = found(late_s, swings, |_| 0.3)[0];
            assert!((delay_s - late_s).abs() < 0.026 && at_s < 2.0, "{late_s}: {delay_s} at {at_s} s");
        }
        assert!(found(0.0, swings, |_| 0.3).is_empty());
        assert!(found(0.2, |_| 0.1, |t_s| 0.05 * (3.0 * t_s).sin()).is_empty(), "a hand at rest shows nothing");
    }

    const STEP_S: f64 = 0.005;

    /// A hand with a gain, a delay and a lag behind a target.
    fn behind(target: impl Fn(f64) -> f64, gain: f64, delay_s: f64, lag_s: f64) -> impl Fn(f64) -> f64 {
        let mut places = vec![0.0];
        for step in 1..1100 {
            let before: f64 = places[step - 1];
            places.push(before + (gain * target(step as f64 * STEP_S - delay_s) - before) * STEP_S / lag_s);
        }
        move |t_s| {
            let (step, share) = ((t_s / STEP_S) as usize, (t_s / STEP_S).fract());
            places[step] + (places[step + 1] - places[step]) * share
        }
    }

    /// Targets that start at 1.3 s with up to 1 m/s^2.
    #[test]
    fn a_target_that_the_hand_follows_shows_none() {
        for (amplitude, rate) in [(0.05, 1.57), (0.1, 2.0), (0.1, 3.1)] {
            let target = move |t_s: f64| amplitude * (1.0 - (rate * (t_s - 1.3f64).max(0.0)).cos());
            let apparent = found(0.0, behind(target, 1.0, 0.03, 0.03), target);
            assert!(apparent.is_empty(), "{amplitude} m, {rate} rad/s: {apparent:?}");
        }
    }

    /// 270 drawn hands behind targets that start with up to 2.6 m/s^2: gains of 0.8 to 1, delays of 10 to 130 ms, lags of 10 to 80 ms.
    #[test]
    fn of_quick_targets_few_seem_to_move_with_the_hand_and_for_a_moment() {
        let mut bits = 5u64;
        let mut within = |least: f64, most: f64| {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            least + (most - least) * (bits >> 11) as f64 / (1u64 << 53) as f64
        };
        let targets = [
            (0.05, 1.57),
            (0.1, 2.0),
            (0.1, 3.1),
            (0.05, 6.3),
            (0.1, 5.0),
            (0.04, 3.1),
            (0.15, 4.19),
            (0.02, 8.0),
            (0.1, 1.0),
        ];
        let (mut count, mut longest) = (0, 0);
        for (amplitude, rate) in targets.into_iter().cycle().take(270) {
            let target = move |t_s: f64| amplitude * (1.0 - (rate * (t_s - 1.3f64).max(0.0)).cos());
            let hand = behind(target, within(0.8, 1.0), within(0.01, 0.13), within(0.01, 0.08));
            let apparent = found(0.0, hand, target).len();
            (count, longest) = (count + usize::from(apparent > 0), longest.max(apparent));
        }
        println!("{count} of 270, for at most {longest} observations");
        assert!(count <= 10 && longest <= 6, "{count} of 270, for at most {longest} observations");
    }

    #[test]
    fn gaps_and_unknown_joints_begin_anew() {
        let mut late = LateImages::default();
        let nowhere = Some([Vector3::zeros(); DELAYS_S.len()]);
        for frame in 0..WINDOW {
            late.take(MonotonicTime::from_secs_f64(frame as f64 / 30.0), nowhere);
        }
        assert_eq!((late.count, late.delay_s()), (WINDOW, None));
        late.take(MonotonicTime::from_secs_f64(1.0), nowhere);
        assert_eq!(late.count, 1);
        late.take(MonotonicTime::from_secs_f64(1.03), None);
        assert_eq!(late.count, 0);
    }

    /// Places on a cubic motion, at uneven times: what is left of it by a quadratic one is the share of the cubic polynomial.
    #[test]
    fn residuals_are_those_of_the_best_fits() {
        let times_s = [0.0, 0.03, 0.07, 0.1, 0.14, 0.16, 0.2, 0.23];
        let polynomials = orthonormal(&times_s);
        let places = times_s.map(|t| Vector3::new(0.2 - t, 0.4 * t * t, 3.0 + 2.0 * t * t * t));
        let [quadratic, cubic] = residuals(&polynomials, &places);
        let share: f64 = times_s.iter().zip(&polynomials[3]).map(|(t, value)| 2.0 * t * t * t * value).sum();
        assert!((quadratic - share * share / 8.0).abs() < 1e-12 && quadratic > 1e-8, "{quadratic} {share}");
        assert!(cubic < 1e-20, "{cubic}");
    }
}
