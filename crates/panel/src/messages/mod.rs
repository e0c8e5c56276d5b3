//! Messages between the panel and its clients: docs/reference/panel-api.md. Lengths in millimetres, angles in degrees, times in
//! milliseconds, pixels of the raw images.

pub mod cameras;
pub mod info;
pub mod requests;
pub mod socket;
pub mod state;

use nalgebra::{Isometry3, Matrix6, Vector2, Vector3};
use pb3dp_geometry::{Frame, MonotonicTime, Pose};
use serde::Serialize;

/// A rigid transform: 4x4 row by row, translation in millimetres.
pub type Transform = [f64; 16];
/// A pixel.
pub type Pixel = [f64; 2];
/// Three numbers along or about x, y and z.
pub type Triple = [f64; 3];

/// Answer of a refused request.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorAnswer {
    /// One line: what, value, remedy.
    pub error: String,
    /// Code of the message.
    pub code: &'static str,
}

/// A transform in the units of the messages.
pub fn transform(isometry: &Isometry3<f64>) -> Transform {
    let matrix = isometry.to_homogeneous();
    let mut rows = [0.0; 16];
    for (index, value) in rows.iter_mut().enumerate() {
        let (row, column) = (index / 4, index % 4);
        let scale = if column == 3 && row < 3 { 1e3 } else { 1.0 };
        *value = matrix[(row, column)] * scale;
    }
    rows
}

/// The same for a pose.
pub fn transform_of<To: Frame, From: Frame>(pose: &Pose<To, From>) -> Transform {
    transform(pose.isometry())
}

/// Milliseconds on the run's clock, to the microsecond.
pub fn time_ms(at: MonotonicTime) -> f64 {
    (at.as_secs_f64() * 1e6).round() * 1e-3
}

/// Pixels.
pub fn pixels(points: &[Vector2<f64>]) -> Vec<Pixel> {
    points.iter().map(|point| [rounded(point.x), rounded(point.y)]).collect()
}

/// A pixel coordinate to the hundredth: the line of one outline then is a third as long.
fn rounded(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// Metres to millimetres.
pub fn millimetres(vector: Vector3<f64>) -> Triple {
    (vector * 1e3).into()
}

/// Radians to degrees.
pub fn degrees(vector: Vector3<f64>) -> Triple {
    vector.map(f64::to_degrees).into()
}

/// Standard deviations of a pose, millimetres and degrees; `None` if one is not finite.
pub fn sigmas(covariance: Option<&Matrix6<f64>>) -> Option<(Triple, Triple)> {
    let sigma = covariance?.diagonal().map(f64::sqrt);
    let is_finite = sigma.iter().all(|value| value.is_finite());
    is_finite.then(|| (millimetres(sigma.fixed_rows::<3>(0).into()), degrees(sigma.fixed_rows::<3>(3).into())))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    #[test]
    fn a_transform_is_written_row_by_row_in_millimetres() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let rows = transform(&Isometry3::from_parts(Translation3::new(0.1, 0.2, -0.3), turn));
        let expected = [0.0, -1.0, 0.0, 100.0, 1.0, 0.0, 0.0, 200.0, 0.0, 0.0, 1.0, -300.0, 0.0, 0.0, 0.0, 1.0];
        assert!(rows.iter().zip(&expected).all(|(is, should)| (is - should).abs() < 1e-9), "{rows:?}");
    }
}
