//! A measured pose, with a covariance conditioned for the filter.

use nalgebra::{Matrix6, SymmetricEigen, Vector6};
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_geometry::{MonotonicTime, Pose};

use super::config::MeasurementConfig;

/// A measured pose of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseMeasurement {
    /// Time of exposure.
    pub at: MonotonicTime,
    /// Measured pose.
    pub base_from_model: Pose<Base, Model>,
    /// Covariance of `xi = [rho; phi]` (metres, radians; axes of `model`) in `true = measured * exp(xi)`.
    ///
    /// An unobserved direction has a large, finite variance. A direction with a standard deviation above 1e5 times the configured
    /// minimum counts as unobserved.
    pub covariance: Matrix6<f64>,
}

/// A measurement in the form of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BaseMeasurement {
    pub at: MonotonicTime,
    pub base_from_model: Pose<Base, Model>,
    /// Of position and rotation vector, both in axes of `base`.
    pub covariance: Matrix6<f64>,
}

/// Largest distinguished standard deviation as a multiple of the minimum. Beyond it, rounding would destroy the observed directions
/// of the covariance.
const SIGMA_RANGE: f64 = 1e5;
/// Tolerance for asymmetry and negative eigenvalues, as a share of the largest entry.
const ROUNDING: f64 = 1e-6;
const SWEEPS: usize = 200;

impl BaseMeasurement {
    /// Scales the covariance, bounds it from below and above, and transforms it to `base`. `None` if it is not a covariance.
    pub(super) fn new(config: &MeasurementConfig, measurement: &PoseMeasurement) -> Option<Self> {
        let covariance = bounded(config, &measurement.covariance)?;
        let rotation = measurement.base_from_model.rotation_matrix();
        let mut turned = Matrix6::zeros();
        for (row, column) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            let block = rotation * covariance.fixed_view::<3, 3>(row, column) * rotation.transpose();
            turned.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        }
        let covariance = (turned + turned.transpose()) * 0.5;
        Some(Self { at: measurement.at, base_from_model: measurement.base_from_model, covariance })
    }
}

/// The scaled covariance with all eigenvalues (in units of the minimum standard deviations) between 1 and a bound.
fn bounded(config: &MeasurementConfig, covariance: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let (position, orientation) = (config.position_sigma_min_m, config.orientation_sigma_min_rad);
    let least = Vector6::new(position, position, position, orientation, orientation, orientation);
    let scaled = covariance.component_div(&(least * least.transpose())) * config.covariance_factor;
    let largest = scaled.amax();
    if !largest.is_finite() || scaled.iter().any(|x| !x.is_finite()) {
        return None;
    }
    if (scaled - scaled.transpose()).amax() > ROUNDING * largest || (0..6).any(|i| scaled[(i, i)] < 0.0) {
        return None;
    }
    let eigen = SymmetricEigen::try_new((scaled + scaled.transpose()) * 0.5, f64::EPSILON, SWEEPS)?;
    if eigen.eigenvalues.min() < -ROUNDING * largest {
        return None;
    }
    let values = eigen.eigenvalues.map(|value| value.clamp(1.0, SIGMA_RANGE * SIGMA_RANGE));
    let bounded = eigen.eigenvectors * Matrix6::from_diagonal(&values) * eigen.eigenvectors.transpose();
    Some(bounded.component_mul(&(least * least.transpose())))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    const CONFIG: MeasurementConfig =
        MeasurementConfig { covariance_factor: 2.0, position_sigma_min_m: 1e-4, orientation_sigma_min_rad: 1e-3 };

    fn measured(covariance: Matrix6<f64>) -> PoseMeasurement {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -0.7, 1.1));
        let base_from_model = Pose::from_parts(Vector3::new(0.6, -0.1, 0.3), rotation);
        PoseMeasurement { at: MonotonicTime::from_nanos(5), base_from_model, covariance }
    }

    /// A covariance with all correlations, well above the minimum.
    fn correlated() -> Matrix6<f64> {
        let root = Matrix6::from_fn(|i, j| ((i * 7 + j * 3) as f64).sin() * if i < 3 { 5e-4 } else { 6e-3 });
        root * root.transpose() + Matrix6::from_diagonal(&Vector6::new(3e-7, 3e-7, 3e-7, 3e-5, 3e-5, 3e-5))
    }

    #[test]
    fn a_covariance_within_the_bounds_is_scaled_and_turned() {
        let measurement = measured(correlated());
        let found = BaseMeasurement::new(&CONFIG, &measurement).unwrap().covariance;
        // For position and rotation vector alike, the vector in base axes is the rotated vector in model axes.
        let direction = Vector6::new(0.3, -0.2, 0.5, 0.7, 0.1, -0.4);
        let inverse = measurement.base_from_model.rotation().inverse();
        let (linear, angular) =
            (inverse * direction.fixed_rows::<3>(0).into_owned(), inverse * direction.fixed_rows::<3>(3).into_owned());
        let in_model = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        let expected = 2.0 * in_model.dot(&(correlated() * in_model));
        assert!((direction.dot(&(found * direction)) / expected - 1.0).abs() < 1e-9);
    }

    #[test]
    fn no_direction_is_trusted_more_than_the_least_deviation() {
        let found = BaseMeasurement::new(&CONFIG, &measured(Matrix6::zeros())).unwrap().covariance;
        let least = Matrix6::from_diagonal(&Vector6::new(1e-8, 1e-8, 1e-8, 1e-6, 1e-6, 1e-6));
        assert!((found - least).amax() < 1e-18, "{found}");
    }

    #[test]
    fn a_direction_that_is_not_observed_leaves_the_others_alone() {
        let along = Vector6::new(0.6, 0.0, 0.8, 0.0, 0.0, 0.0);
        let across = Vector6::new(0.8, 0.0, -0.6, 0.0, 0.0, 0.0);
        let covariance = correlated() + along * along.transpose() * 1e6;
        let mut measurement = measured(covariance);
        measurement.base_from_model = Pose::from_translation(Vector3::new(0.1, 0.2, 0.3));
        let found = BaseMeasurement::new(&CONFIG, &measurement).unwrap().covariance;
        assert!(found.dot(&(along * along.transpose())) > 1.0);
        let expected = 2.0 * across.dot(&(correlated() * across));
        assert!((across.dot(&(found * across)) / expected - 1.0).abs() < 0.02, "{found} {expected}");
        assert!(found.cholesky().is_some());
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let refused = |change: fn(&mut Matrix6<f64>)| {
            let mut covariance = correlated();
            change(&mut covariance);
            BaseMeasurement::new(&CONFIG, &measured(covariance)).is_none()
        };
        assert!(!refused(|_| {}));
        assert!(refused(|c| c[(2, 3)] = f64::NAN));
        assert!(refused(|c| c[(4, 4)] = f64::INFINITY));
        assert!(refused(|c| c[(0, 5)] += 1e-4), "not symmetric");
        assert!(refused(|c| c[(1, 1)] = -c[(1, 1)]), "negative variance");
        assert!(
            refused(|c| {
                c[(0, 1)] = 1e-3;
                c[(1, 0)] = 1e-3;
            }),
            "correlation above one"
        );
    }
}
