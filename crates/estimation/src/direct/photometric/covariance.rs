//! The covariance of a refined plane.

use nalgebra::{Matrix3, Matrix4, Vector2, Vector4};

/// Covariance of `(d0, du, dv)` from the scores of blocks of points: `H^-1 M H^-1`, where `M` sums up the outer products of
/// what the blocks pull. Noise may be correlated within a block.
pub(super) fn sandwich(
    matrix: &Matrix4<f64>,
    scores: &[Vec<f32>; 4],
    ends: &[usize],
    _places: &[(u32, u32)],
    row_information: f64,
) -> Option<Matrix3<f64>> {
    let inverse = matrix.try_inverse()?;
    let mut middle = Matrix4::zeros();
    let mut first = 0;
    for &end in ends {
        let pull: [f64; 4] = std::array::from_fn(|k| scores[k][first..end].iter().map(|s| f64::from(*s)).sum());
        let pull = Vector4::from(pull);
        middle += pull * pull.transpose();
        first = end;
    }
    let blocks = ends.len() as f64;
    middle *= blocks / (blocks - 6.0).max(1.0);
    middle[(3, 3)] += row_information;
    let full = inverse * middle * inverse;
    Some(full.fixed_view::<3, 3>(0, 0).into_owned())
}

/// From pixels of a level to full pixels.
pub(super) fn at_full_size(covariance: &Matrix3<f64>, scale: f64) -> Matrix3<f64> {
    let s = Matrix3::from_diagonal(&nalgebra::Vector3::new(scale, 1.0, 1.0));
    s * covariance * s
}

/// The covariance of a plane described `by` further on.
pub(super) fn moved(covariance: &Matrix3<f64>, by: &Vector2<f64>) -> Matrix3<f64> {
    let m = Matrix3::new(1.0, by.x, by.y, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    m * covariance * m.transpose()
}

/// What an error of calibration of `sigma_px` at the centre, and as much over half the region's side, leaves.
pub(super) fn calibration(sigma_px: f64, half_px: &Vector2<f64>) -> Matrix3<f64> {
    let slope = |half: f64| (sigma_px / half.max(1.0)).powi(2);
    Matrix3::from_diagonal(&nalgebra::Vector3::new(sigma_px * sigma_px, slope(half_px.x), slope(half_px.y)))
}
