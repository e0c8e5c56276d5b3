//! A search for a target that was lost: a small, slow way of the hand about the place where it lost it, bounded in space and time.
//!
//! The hand goes back along its z, away from the target, and then along an Archimedean spiral across its z, with its orientation kept,
//! and returns to where it began. It looks at what the pattern passes by; it guesses nothing about where the target went.
//!
//! It is off unless it is configured, and moves nothing unless the supervisor permits it in each step
//! ([`crate::supervisor::Decision::search`]).

use std::f64::consts::TAU;

use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, Hand};
use pb3dp_geometry::{MonotonicTime, Pose, Twist, so3};

use crate::config::{ConfigError, check};

/// The pattern and its bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchConfig {
    /// How far the hand goes back, metres, 0 to 0.2.
    pub back_m: f64,
    /// How far it goes aside, metres, 0.001 to 0.2.
    pub radius_m: f64,
    /// How many turns the spiral has, 1 to 10.
    pub turns: f64,
    /// How fast the hand is, m/s, 0.001 to 0.1.
    pub speed_m_per_s: f64,
    /// When the search ends at the latest, seconds after the first step, 1 to 60.
    pub time_s: f64,
}

/// A hand that is off its way is brought back with this rate, 1/s, within the speed of the search.
const CORRECTION_PER_S: f64 = 2.0;
/// And turned back no faster than this, rad/s.
const TURN_MAX_RAD_PER_S: f64 = 0.1;
/// A hand that is farther from where it began than the pattern leads, by this share and length (metres), ends the search: it does not go
/// where it is told.
const BEYOND_SHARE: f64 = 1.2;
const BEYOND_M: f64 = 0.005;
/// The search has returned when the hand is this near to its beginning, metres.
const RETURNED_WITHIN_M: f64 = 1e-3;

impl SearchConfig {
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        check("search.back_m", self.back_m, 0.0, 0.2, "0 to 0.2 m")?;
        check("search.radius_m", self.radius_m, 1e-3, 0.2, "0.001 to 0.2 m")?;
        check("search.turns", self.turns, 1.0, 10.0, "1 to 10")?;
        check("search.speed_m_per_s", self.speed_m_per_s, 1e-3, 0.1, "0.001 to 0.1 m/s")?;
        check("search.time_s", self.time_s, 1.0, 60.0, "1 to 60 s")
    }

    /// Farthest from its beginning that the pattern leads, metres.
    pub fn reach_m(&self) -> f64 {
        self.back_m.hypot(self.radius_m)
    }

    /// Where the pattern is after this way (metres), in axes of the hand at its beginning; `None` behind its end.
    fn place(&self, way_m: f64) -> Option<Vector3<f64>> {
        if way_m < self.back_m {
            return Some(Vector3::new(0.0, 0.0, -way_m));
        }
        // r = a angle; its length up to an angle is a / 2 (angle sqrt(1 + angle^2) + asinh(angle)).
        let per_rad_m = self.radius_m / (TAU * self.turns);
        let length_m = |angle: f64| 0.5 * per_rad_m * (angle * (1.0 + angle * angle).sqrt() + angle.asinh());
        let (mut low, mut high) = (0.0, TAU * self.turns);
        let on_spiral_m = way_m - self.back_m;
        if on_spiral_m > length_m(high) {
            return None;
        }
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if length_m(middle) < on_spiral_m { low = middle } else { high = middle }
        }
        let radius_m = per_rad_m * low;
        Some(Vector3::new(radius_m * low.cos(), radius_m * low.sin(), -self.back_m))
    }
}

/// A search, or that there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Search {
    /// Not permitted.
    Off,
    /// Permitted, and begins with the next step.
    Ready,
    /// On its way.
    Under { began: MonotonicTime, stepped: MonotonicTime, from: Pose<Base, Hand>, way_m: f64 },
    /// Found, returned or out of time: there is no other one before the next loss.
    Over,
}

impl Search {
    /// What the supervisor says; one search for each time that it permits one.
    pub(crate) fn permit(&mut self, is_permitted: bool) {
        *self = match (is_permitted, *self) {
            (false, _) => Self::Off,
            (true, Self::Off) => Self::Ready,
            (true, search) => search,
        };
    }

