//! The rotation group: exponential, logarithm, Jacobians.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// The skew-symmetric matrix of `v`: `hat(v) * w == v.cross(&w)`.
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// Rotation by the rotation vector `phi` (radians).
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(*phi)
}

/// The rotation vector of `rotation`, norm at most pi.
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    rotation.scaled_axis()
}
