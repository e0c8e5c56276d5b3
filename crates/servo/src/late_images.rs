//! Finds images that are older than their time stamps, before the loop that they close oscillates.
//!
//! An observation is placed in `base` with the joints at its time stamp. If the image is older than that, the motion of the hand meanwhile
//! appears as a motion of the target: the hand follows itself, with positive feedback. Placed with the joints of the right, earlier time
//! the target moves smoothly. So each observation is placed with several delays; the delay with the straightest motion of the target tells.

use nalgebra::Vector3;
use pb3dp_geometry::MonotonicTime;

/// Delays that are tried, seconds; the first one is what the time stamps state. Chosen: one to nine periods of a camera at 30 Hz.
pub(crate) const DELAYS_S: [f64; 9] = [0.0, 0.033, 0.067, 0.1, 0.133, 0.167, 0.2, 0.25, 0.3];

/// Observations over which the target moves straight on: 0.25 s at 30 Hz. Measured with recorded motions (tests/tests/oscillation.rs): with
/// 6 the deviations of a delay of 0.2 s are half as large, with 10 they are found 0.06 s later.
const WINDOW: usize = 8;

/// A later observation after such a gap begins anew, seconds: three periods of a camera at 30 Hz.
const GAP_MAX_S: f64 = 0.1;

/// Deviations must be this many times smaller with another delay. A target that the hand follows well is smooth with every delay; a
/// sinusoid exceeds 4 for 0.12 s at most, where its acceleration changes its sign.
const RATIO: f64 = 4.0;

/// The target seems to move with the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovesWithHand {
    /// Deviation of the target from a straight motion, root mean square, metres.
    pub deviation_m: f64,
    /// Delay of the images with which the target moves straight on, seconds.
    pub delay_s: f64,
}

/// The last observations, placed with each delay.
#[derive(Clone, Debug, Default)]
pub(crate) struct LateImages {
    times_s: [f64; WINDOW],
    places_m: [[Vector3<f64>; WINDOW]; DELAYS_S.len()],
    count: usize,
    /// What the last observation showed, and what it showed for the second time in a row.
    seen: Option<MovesWithHand>,
    found: Option<MovesWithHand>,
}

impl LateImages {
    /// Forgets all observations.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    /// What the last observations show.
    pub(crate) fn found(&self) -> Option<MovesWithHand> {
        self.found
    }

    /// Adds the positions of the model in `base`, one with each of [`DELAYS_S`]; `None` if the joints at one of these times are unknown.
    pub(crate) fn take(&mut self, at: MonotonicTime, places_m: Option<[Vector3<f64>; DELAYS_S.len()]>) {
        let at_s = at.as_secs_f64();
        let is_next = self.count > 0 && (0.0..=GAP_MAX_S).contains(&(at_s - self.times_s[WINDOW - 1]));
        let Some(places_m) = places_m else { return self.clear() };
        if !is_next {
            self.clear();
        }
        self.times_s.rotate_left(1);
        self.times_s[WINDOW - 1] = at_s;
        for (kept, new) in self.places_m.iter_mut().zip(places_m) {
            kept.rotate_left(1);
            kept[WINDOW - 1] = new;
        }
        self.count = (self.count + 1).min(WINDOW);
        let seen = if self.count == WINDOW { self.compare() } else { None };
        self.found = seen.filter(|_| self.seen.is_some());
        self.seen = seen;
    }

    fn compare(&self) -> Option<MovesWithHand> {
        let deviations_m = self.places_m.map(|places| deviation(&self.times_s, &places));
        let (stated_m, others_m) = deviations_m.split_first()?;
        let (best_m, delay_s) =
            others_m.iter().zip(&DELAYS_S[1..]).fold((f64::INFINITY, 0.0), |best, (&other, &delay_s)| {
                if other < best.0 { (other, delay_s) } else { best }
            });
        (*stated_m >= RATIO * best_m).then_some(MovesWithHand { deviation_m: *stated_m, delay_s })
    }
}

/// Root mean square of the distances from the straight, uniform motion that fits best.
fn deviation(times_s: &[f64; WINDOW], places_m: &[Vector3<f64>; WINDOW]) -> f64 {
    let count = WINDOW as f64;
    let middle_s = times_s.iter().sum::<f64>() / count;
    let middle_m = places_m.iter().sum::<Vector3<f64>>() / count;
    let (mut moment, mut spread) = (Vector3::zeros(), 0.0);
    for (time_s, place_m) in times_s.iter().zip(places_m) {
        moment += (place_m - middle_m) * (time_s - middle_s);
        spread += (time_s - middle_s).powi(2);
    }
    let velocity = moment / spread;
    let errors = times_s
        .iter()
        .zip(places_m)
        .map(|(time_s, place_m)| (place_m - middle_m - velocity * (time_s - middle_s)).norm_squared());
    (errors.sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest deviation found with images that are late by this time; hand and target move as these functions say, metres.
    fn found(late_s: f64, hand: fn(f64) -> f64, target: fn(f64) -> f64) -> Option<MovesWithHand> {
        let mut late = LateImages::default();
        let mut most: Option<MovesWithHand> = None;
        for frame in 0..60 {
            let t_s = 1.0 + f64::from(frame) / 30.0;
            let seen = target(t_s - late_s) - hand(t_s - late_s);
            let places = DELAYS_S.map(|delay_s| Vector3::new(0.1, seen + hand(t_s - delay_s), 0.5));
            late.take(MonotonicTime::from_secs_f64(t_s), Some(places));
            if late.found().is_some_and(|new| most.is_none_or(|most| new.deviation_m > most.deviation_m)) {
                most = late.found();
            }
        }
        most
    }

    #[test]
    fn a_hand_that_swings_before_a_target_at_rest_shows_the_delay() {
        let swings = |t_s: f64| 0.03 * (8.0 * t_s).sin();
        let late = found(0.2, swings, |_| 0.3).unwrap();
        assert!(late.deviation_m > 0.005 && (late.delay_s - 0.2).abs() < 1e-9, "{late:?}");
        let late = found(0.1, swings, |_| 0.3).unwrap();
        assert!(late.deviation_m > 0.002 && (late.delay_s - 0.1).abs() < 1e-9, "{late:?}");
        assert!(found(0.0, swings, |_| 0.3).is_none_or(|found| found.deviation_m < 1e-9));
    }

    /// 100 mm within 2 s, followed 20 ms late: no more than the acceleration of the target, below the threshold of 1 mm.
    #[test]
    fn a_target_that_the_hand_follows_shows_none() {
        let target = |t_s: f64| 0.05 * (1.0 - (1.57 * (t_s - 1.3).max(0.0)).cos());
        let followed = found(0.0, |t_s| 0.05 * (1.0 - (1.57 * (t_s - 1.32).max(0.0)).cos()), target);
        assert!(followed.is_none_or(|found| found.deviation_m < 1e-3), "{followed:?}");
    }

    #[test]
    fn gaps_and_unknown_joints_begin_anew() {
        let mut late = LateImages::default();
        for frame in 0..WINDOW {
            late.take(MonotonicTime::from_secs_f64(frame as f64 / 30.0), Some([Vector3::zeros(); DELAYS_S.len()]));
        }
        assert_eq!(late.count, WINDOW);
        late.take(MonotonicTime::from_secs_f64(1.0), Some([Vector3::zeros(); DELAYS_S.len()]));
        assert_eq!(late.count, 1);
        late.take(MonotonicTime::from_secs_f64(1.03), None);
        assert_eq!((late.count, late.found()), (0, None));
    }
}