    /// It is not needed any more.
    pub(crate) fn end(&mut self) {
        if *self != Self::Off {
            *self = Self::Over;
        }
    }

    /// Whether it was permitted and has not begun.
    pub(crate) fn is_ready(&self) -> bool {
        *self == Self::Ready
    }

    /// Velocity of the hand, in `base`, as long as there is one.
    pub(crate) fn step(
        &mut self,
        config: &SearchConfig,
        base_from_hand: &Pose<Base, Hand>,
        now: MonotonicTime,
    ) -> Option<Twist<Base>> {
        let (began, stepped, from, way_m) = match *self {
            Self::Off | Self::Over => return None,
            Self::Ready => (now, now, *base_from_hand, 0.0),
            Self::Under { began, stepped, from, way_m } => (began, stepped, from, way_m),
        };
        let (since_s, dt_s) = (now.seconds_since(began), now.seconds_since(stepped));
        if !(0.0..=config.time_s).contains(&since_s) || !(0.0..=1.0).contains(&dt_s) {
            *self = Self::Over;
            return None;
        }
        let way_m = way_m + config.speed_m_per_s * dt_s;
        let place = config.place(way_m);
        let wanted = from.translation_m() + place.map_or(Vector3::zeros(), |place| from.transform_vector(&place));
        let left = wanted - base_from_hand.translation_m();
        let from_begin_m = (base_from_hand.translation_m() - from.translation_m()).norm();
        let has_returned = place.is_none() && left.norm() < RETURNED_WITHIN_M;
        if has_returned || from_begin_m > BEYOND_SHARE * config.reach_m() + BEYOND_M {
            *self = Self::Over;
            return None;
        }
        *self = Self::Under { began, stepped: now, from, way_m };
        let turn = so3::log(&(from.rotation() * base_from_hand.rotation().inverse()));
        Some(Twist::new(
            no_longer_than(along(config, &from, way_m) + left * CORRECTION_PER_S, config.speed_m_per_s),
            no_longer_than(turn * CORRECTION_PER_S, TURN_MAX_RAD_PER_S),
        ))
    }
}

/// Velocity of the pattern, in `base`; none behind its end.
fn along(config: &SearchConfig, from: &Pose<Base, Hand>, way_m: f64) -> Vector3<f64> {
    let ahead_m = 1e-4;
    match (config.place(way_m), config.place(way_m + ahead_m)) {
        (Some(here), Some(there)) => from.transform_vector(&((there - here) * (config.speed_m_per_s / ahead_m))),
        _ => Vector3::zeros(),
    }
}

