//! Poses and their covariances in the units of the JSON lines.

use nalgebra::Matrix6;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::Frame;

/// A covariance of `xi = (rho, phi)`, row by row, `rho` in millimetres.
pub fn covariance_mm(covariance: &Matrix6<f64>) -> Vec<f64> {
    let unit = |i: usize| if i < 3 { 1e3 } else { 1.0 };
    (0..36).map(|k| covariance[(k / 6, k % 6)] * unit(k / 6) * unit(k % 6)).collect()
}

/// The homogeneous matrix of a pose, row by row, translation in millimetres.
pub fn row_major_mm<To: Frame, From: Frame>(pose: &Pose<To, From>) -> [f64; 16] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|k| m[(k / 4, k % 4)] * if k % 4 == 3 && k < 12 { 1e3 } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_geometry::frames::{CamLeft, Model};

    use super::*;

    #[test]
    fn matrices_are_row_major_in_millimetres() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let m = row_major_mm(&Pose::<CamLeft, Model>::from_parts(Vector3::new(0.1, -0.2, 0.5), turn));
        let expected = [0.0, -1.0, 0.0, 100.0, 1.0, 0.0, 0.0, -200.0, 0.0, 0.0, 1.0, 500.0, 0.0, 0.0, 0.0, 1.0];
        assert!(m.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{m:?}");
    }
}
