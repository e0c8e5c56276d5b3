//! Sine, cosine and arc tangent with bit-identical results on every platform. The system libraries differ in the last digit,
//! and the same seed must give the same estimate everywhere.
//!
//! The functions use only sums, products, quotients and square roots, which IEEE 754 rounds identically everywhere. The
//! estimation pipeline uses no other trigonometric functions; those of nalgebra call the system library.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix2, Rotation2};

/// Terms of the power series after the first one; the last term is below half a unit in the last place at pi/2.
const TERMS: usize = 11;

/// Terms of the arc tangent series; the last term is below half a unit in the last place at tan(pi/16).
const ARC_TERMS: u32 = 12;

/// `1 / ((2k + 2)(2k + 3))` and `1 / ((2k + 1)(2k + 2))`: quotients of successive terms of sin x / x and of cos x.
const QUOTIENTS: [(f64, f64); TERMS] = quotients();

const fn quotients() -> [(f64, f64); TERMS] {
    let mut table = [(0.0, 0.0); TERMS];
    let mut k = 0;
    while k < TERMS {
        let n = (2 * k + 2) as f64;
        table[k] = (1.0 / (n * (n + 1.0)), 1.0 / (n * (n - 1.0)));
        k += 1;
    }
    table
}

/// Sine and cosine of an angle in `[-pi/2, pi/2]` radians; error below 5e-16 there, growing outside.
#[inline]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    let square = angle_rad * angle_rad;
    let (mut sine, mut cosine) = (1.0, 1.0);
    // Horner from the smallest term: sin x / x = 1 - x2/(2*3) (1 - x2/(4*5) (...)), cos x = 1 - x2/(1*2) (1 - x2/(3*4) (...)).
    for (of_sine, of_cosine) in QUOTIENTS.iter().rev() {
        sine = 1.0 - square * of_sine * sine;
        cosine = 1.0 - square * of_cosine * cosine;
    }
    (angle_rad * sine, cosine)
}

/// Rotation of the plane by any angle, radians.
pub fn rotation(angle_rad: f64) -> Rotation2<f64> {
    let half_turns = (angle_rad / PI).round();
    let (sine, cosine) = sin_cos(angle_rad - half_turns * PI);
    let sign = if half_turns.rem_euclid(2.0) < 0.5 { 1.0 } else { -1.0 };
    Rotation2::from_matrix_unchecked(sign * Matrix2::new(cosine, -sine, sine, cosine))
}

/// Tangent of an angle in `(-pi/2, pi/2)` radians.
pub fn tan(angle_rad: f64) -> f64 {
    let (sine, cosine) = sin_cos(angle_rad);
    sine / cosine
}

/// Angle of the vector `(x, y)` from the x axis, -pi to pi radians; 0 for the zero vector. Error below 1e-15.
pub fn atan2(y: f64, x: f64) -> f64 {
    let (near, far) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    let octant_rad = if far > 0.0 { arc_tangent(near / far) } else { 0.0 };
    let quadrant_rad = if y.abs() > x.abs() { FRAC_PI_2 - octant_rad } else { octant_rad };
    let half_rad = if x < 0.0 { PI - quadrant_rad } else { quadrant_rad };
    if y < 0.0 { -half_rad } else { half_rad }
}

/// Arc tangent of `t` in `[0, 1]`.
fn arc_tangent(t: f64) -> f64 {
    // tan(a / 2) = t / (1 + sqrt(1 + t2)), applied twice: the argument is then at most tan(pi/16) = 0.2.
    let half = |t: f64| t / (1.0 + (1.0 + t * t).sqrt());
    let quarter = half(half(t));
    let square = quarter * quarter;
    // atan t / t = 1 - t2/3 + t4/5 - ..
    let mut sum = 0.0;
    for k in (0..ARC_TERMS).rev() {
        sum = 1.0 / f64::from(2 * k + 1) - square * sum;
    }
    4.0 * (quarter * sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_system_library() {
        for i in -1570..=1570 {
            let angle = f64::from(i) * 1e-3;
            let (s, c) = sin_cos(angle);
            assert!((s - angle.sin()).abs() < 5e-16, "sin {angle}");
            assert!((c - angle.cos()).abs() < 5e-16, "cos {angle}");
        }
        for i in -1480..=1480 {
            let angle = f64::from(i) * 1e-3;
            assert!((tan(angle) / angle.tan() - 1.0).abs() < 1e-14 || i == 0, "tan {angle}");
        }
    }

    #[test]
    fn exact_at_zero() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert_eq!((tan(0.0), atan2(0.0, 3.0), atan2(0.0, 0.0)), (0.0, 0.0, 0.0));
    }

    #[test]
    fn a_turn_by_any_angle_agrees_with_the_system_library() {
        for i in -2000..=2000 {
            let angle = f64::from(i) * 0.0117;
            let difference = rotation(angle).matrix() - Rotation2::new(angle).matrix();
            assert!(difference.abs().max() < 1e-14, "{angle}");
        }
    }

    #[test]
    fn the_angle_of_a_vector_agrees_with_the_system_library() {
        for i in -3141..=3141 {
            let angle = f64::from(i) * 1e-3;
            for length in [1e-9, 0.7, 3e8] {
                let (y, x) = (length * angle.sin(), length * angle.cos());
                assert!((atan2(y, x) - y.atan2(x)).abs() < 1e-15, "{angle} {length}");
            }
        }
        for (y, x) in [(0.0, -2.0), (5.0, 0.0), (-5.0, 0.0), (2.0, 2.0), (-2.0, 2.0), (1.0, -1.0), (1e-300, 1.0)] {
            let (own, system) = (atan2(y, x), f64::atan2(y, x));
            assert!((own - system).abs() <= 4.5e-16 * system.abs(), "{y} {x}: {own} {system}");
        }
    }

    #[test]
    fn every_platform_gives_these_bits() {
        // From the same formulas in another language with IEEE doubles.
        let bits = |value: f64| value.to_bits();
        assert_eq!(bits(atan2(-0.3, 0.7)), 0xbfd9_e9bf_3d20_dc73);
        assert_eq!(bits(atan2(0.9, -0.31)), 0x3ffe_70b1_d0e8_80b2);
        assert_eq!(bits(tan(0.61)), 0x3fe6_5d8b_1701_3edb);
        let turned = [0xbfdf_606e_ec8a_c71c, 0xbfeb_e3f2_dfd0_12d8, 0x3feb_e3f2_dfd0_12d8, 0xbfdf_606e_ec8a_c71c];
        assert_eq!(rotation(4.2).matrix().map(bits).as_slice(), turned);
    }
}