fn no_longer_than(vector: Vector3<f64>, most: f64) -> Vector3<f64> {
    let length = vector.norm();
    if length > most { vector * (most / length) } else { vector }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    const CONFIG: SearchConfig =
        SearchConfig { back_m: 0.04, radius_m: 0.03, turns: 3.0, speed_m_per_s: 0.02, time_s: 40.0 };

    fn begin() -> Pose<Base, Hand> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -1.1, 0.7));
        Pose::from_parts(Vector3::new(0.6, -0.2, 0.5), rotation)
    }

    fn at(seconds: f64) -> MonotonicTime {
        MonotonicTime::from_secs_f64(100.0 + seconds)
    }

    /// A hand that does what it is told: how long it moved, how far it was, where it ends.
    fn searched(config: &SearchConfig) -> (f64, f64, Pose<Base, Hand>) {
        let (mut search, mut hand, mut farthest_m, mut t_s) = (Search::Off, begin(), 0.0f64, 0.0);
        search.permit(true);
        while let Some(twist) = search.step(config, &hand, at(t_s)) {
            assert!(twist.linear_m_per_s.norm() <= config.speed_m_per_s + 1e-12, "{twist:?}");
            assert!(twist.angular_rad_per_s.norm() <= TURN_MAX_RAD_PER_S + 1e-12, "{twist:?}");
            hand = Pose::from_parts(hand.translation_m() + twist.linear_m_per_s * 0.01, hand.rotation());
            farthest_m = farthest_m.max((hand.translation_m() - begin().translation_m()).norm());
            t_s += 0.01;
            assert!(t_s < 100.0, "it ends");
        }
        search.permit(true);
        assert_eq!(search, Search::Over, "once");
        (t_s, farthest_m, hand)
    }

    #[test]
    fn it_goes_back_and_round_and_returns() {
        let (took_s, farthest_m, hand) = searched(&CONFIG);
        assert!((0.95 * CONFIG.reach_m()..=1.01 * CONFIG.reach_m()).contains(&farthest_m), "{farthest_m}");
        // 40 mm back, a spiral of about 3 turns of half the radius, and home.
        assert!((14.0..25.0).contains(&took_s), "{took_s}");
        assert!((hand.translation_m() - begin().translation_m()).norm() < 1.5e-3);
    }

    #[test]
    fn it_ends_when_its_time_is_over_wherever_it_is() {
        let (took_s, _, hand) = searched(&SearchConfig { time_s: 5.0, ..CONFIG });
        assert!((took_s - 5.0).abs() < 0.02, "{took_s}");
        assert!((hand.translation_m() - begin().translation_m()).norm() > 0.01);
    }

    #[test]
    fn the_pattern_has_the_speed_that_is_asked_for() {
        for way_m in [0.01, 0.045, 0.06, 0.15, 0.3] {
            let (here, there) = (CONFIG.place(way_m).unwrap(), CONFIG.place(way_m + 1e-5).unwrap());
            assert!(((there - here).norm() / 1e-5 - 1.0).abs() < 0.02, "{way_m}");
        }
        assert!(CONFIG.place(1.0).is_none());
    }

    #[test]
    fn nothing_moves_before_it_is_permitted_and_after_it_was_taken_back() {
        let mut search = Search::Off;
        assert!(search.step(&CONFIG, &begin(), at(0.0)).is_none());
        search.permit(true);
        assert!(search.step(&CONFIG, &begin(), at(0.0)).is_some());
        search.permit(false);
        assert!(search.step(&CONFIG, &begin(), at(0.1)).is_none());
        // Permitted anew, it begins anew (the supervisor permits one for each loss); a clock that steps ends it.
        search.permit(true);
        assert!(search.step(&CONFIG, &begin(), at(0.2)).is_some());
        assert!(search.step(&CONFIG, &begin(), at(-5.0)).is_none());
        assert_eq!(search, Search::Over);
    }

    #[test]
    fn a_hand_that_leaves_the_bounds_ends_it() {
        let mut search = Search::Off;
        search.permit(true);
        assert!(search.step(&CONFIG, &begin(), at(0.0)).is_some());
        let aside = |by_m: f64| {
            Pose::from_parts(begin().translation_m() + Vector3::new(0.6, 0.0, -0.8) * by_m, begin().rotation())
        };
        assert!(search.step(&CONFIG, &aside(1.1 * CONFIG.reach_m()), at(0.1)).is_some());
        assert!(search.step(&CONFIG, &aside(1.2 * CONFIG.reach_m() + 0.006), at(0.2)).is_none());
        assert_eq!(search, Search::Over);
        assert!(search.step(&CONFIG, &begin(), at(0.3)).is_none());
    }

    /// A hand that is turned is turned back, whichever way.
    #[test]
    fn the_orientation_of_the_beginning_is_kept() {
        let mut search = Search::Off;
        search.permit(true);
        assert!(search.step(&CONFIG, &begin(), at(0.0)).is_some());
        let turned_by = Vector3::new(0.01, -0.02, 0.015);
        let turned = UnitQuaternion::from_scaled_axis(turned_by) * begin().rotation();
        let twist = search.step(&CONFIG, &Pose::from_parts(begin().translation_m(), turned), at(0.01)).unwrap();
        assert!((twist.angular_rad_per_s + CORRECTION_PER_S * turned_by).norm() < 1e-9, "{twist:?}");
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        assert!(CONFIG.validate().is_ok());
        for bad in [
            SearchConfig { back_m: 0.3, ..CONFIG },
            SearchConfig { radius_m: f64::NAN, ..CONFIG },
            SearchConfig { turns: 0.0, ..CONFIG },
            SearchConfig { speed_m_per_s: 0.5, ..CONFIG },
            SearchConfig { time_s: 1e3, ..CONFIG },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
