//! The Cramér-Rao bound of the position of a chessboard corner.
//!
//! Model of a pixel: `m + c E(l1) E(l2)`, with the signed distances `l1`, `l2` from the two edges and `E(l) = erf(l / (sqrt(2) s))`.
//! Seven unknowns: position, both edge directions, `m`, `c` and the blur `s`.

use nalgebra::{SMatrix, SVector, Vector2};

const UNKNOWNS: usize = 7;

/// The corner as the bound needs it.
pub struct Corner {
    pub at: Vector2<f64>,
    /// Unit vectors along the edges.
    pub edges: [Vector2<f64>; 2],
    /// Half the difference of the grey levels.
    pub half_contrast: f64,
    /// Blur of the lens and the area of a pixel, px.
    pub blur_px: f64,
    /// Standard deviation of a pixel, grey levels.
    pub noise_grey: f64,
}

/// Variance of the position, px^2, mean of both axes, from the pixels that a test accepts by their offset from the corner.
pub fn variance_px2(corner: &Corner, reach_px: f64, is_used: impl Fn(Vector2<f64>) -> bool) -> Option<f64> {
    let mut information = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    let reach = reach_px.ceil() as i32 + 1;
    for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
        let pixel = corner.at.map(f64::round) + Vector2::new(f64::from(dx), f64::from(dy));
        let offset = pixel - corner.at;
        if is_used(offset) {
            let by = derivatives(corner, &offset);
            information += by * by.transpose();
        }
    }
    let covariance = (information / corner.noise_grey.powi(2)).try_inverse()?;
    Some(0.5 * (covariance[(0, 0)] + covariance[(1, 1)])).filter(|variance| variance.is_finite() && *variance > 0.0)
}

fn derivatives(corner: &Corner, offset: &Vector2<f64>) -> SVector<f64, UNKNOWNS> {
    let s = corner.blur_px;
    let bell = |l: f64| (-0.5 * (l / s).powi(2)).exp() * 2.0 / (std::f64::consts::TAU.sqrt() * s);
    let step = |l: f64| erf(l / (std::f64::consts::SQRT_2 * s));
    let [normal_1, normal_2] = corner.edges.map(|edge| Vector2::new(-edge.y, edge.x));
    let [along_1, along_2] = corner.edges.map(|edge| edge.dot(offset));
    let (l1, l2) = (normal_1.dot(offset), normal_2.dot(offset));
    let (e1, e2, g1, g2) = (step(l1), step(l2), bell(l1), bell(l2));
    let c = corner.half_contrast;
    let by_position = -(normal_1 * (g1 * e2) + normal_2 * (e1 * g2)) * c;
    let by_blur = -c * (l1 / s * g1 * e2 + l2 / s * g2 * e1);
    SVector::from([by_position.x, by_position.y, c * g1 * e2 * along_1, c * e1 * g2 * along_2, 1.0, e1 * e2, by_blur])
}

/// Abramowitz and Stegun 7.1.26; error below 1.5e-7.
fn erf(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs());
    let series =
        ((((1.061_405_429 * t - 1.453_152_027) * t + 1.421_413_741) * t - 0.284_496_736) * t + 0.254_829_592) * t;
    (1.0 - series * (-x * x).exp()).copysign(x)
}
