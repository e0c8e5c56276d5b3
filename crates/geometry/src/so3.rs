//! The rotation group: exponential, logarithm, Jacobians.
//!
//! A rotation vector `phi` is axis times angle, radians. The Jacobians relate small changes of `phi` to small rotations:
//! `exp(phi + d) = exp(left_jacobian(phi) d) exp(phi) = exp(phi) exp(right_jacobian(phi) d)` to first order in `d`. Formulas:
//! Barfoot, *State Estimation for Robotics*, section 7.1. Where the closed forms would lose digits, series replace them, so
//! that every function is accurate to about 1e-14 from 0 to pi.

use nalgebra::{Matrix3, Quaternion, Unit, UnitQuaternion, Vector3};

/// Below this angle (radians) the closed forms of the coefficients lose more digits than their series.
const SERIES_BELOW_RAD: f64 = 1.0;
/// As above, for the coefficient of the inverse Jacobian, whose series converges more slowly.
const INVERSE_SERIES_BELOW_RAD: f64 = 0.5;

/// The skew-symmetric matrix of `v`: `hat(v) * w == v.cross(&w)`.
#[inline]
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// Rotation by the rotation vector `phi` (radians, any length).
#[inline]
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half_rad = 0.5 * phi.norm();
    let sinc = if half_rad < 1e-5 { 1.0 - half_rad * half_rad / 6.0 } else { half_rad.sin() / half_rad };
    // Normalising removes the last rounding error; the norm is 1 within a few ulp, so it cannot fail.
    Unit::new_normalize(Quaternion::from_parts(half_rad.cos(), phi * (0.5 * sinc)))
}

/// The rotation vector of `rotation`, radians, norm at most pi.
///
/// Computed from the quaternion with an arctangent, so it keeps full precision near 0 and near pi. At exactly pi both `phi` and
/// `-phi` are correct; one of them is returned.
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = if rotation.w < 0.0 { -rotation.into_inner() } else { rotation.into_inner() };
    let sin_half = q.imag().norm();
    if sin_half < 1e-12 {
        return q.imag() * (2.0 / q.w);
    }
    q.imag() * (2.0 * sin_half.atan2(q.w) / sin_half)
}

/// Left Jacobian of the exponential at `phi`.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let hat_phi = hat(phi);
    let angle_rad = phi.norm();
    Matrix3::identity() + hat_phi * one_minus_cos(angle_rad) + hat_phi * hat_phi * angle_minus_sin(angle_rad)
}

/// Inverse of [`left_jacobian`]; exists for angles below 2 pi.
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let hat_phi = hat(phi);
    Matrix3::identity() - hat_phi * 0.5 + hat_phi * hat_phi * inverse_coefficient(phi.norm())
}

/// Right Jacobian of the exponential at `phi`: the left one at `-phi`.
pub fn right_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-phi)
}

/// Inverse of [`right_jacobian`]; exists for angles below 2 pi.
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(&-phi)
}

/// `(1 - cos x) / x^2`.
#[inline]
pub(crate) fn one_minus_cos(x: f64) -> f64 {
    if x < 1e-5 {
        return 0.5 - x * x / 24.0;
    }
    let sinc_half = (0.5 * x).sin() / x;
    2.0 * sinc_half * sinc_half
}

/// `(x - sin x) / x^3`.
#[inline]
pub(crate) fn angle_minus_sin(x: f64) -> f64 {
    if x < SERIES_BELOW_RAD {
        return alternating_series(x, 1.0 / 6.0, |n| 1.0 / ((2.0 * n + 2.0) * (2.0 * n + 3.0)));
    }
    (x - x.sin()) / (x * x * x)
}

/// Sum of an alternating series in `x^2` with first term `first`; its `n`-th coefficient is `ratio(n)` times the previous one.
/// Ten terms reach rounding for `x` up to 1 if the ratios decrease like `1 / n^2`.
pub(crate) fn alternating_series(x: f64, first: f64, ratio: impl Fn(f64) -> f64) -> f64 {
    let (mut term, mut sum) = (first, first);
    for n in 1..10 {
        term *= -x * x * ratio(f64::from(n));
        sum += term;
    }
    sum
}

/// `(1 - (x / 2) cot(x / 2)) / x^2`.
fn inverse_coefficient(x: f64) -> f64 {
    if x < INVERSE_SERIES_BELOW_RAD {
        // Bernoulli numbers divided by factorials.
        const COEFFICIENTS: [f64; 7] = [
            1.0 / 12.0,
            1.0 / 720.0,
            1.0 / 30_240.0,
            1.0 / 1_209_600.0,
            1.0 / 47_900_160.0,
            691.0 / 1_307_674_368_000.0,
            1.0 / 74_724_249_600.0,
        ];
        return COEFFICIENTS.iter().rev().fold(0.0, |sum, c| sum * x * x + c);
    }
    (1.0 - 0.5 * x * (0.5 * x).cos() / (0.5 * x).sin()) / (x * x)
}
