//! Tilts that a search range allows.

use nalgebra::Vector3;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;

/// The tilts that a search range allows.
#[derive(Clone, Copy, Debug)]
pub(super) struct TiltLimits {
    tangent: f64,
    sine: f64,
}

impl TiltLimits {
    pub(super) fn new(range: &SearchRange) -> Self {
        Self { tangent: range.tilt_max_rad.tan(), sine: range.tilt_max_rad.sin() }
    }

    /// Whether the tilt of an inverse-depth plane in `cam_left` is within the limits.
    pub(super) fn allow(&self, q: &Vector3<f64>) -> bool {
        q.z > 0.0 && q.x.abs() <= self.tangent * q.z && q.y.abs() <= self.sine * q.norm()
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;

    use super::*;

    #[test]
    fn tilts_beyond_the_range_are_not_allowed() {
        let limits = TiltLimits::new(&SearchRange::new(0.3, 0.9, 0.5).unwrap());
        let ray = Vector3::new(0.1, 0.05, 1.0);
        for (theta_x_rad, theta_y_rad, allowed) in
            [(0.49, 0.0, true), (0.51, 0.1, false), (-0.3, -0.49, true), (0.2, 0.52, false)]
        {
            let psi = PlaneHypothesis { z_m: 0.5, theta_x_rad, theta_y_rad };
            assert_eq!(limits.allow(&psi.inverse_depth_plane(&ray).unwrap()), allowed);
        }
    }
}
