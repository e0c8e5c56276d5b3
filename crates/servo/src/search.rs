//! Search for a lost target: a small, slow motion of the hand around its last pose, bounded in space and time.
//!
//! The hand backs off along its z axis, follows an Archimedean spiral across its z axis with constant orientation, and returns. The
//! search does not predict where the target went.
//!
//! It is off unless configured, and needs the permission of the supervisor in each step ([`crate::supervisor::Decision::search`]).

use std::f64::consts::TAU;

use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, Hand};
use pb3dp_geometry::{MonotonicTime, Pose, Twist, ranges, so3};

/// Pattern and bounds of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchConfig {
    /// Distance that the hand backs off, metres, 0 to 0.2.
    pub back_m: f64,
    /// Largest radius of the spiral, metres, 0.001 to 0.2.
    pub radius_m: f64,
    /// Turns of the spiral, 1 to 10.
    pub turns: f64,
    /// Speed of the hand, m/s, 0.001 to 0.1.
    pub speed_m_per_s: f64,
    /// Time limit of the search, seconds from the first step, 1 to 60.
    pub time_s: f64,
}

/// Gain of the correction of path errors, 1/s, within the speed of the search.
const CORRECTION_PER_S: f64 = 2.0;
/// Speed limit of the orientation correction, rad/s.
const TURN_MAX_RAD_PER_S: f64 = 0.1;
/// Largest tangential and centripetal acceleration along the pattern, m/s^2. In a sharp corner the limits of the single joints
/// would make the hand leave the path, and move faster before and after the corner.
const ACCELERATION_MAX_M_PER_S2: f64 = 0.05;
/// Share of the speed at corners.
const CORNER_SHARE: f64 = 0.1;
/// Share and length (metres) by which the hand may exceed the extent of the pattern. A hand further away does not follow its
/// commands, and the search ends.
const BEYOND_SHARE: f64 = 1.2;
const BEYOND_M: f64 = 0.005;
/// Distance from its start within which the search has returned, metres.
const RETURNED_WITHIN_M: f64 = 1e-3;

impl SearchConfig {
    ranges! {
        pub(crate) fn validate "search.";
        back_m, BACK_M: f64 = 0.0..=0.2;
        radius_m, RADIUS_M: f64 = 1e-3..=0.2;
        turns, TURNS: f64 = 1.0..=10.0;
        speed_m_per_s, SPEED_M_PER_S: f64 = 1e-3..=0.1;
        time_s, TIME_S: f64 = 1.0..=60.0;
    }

    /// Largest distance of the pattern from its start, metres.
    pub fn reach_m(&self) -> f64 {
        self.back_m.hypot(self.radius_m)
    }

    /// Radius of the spiral per radian, metres.
    fn per_rad_m(&self) -> f64 {
        self.radius_m / (TAU * self.turns)
    }

    /// Length (metres) of the spiral up to an angle (radians).
    fn spiral_m(&self, angle: f64) -> f64 {
        0.5 * self.per_rad_m() * (angle * (1.0 + angle * angle).sqrt() + angle.asinh())
    }

    /// Path length at which the pattern ends and the hand returns, metres.
    fn end_m(&self) -> f64 {
        self.back_m + self.spiral_m(TAU * self.turns)
    }

    /// Angle of the spiral after this path length (metres); `None` before and after it.
    fn angle(&self, way_m: f64) -> Option<f64> {
        if !(self.back_m..=self.end_m()).contains(&way_m) {
            return None;
        }
        let (mut low, mut high) = (0.0, TAU * self.turns);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.spiral_m(middle) < way_m - self.back_m { low = middle } else { high = middle }
        }
        Some(low)
    }

    /// Point of the pattern after this path length (metres), in the start axes of the hand; `None` after its end.
    fn place(&self, way_m: f64) -> Option<Vector3<f64>> {
        if way_m < self.back_m {
            return Some(Vector3::new(0.0, 0.0, -way_m));
        }
        let angle = self.angle(way_m)?;
        let radius_m = self.per_rad_m() * angle;
        Some(Vector3::new(radius_m * angle.cos(), radius_m * angle.sin(), -self.back_m))
    }

    /// Speed along the pattern after this path length (metres), m/s: low at the start, the corner, the end and where the curvature
    /// is largest.
    fn pace_m_per_s(&self, way_m: f64) -> f64 {
        let to_corner_m = [0.0, self.back_m, self.end_m()].map(|corner_m| (way_m - corner_m).abs());
        let to_corner_m = to_corner_m.into_iter().fold(f64::INFINITY, f64::min);
        let braking = (2.0 * ACCELERATION_MAX_M_PER_S2 * to_corner_m).sqrt();
        let bent = self.angle(way_m).map_or(f64::INFINITY, |angle| {
            // Radius of curvature of an Archimedean spiral.
            let radius_m = self.per_rad_m() * (1.0 + angle * angle).powf(1.5) / (2.0 + angle * angle);
            (ACCELERATION_MAX_M_PER_S2 * radius_m).sqrt()
        });
        braking.min(bent).clamp(CORNER_SHARE * self.speed_m_per_s, self.speed_m_per_s)
    }
}

