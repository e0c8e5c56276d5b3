//! The group of rigid motions: exponential, logarithm, adjoint, Jacobians, interpolation.
//!
//! Tangent vectors are `[rho; phi]`: linear part first (metres), angular part second (radians). The functions here work
//! without frames; [`Pose`](crate::Pose) offers some of them with frames, where the types can check them. Formulas: Barfoot, *State Estimation for Robotics*,
//! section 7.1.

use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, Vector3, Vector6};

use crate::so3;

/// Below this angle (radians) the coefficients are computed from their series.
const SERIES_BELOW_RAD: f64 = 1.0;

/// The motion of a body that moves for one unit of time with the constant twist `xi = [rho; phi]` in its own axes.
#[inline]
pub fn exp(xi: &Vector6<f64>) -> Isometry3<f64> {
    let (rho, phi) = split(xi);
    Isometry3::from_parts(Translation3::from(so3::left_jacobian(&phi) * rho), so3::exp(&phi))
}

/// The twist `[rho; phi]` whose exponential is `a`; the norm of `phi` is at most pi.
pub fn log(a: &Isometry3<f64>) -> Vector6<f64> {
    let phi = so3::log(&a.rotation);
    join(&(so3::left_jacobian_inverse(&phi) * a.translation.vector), &phi)
}

/// The adjoint of a transform `a` from frame `f` to frame `t`: maps a tangent vector in `f` to one in `t`,
/// `a exp(xi) a^-1 = exp(adjoint(a) xi)`.
pub fn adjoint(a: &Isometry3<f64>) -> Matrix6<f64> {
    let rotation = a.rotation.to_rotation_matrix().into_inner();
    blocks(&rotation, &(so3::hat(&a.translation.vector) * rotation))
}

/// Left Jacobian of the exponential: `exp(xi + d) = exp(left_jacobian(xi) d) exp(xi)` to first order in `d`.
pub fn left_jacobian(xi: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = split(xi);
    blocks(&so3::left_jacobian(&phi), &coupling(&rho, &phi))
}

/// Inverse of [`left_jacobian`]; exists for angles below 2 pi.
pub fn left_jacobian_inverse(xi: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = split(xi);
    let inverse = so3::left_jacobian_inverse(&phi);
    blocks(&inverse, &(-inverse * coupling(&rho, &phi) * inverse))
}

/// Right Jacobian of the exponential: `exp(xi + d) = exp(xi) exp(right_jacobian(xi) d)` to first order in `d`.
pub fn right_jacobian(xi: &Vector6<f64>) -> Matrix6<f64> {
    left_jacobian(&-xi)
}

/// Inverse of [`right_jacobian`]; exists for angles below 2 pi.
pub fn right_jacobian_inverse(xi: &Vector6<f64>) -> Matrix6<f64> {
    left_jacobian_inverse(&-xi)
}

/// The motion a fraction `s` of the way from `a` to `b` along the connecting screw motion: `a exp(s log(a^-1 b))`.
///
/// `s` = 0 gives `a`, 1 gives `b`; values outside 0 to 1 extrapolate at the same constant twist.
pub fn interpolate(a: &Isometry3<f64>, b: &Isometry3<f64>, s: f64) -> Isometry3<f64> {
    a * exp(&(log(&(a.inverse() * b)) * s))
}

/// The parts `(rho, phi)` of a tangent vector.
#[inline]
pub fn split(xi: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (xi.fixed_rows::<3>(0).into_owned(), xi.fixed_rows::<3>(3).into_owned())
}

/// The tangent vector `[rho; phi]`.
#[inline]
pub fn join(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// `[diagonal, upper; 0, diagonal]`.
fn blocks(diagonal: &Matrix3<f64>, upper: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(upper);
    matrix
}

/// The upper right block of the left Jacobian (Barfoot, eq. 7.86b).
fn coupling(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Matrix3<f64> {
    let (p, r, x) = (so3::hat(phi), so3::hat(rho), phi.norm());
    let (pr, rp) = (p * r, r * p);
    let prp = pr * p;
    r * 0.5
        + (pr + rp + prp) * so3::angle_minus_sin(x)
        + (p * pr + rp * p - prp * 3.0) * fourth_order(x)
        + (prp * p + p * prp) * fifth_order(x)
}

/// `(x^2 + 2 cos x - 2) / (2 x^4)`.
fn fourth_order(x: f64) -> f64 {
    if x < SERIES_BELOW_RAD {
        return so3::alternating_series(x, 1.0 / 24.0, |n| 1.0 / ((2.0 * n + 3.0) * (2.0 * n + 4.0)));
    }
    (x * x + 2.0 * x.cos() - 2.0) / (2.0 * x.powi(4))
}

/// `(2 x - 3 sin x + x cos x) / (2 x^5)`.
fn fifth_order(x: f64) -> f64 {
    if x < SERIES_BELOW_RAD {
        return so3::alternating_series(x, 1.0 / 120.0, |n| (n + 1.0) / (n * (2.0 * n + 4.0) * (2.0 * n + 5.0)));
    }
    (2.0 * x - 3.0 * x.sin() + x * x.cos()) / (2.0 * x.powi(5))
}
