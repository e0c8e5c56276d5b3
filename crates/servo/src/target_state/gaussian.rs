//! One hypothesis about the target: state and error covariance, with prediction and correction.
//!
//! Error state, all in axes of `base`, in this order: position, rotation vector, velocity, angular velocity, acceleration,
//! angular acceleration. The true rotation is `exp(rotation vector) * estimate`. Error-state filters on rotations: J. Solà,
//! "Quaternion kinematics for the error-state Kalman filter", 2017, sections 5 to 7.

use nalgebra::{Cholesky, Const, Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_geometry::{Pose, se3, so3};

use super::measurement::BaseMeasurement;
use super::motion::AxisStep;

pub(super) const ERRORS: usize = 18;
pub(super) type ErrorVector = SVector<f64, ERRORS>;
pub(super) type ErrorMatrix = SMatrix<f64, ERRORS, ERRORS>;

/// First index of each part of the error state.
const ROTATION: usize = 3;
const RATE: usize = 6;
const ACCELERATION: usize = 12;

/// The mean of a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    pub base_from_model: Pose<Base, Model>,
    /// Of the model's origin and of the model: `[linear; angular]`, m/s and rad/s.
    pub rate: Vector6<f64>,
    /// m/s^2 and rad/s^2.
    pub acceleration: Vector6<f64>,
}

/// State and covariance of its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gaussian {
    pub state: State,
    pub covariance: ErrorMatrix,
}

/// Innovation of a measurement.
#[derive(Clone, Debug)]
pub(super) struct Innovation {
    residual: Vector6<f64>,
    noise: Matrix6<f64>,
    factor: Cholesky<f64, Const<6>>,
    /// Squared Mahalanobis distance.
    pub nis: f64,
    pub log_likelihood: f64,
}

impl State {
    /// The state corrected by an error.
    pub(super) fn plus(&self, error: &ErrorVector) -> Self {
        let turn = so3::exp(&error.fixed_rows::<3>(ROTATION).into_owned());
        let mut rotation = turn * self.base_from_model.rotation();
        rotation.renormalize();
        let position_m = self.base_from_model.translation_m() + error.fixed_rows::<3>(0);
        Self {
            base_from_model: Pose::from_parts(position_m, rotation),
            rate: self.rate + error.fixed_rows::<6>(RATE),
            acceleration: self.acceleration + error.fixed_rows::<6>(ACCELERATION),
        }
    }

    /// The error from `other` to this state.
    pub(super) fn minus(&self, other: &Self) -> ErrorVector {
        let mut error = ErrorVector::zeros();
        error.fixed_rows_mut::<6>(0).copy_from(&pose_difference(&self.base_from_model, &other.base_from_model));
        error.fixed_rows_mut::<6>(RATE).copy_from(&(self.rate - other.rate));
        error.fixed_rows_mut::<6>(ACCELERATION).copy_from(&(self.acceleration - other.acceleration));
        error
    }

    /// The state after a step with these transitions, and the rotation vector of the step.
    pub(super) fn after(&self, l: &Matrix3<f64>, a: &Matrix3<f64>) -> (Self, Vector3<f64>) {
        let (velocity, spin) = se3::split(&self.rate);
        let (push, twirl) = se3::split(&self.acceleration);
        let shift = velocity * l[(0, 1)] + push * l[(0, 2)];
        // Last term: the axis turns during the rotation (Magnus expansion to the third order in time).
        let turn = spin * a[(0, 1)] + twirl * a[(0, 2)] + twirl.cross(&spin) * (a[(0, 1)].powi(3) / 12.0);
        let mut rotation = so3::exp(&turn) * self.base_from_model.rotation();
        rotation.renormalize();
        let state = Self {
            base_from_model: Pose::from_parts(self.base_from_model.translation_m() + shift, rotation),
            rate: se3::join(&(velocity * l[(1, 1)] + push * l[(1, 2)]), &(spin * a[(1, 1)] + twirl * a[(1, 2)])),
            acceleration: se3::join(&(push * l[(2, 2)]), &(twirl * a[(2, 2)])),
        };
        (state, turn)
    }
}