/// State of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Search {
    /// Not permitted.
    Off,
    /// Permitted, and begins with the next step.
    Ready,
    /// In motion.
    Under { began: MonotonicTime, stepped: MonotonicTime, from: Pose<Base, Hand>, way_m: f64 },
    /// Finished: found, returned or out of time. The next search needs another loss.
    Over,
}

impl Search {
    /// Applies the permission of the supervisor: one search per permission.
    pub(crate) fn permit(&mut self, is_permitted: bool) {
        *self = match (is_permitted, *self) {
            (false, _) => Self::Off,
            (true, Self::Off) => Self::Ready,
            (true, search) => search,
        };
    }

    /// Ends the search.
    pub(crate) fn end(&mut self) {
        if *self != Self::Off {
            *self = Self::Over;
        }
    }

    /// Whether it is permitted and has not started.
    pub(crate) fn is_ready(&self) -> bool {
        *self == Self::Ready
    }

    /// Velocity of the hand in `base`; `None` if no search is active.
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
        let way_m = way_m + config.pace_m_per_s(way_m) * dt_s;
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
        // The return path also starts slowly.
        let most = if place.is_some() { config.speed_m_per_s } else { config.pace_m_per_s(way_m) };
        Some(Twist::new(
            no_longer_than(along(config, &from, way_m) + left * CORRECTION_PER_S, most),
            no_longer_than(turn * CORRECTION_PER_S, TURN_MAX_RAD_PER_S),
        ))
    }
}

/// Velocity along the pattern, in `base`; zero after its end.
fn along(config: &SearchConfig, from: &Pose<Base, Hand>, way_m: f64) -> Vector3<f64> {
    let ahead_m = 1e-4;
    match (config.place(way_m), config.place(way_m + ahead_m)) {
        (Some(here), Some(there)) => from.transform_vector(&((there - here) * (config.pace_m_per_s(way_m) / ahead_m))),
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

    /// Search of a hand that follows its commands: duration, largest distance from the start, final pose.
    fn searched(config: &SearchConfig) -> (f64, f64, Pose<Base, Hand>) {
        let (mut search, mut hand, mut farthest_m, mut t_s) = (Search::Off, begin(), 0.0f64, 0.0);
        search.permit(true);
        while let Some(twist) = search.step(config, &hand, at(t_s)) {
            assert!(twist.linear_m_per_s.norm() <= config.speed_m_per_s + 1e-12, "{twist:?}");
            assert!(twist.angular_rad_per_s.norm() <= TURN_MAX_RAD_PER_S + 1e-12, "{twist:?}");
            hand = Pose::from_parts(hand.translation_m() + twist.linear_m_per_s * 0.01, hand.rotation());
            farthest_m = farthest_m.max((hand.translation_m() - begin().translation_m()).norm());
            t_s += 0.01;
            assert!(t_s < 100.0, "the search does not end");
        }
        search.permit(true);
        assert_eq!(search, Search::Over, "one search per permission");
        (t_s, farthest_m, hand)
    }

    #[test]
    fn it_goes_back_and_round_and_returns() {
        let (took_s, farthest_m, hand) = searched(&CONFIG);
        assert!((0.95 * CONFIG.reach_m()..=1.01 * CONFIG.reach_m()).contains(&farthest_m), "{farthest_m}");
        // 40 mm back, a spiral of about 3 turns with half the radius on average, and the return path.
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

    /// Critical points: the start, the corner between backward path and spiral, the first turn of the spiral, and the end.
    #[test]
    fn its_velocity_never_changes_suddenly() {
        for config in [CONFIG, SearchConfig { back_m: 0.05, radius_m: 0.05, turns: 2.0, speed_m_per_s: 0.03, ..CONFIG }]
        {
            let (mut search, mut hand, mut before, mut t_s) = (Search::Off, begin(), Vector3::zeros(), 0.0);
            search.permit(true);
            while let Some(twist) = search.step(&config, &hand, at(t_s)) {
                let change = (twist.linear_m_per_s - before).norm();
                assert!(change < 0.25 * config.speed_m_per_s, "{change} m/s at {t_s:.2} s");
                before = twist.linear_m_per_s;
                hand = Pose::from_parts(hand.translation_m() + before * 0.01, hand.rotation());
                t_s += 0.01;
            }
            assert!(t_s > 10.0);
        }
    }

    #[test]
    fn nothing_moves_before_it_is_permitted_and_after_it_was_taken_back() {
        let mut search = Search::Off;
        assert!(search.step(&CONFIG, &begin(), at(0.0)).is_none());
        search.permit(true);
        assert!(search.step(&CONFIG, &begin(), at(0.0)).is_some());
        search.permit(false);
        assert!(search.step(&CONFIG, &begin(), at(0.1)).is_none());
        // A new permission starts a new search (the supervisor permits one per loss). A clock step ends it.
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

    /// The search corrects a rotation of the hand about any axis.
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
