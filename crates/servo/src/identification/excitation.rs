//! Excitation motion for the identification of delays: small, smooth, closed, and with different periods in two directions.

use std::f64::consts::PI;

use nalgebra::Vector3;
use pb3dp_geometry::Twist;
use pb3dp_geometry::frames::Hand;

use super::BATCHES;

/// Periods of the motion to the right in one piece of the record.
const PERIODS_RIGHT: f64 = 2.0;
/// Periods of the motion downwards: another number, so that both can be distinguished.
const PERIODS_DOWN: f64 = 3.0;
/// Largest motion from end to end, metres; a larger one changes the image too much.
const WAY_MAX_M: f64 = 0.03;
/// Largest speed, m/s; a faster motion may reach the limiter, and blurs the images.
const SPEED_MAX_M_PER_S: f64 = 0.06;

/// The hand moves to its right and downwards and back, equally in each piece of the record. The path is the fourth power of a sine:
/// it starts with zero acceleration, so no limiter changes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excitation {
    way_m: f64,
    piece_s: f64,
}

/// A refused motion.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("excitation {key} is {value}: allowed is {allowed}")]
pub struct ExcitationError {
    /// Name of the parameter.
    pub key: &'static str,
    /// Its value.
    pub value: f64,
    /// The allowed values.
    pub allowed: &'static str,
}

impl Excitation {
    /// Creates an excitation of `way_m` metres from end to end, 0.001 to 0.03, that takes `duration_s` seconds, 6 to 120, with at
    /// most 0.06 m/s.
    ///
    /// # Errors
    /// If a number is out of range.
    pub fn new(way_m: f64, duration_s: f64) -> Result<Self, ExcitationError> {
        if !(1e-3..=WAY_MAX_M).contains(&way_m) {
            return Err(ExcitationError { key: "way_m", value: way_m, allowed: "0.001 to 0.03 m" });
        }
        if !(6.0..=120.0).contains(&duration_s) {
            return Err(ExcitationError { key: "duration_s", value: duration_s, allowed: "6 to 120 s" });
        }
        let motion = Self { way_m, piece_s: duration_s / BATCHES as f64 };
        let value = motion.speed_max_m_per_s();
        if value > SPEED_MAX_M_PER_S {
            let allowed = "at most 0.06 m/s: swing for longer, or less far";
            return Err(ExcitationError { key: "speed_m_per_s", value, allowed });
        }
        Ok(motion)
    }

    /// Duration, seconds.
    pub fn duration_s(&self) -> f64 {
        self.piece_s * BATCHES as f64
    }

    /// Largest speed of the hand, m/s.
    pub fn speed_max_m_per_s(&self) -> f64 {
        // 4 sin^3 cos has its maximum at 60 degrees.
        let steepest = 0.75 * 3f64.sqrt();
        self.way_m * steepest * PI / self.piece_s * PERIODS_RIGHT.hypot(PERIODS_DOWN)
    }

    /// Position of the hand `t_s` seconds after the start, relative to the start, along its start axes, metres.
    pub fn way_at(&self, t_s: f64) -> Vector3<f64> {
        let t_s = t_s.clamp(0.0, self.duration_s());
        let along = |periods: f64| self.way_m * (PI * periods * t_s / self.piece_s).sin().powi(4);
        Vector3::new(along(PERIODS_RIGHT), along(PERIODS_DOWN), 0.0)
    }

    /// Velocity of the hand, along the same axes; zero before the start and after the end.
    pub fn twist_at(&self, t_s: f64) -> Twist<Hand> {
        if !(0.0..=self.duration_s()).contains(&t_s) {
            return Twist::zero();
        }
        let along = |periods: f64| {
            let rate = PI * periods / self.piece_s;
            let (sine, cosine) = (rate * t_s).sin_cos();
            4.0 * self.way_m * rate * sine.powi(3) * cosine
        };
        Twist::new(Vector3::new(along(PERIODS_RIGHT), along(PERIODS_DOWN), 0.0), Vector3::zeros())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_comes_back_and_its_velocity_is_that_of_its_way() {
        let motion = Excitation::new(0.01, 15.0).unwrap();
        let mut fastest = 0.0f64;
        for step in 1..1500 {
            let t_s = f64::from(step) * 0.01;
            let by_difference = (motion.way_at(t_s + 1e-6) - motion.way_at(t_s - 1e-6)) / 2e-6;
            let twist = motion.twist_at(t_s);
            assert!((twist.linear_m_per_s - by_difference).norm() < 1e-6, "{t_s} s: {twist:?}");
            fastest = fastest.max(twist.linear_m_per_s.norm());
        }
        assert!(fastest <= motion.speed_max_m_per_s() && fastest > 0.8 * motion.speed_max_m_per_s());
        for t_s in [-1.0, 0.0, 2.5, 15.0, 16.0] {
            assert!(motion.way_at(t_s).norm() < 1e-12 && motion.twist_at(t_s).to_vector().norm() < 1e-12, "{t_s}");
        }
        assert!((motion.way_at(0.625) - Vector3::new(0.01, 0.0025, 0.0)).norm() < 1e-12, "{:?}", motion.way_at(0.625));
    }

    #[test]
    fn what_is_too_far_or_too_short_is_refused() {
        for (way_m, duration_s, key) in [
            (0.031, 15.0, "way_m"),
            (0.0009, 15.0, "way_m"),
            (f64::NAN, 15.0, "way_m"),
            (0.01, 5.0, "duration_s"),
            (0.03, 6.0, "speed_m_per_s"),
            (0.005, 6.0, "speed_m_per_s"),
        ] {
            assert_eq!(Excitation::new(way_m, duration_s).unwrap_err().key, key);
        }
    }
}