impl Gaussian {
    /// The prediction after a step.
    pub(super) fn predicted(&self, linear: &AxisStep, angular: &AxisStep) -> Self {
        let (state, turn) = self.state.after(&linear.transition, &angular.transition);
        let spreads = [self.spread(0, linear), self.spread(ROTATION, angular)];
        let half = times_transition(&self.covariance, linear, angular, &turn);
        let covariance = times_transition(&half.transpose(), linear, angular, &turn);
        Self { state, covariance: symmetric(&(covariance + noise([linear, angular], &spreads, &turn))) }
    }

    /// Distribution of the noise of a part over the directions: uniform while the direction of motion is unknown, then mostly along
    /// it. Computed from the second moment of the velocity (estimate and uncertainty), in units of its largest eigenvalue.
    fn spread(&self, part: usize, step: &AxisStep) -> Matrix3<f64> {
        let velocity = self.state.rate.fixed_rows::<3>(part).into_owned();
        let uncertainty = self.covariance.fixed_view::<3, 3>(RATE + part, RATE + part).into_owned();
        let moment = velocity * velocity.transpose() + uncertainty;
        let largest = velocity.norm_squared() + uncertainty.trace() / 3.0;
        let even = if largest > 0.0 { step.across_share } else { 1.0 };
        Matrix3::identity() * even + moment * ((1.0 - even) / largest.max(f64::MIN_POSITIVE))
    }

    /// Pose and its error covariance (axes of `base`) after a step; the rest of the state without covariance.
    pub(super) fn predicted_pose(&self, linear: &AxisStep, angular: &AxisStep) -> (State, Matrix6<f64>) {
        let (state, turn) = self.state.after(&linear.transition, &angular.transition);
        let half = times_pose_transition(&self.covariance, linear, angular, &turn);
        let mut covariance = times_pose_transition(&half.transpose(), linear, angular, &turn);
        let jacobian = so3::left_jacobian(&turn);
        let shifting = self.spread(0, linear) * linear.noise[(0, 0)];
        let turning = jacobian * self.spread(ROTATION, angular) * jacobian.transpose() * angular.noise[(0, 0)];
        for (first, block) in [(0, shifting), (ROTATION, turning)] {
            let mut sum = covariance.fixed_view_mut::<3, 3>(first, first);
            sum += block;
        }
        (state, (covariance + covariance.transpose()) * 0.5)
    }

    /// Innovation of a measurement against this prediction. `None` if the covariances are not positive definite.
    pub(super) fn innovation(&self, measured: &BaseMeasurement) -> Option<Innovation> {
        let residual = pose_difference(&measured.base_from_model, &self.state.base_from_model);
        // Noise rotates the measured pose, while the residual is a logarithm at the predicted one: the inverse Jacobian maps
        // between them.
        let noise = turned_by(&measured.covariance, &so3::left_jacobian_inverse(&rotation_part(&residual)));
        let factor = (self.covariance.fixed_view::<6, 6>(0, 0) + noise).cholesky()?;
        let nis = residual.dot(&factor.solve(&residual));
        // An overflow means a large distance, not a bad covariance.
        let nis = if nis.is_nan() { f64::INFINITY } else { nis };
        let log_determinant: f64 = 2.0 * factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum::<f64>();
        let log_likelihood = -0.5 * (nis + log_determinant);
        log_determinant.is_finite().then_some(Innovation { residual, noise, factor, nis, log_likelihood })
    }

    /// The state after the measurement update; the covariance in Joseph's form.
    pub(super) fn updated(&self, innovation: &Innovation) -> Self {
        let pose_rows = self.covariance.fixed_rows::<6>(0).into_owned();
        let gain = innovation.factor.solve(&pose_rows).transpose();
        let error = gain * innovation.residual;
        let half = self.covariance - gain * pose_rows;
        let columns = half.fixed_columns::<6>(0).into_owned();
        let covariance = half - columns * gain.transpose() + gain * innovation.noise * gain.transpose();
        let state = self.state.plus(&error);
        // The remaining error refers to the new rotation.
        let jacobian = so3::left_jacobian(&error.fixed_rows::<3>(ROTATION).into_owned());
        let mut covariance = symmetric(&covariance);
        let rows = jacobian * covariance.fixed_rows::<3>(ROTATION);
        covariance.fixed_rows_mut::<3>(ROTATION).copy_from(&rows);
        let columns = covariance.fixed_columns::<3>(ROTATION) * jacobian.transpose();
        covariance.fixed_columns_mut::<3>(ROTATION).copy_from(&columns);
        Self { state, covariance: symmetric(&covariance) }
    }

    pub(super) fn is_finite(&self) -> bool {
        let state = &self.state;
        state.base_from_model.is_finite()
            && state.rate.iter().chain(state.acceleration.iter()).chain(self.covariance.iter()).all(|x| x.is_finite())
    }
}

/// Position and rotation vector from one pose to another, in axes of `base`.
pub(super) fn pose_difference(to: &Pose<Base, Model>, from: &Pose<Base, Model>) -> Vector6<f64> {
    let turn = so3::log(&(to.rotation() * from.rotation().inverse()));
    se3::join(&(to.translation_m() - from.translation_m()), &turn)
}

fn rotation_part(difference: &Vector6<f64>) -> Vector3<f64> {
    difference.fixed_rows::<3>(ROTATION).into_owned()
}

/// A matrix times the transposed error transition, column by column, because most of the transition is zero.
fn times_transition(matrix: &ErrorMatrix, linear: &AxisStep, angular: &AxisStep, turn: &Vector3<f64>) -> ErrorMatrix {
    let mut product = ErrorMatrix::zeros();
    product.fixed_columns_mut::<6>(0).copy_from(&times_pose_transition(matrix, linear, angular, turn));
    for (part, transition) in [(0, &linear.transition), (ROTATION, &angular.transition)] {
        let columns = |block: usize| matrix.fixed_columns::<3>(6 * block + part);
        let rate = columns(1) * transition[(1, 1)] + columns(2) * transition[(1, 2)];
        product.fixed_columns_mut::<3>(RATE + part).copy_from(&rate);
        product.fixed_columns_mut::<3>(ACCELERATION + part).copy_from(&(columns(2) * transition[(2, 2)]));
    }
    product
}

/// The columns of this product that belong to the pose.
fn times_pose_transition<const ROWS: usize>(
    matrix: &SMatrix<f64, ROWS, ERRORS>,
    linear: &AxisStep,
    angular: &AxisStep,
    turn: &Vector3<f64>,
) -> SMatrix<f64, ROWS, 6> {
    let columns = |first: usize| matrix.fixed_columns::<3>(first);
    let moved = |part: usize, transition: &Matrix3<f64>| {
        columns(RATE + part) * transition[(0, 1)] + columns(ACCELERATION + part) * transition[(0, 2)]
    };
    let turned = so3::exp(turn).to_rotation_matrix().into_inner().transpose();
    let position = columns(0) + moved(0, &linear.transition);
    let rotation =
        columns(ROTATION) * turned + moved(ROTATION, &angular.transition) * so3::left_jacobian(turn).transpose();
    let mut product = SMatrix::<f64, ROWS, 6>::zeros();
    product.fixed_columns_mut::<3>(0).copy_from(&position);
    product.fixed_columns_mut::<3>(ROTATION).copy_from(&rotation);
    product
}

/// Process noise of a step for both parts, distributed over the directions.
fn noise(steps: [&AxisStep; 2], spreads: &[Matrix3<f64>; 2], turn: &Vector3<f64>) -> ErrorMatrix {
    let turned = [Matrix3::identity(), so3::left_jacobian(turn)];
    let mut noise = ErrorMatrix::zeros();
    for part in 0..2 {
        for row in 0..3 {
            for column in 0..3 {
                let left = if row == 0 { turned[part] } else { Matrix3::identity() };
                let right = if column == 0 { turned[part].transpose() } else { Matrix3::identity() };
                let block = left * spreads[part] * right * steps[part].noise[(row, column)];
                noise.fixed_view_mut::<3, 3>(6 * row + 3 * part, 6 * column + 3 * part).copy_from(&block);
            }
        }
    }
    noise
}

/// The covariance of position and rotation vector with the rotation vector mapped by `map`.
fn turned_by(covariance: &Matrix6<f64>, map: &Matrix3<f64>) -> Matrix6<f64> {
    let mut turned = *covariance;
    let rows = map * turned.fixed_rows::<3>(ROTATION);
    turned.fixed_rows_mut::<3>(ROTATION).copy_from(&rows);
    let columns = turned.fixed_columns::<3>(ROTATION) * map.transpose();
    turned.fixed_columns_mut::<3>(ROTATION).copy_from(&columns);
    (turned + turned.transpose()) * 0.5
}

fn symmetric(matrix: &ErrorMatrix) -> ErrorMatrix {
    (matrix + matrix.transpose()) * 0.5
}
