//! Hand-eye adjustment: corners of all stops in both cameras, and the arm poses with their own noise, by least squares.
//!
//! Levenberg-Marquardt. The corrections of the arm poses are eliminated stop by stop (Schur complement, as in `crate::adjust`),
//! so the reduced system has 12 to 20 unknowns for any number of stops.

use nalgebra::{DMatrix, DVector, Isometry3, Vector6};
use pb3dp_geometry::se3;

use super::HandEyeError;
use super::model::{LOCAL, POSE, SCALES, Setting, State, StopObservation};

const STEPS_MAX: usize = 100;
/// Initial damping, and the damping at which the adjustment gives up.
const DAMPING: [f64; 2] = [1e-6, 1e12];
/// Relative cost increase that counts as rounding; such an iteration is accepted.
const DECREASE_MIN: f64 = 1e-12;
/// The adjustment ends when an iteration lowers the cost by a smaller share.
const SETTLED: f64 = 1e-10;
/// Smallest eigenvalue of the scaled information, as a share of the largest, for the parameters to be determined.
const DETERMINED_MIN: f64 = 1e-11;

/// The normal equations of one stop.
#[derive(Clone)]
struct StopEquations {
    shared: DMatrix<f64>,
    shared_gradient: DVector<f64>,
    mixed: DMatrix<f64>,
    arms: DMatrix<f64>,
    arms_gradient: DVector<f64>,
    cost: f64,
}

/// The result of an adjustment.
#[derive(Clone)]
pub(super) struct Adjusted {
    pub state: State,
    /// Twice the cost: corner errors over their variance, and arm corrections over theirs.
    pub chi2: f64,
    /// Contribution of each stop to the information of the shared parameters.
    pub information: Vec<DMatrix<f64>>,
    /// Gradient contribution of each stop; the sum is zero.
    pub gradients: Vec<DVector<f64>>,
}

impl Adjusted {
    /// The information of all stops except the given one, or of all stops.
    pub(super) fn information_without(&self, stop: Option<usize>) -> DMatrix<f64> {
        let count = self.information.first().map_or(0, DMatrix::nrows);
        let others = self.information.iter().enumerate().filter(|(index, _)| Some(*index) != stop);
        others.fold(DMatrix::zeros(count, count), |sum, (_, information)| sum + information)
    }

    /// The inverse of [`Self::information_without`].
    ///
    /// # Errors
    /// The name of a parameter that is not determined.
    pub(super) fn covariance_without(
        &self,
        stop: Option<usize>,
        setting: &Setting<'_>,
    ) -> Result<DMatrix<f64>, HandEyeError> {
        let information = self.information_without(stop);
        let names = self.state.shared_names(setting);
        let undetermined = |index: usize| HandEyeError::Undetermined { parameter: names[index].clone() };
        let scale = information.diagonal().map(|value| 1.0 / value.sqrt());
        if let Some(index) = scale.iter().position(|value| !value.is_finite()) {
            return Err(undetermined(index));
        }
        let scale = DMatrix::from_diagonal(&scale);
        let scaled = &scale * &information * &scale;
        let eigen = scaled.symmetric_eigen();
        let (least, greatest) = (eigen.eigenvalues.imin(), eigen.eigenvalues.max());
        let share = eigen.eigenvalues[least] / greatest;
        if !share.is_finite() || share < DETERMINED_MIN {
            return Err(undetermined(eigen.eigenvectors.column(least).icamax()));
        }
        let inverse = eigen.eigenvalues.map(|value| 1.0 / value);
        let inverse = &eigen.eigenvectors * DMatrix::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        Ok(&scale * inverse * &scale)
    }
}

/// The correction of an arm pose.
fn correction(measured: &Isometry3<f64>, corrected: &Isometry3<f64>) -> Vector6<f64> {
    se3::log(&(measured.inverse() * corrected))
}

/// Half the sum of the squared errors over their variances.
fn cost(state: &State, stops: &[StopObservation<'_>], setting: &Setting<'_>) -> f64 {
    let of = |(stop, arms): (&StopObservation<'_>, &Vec<Isometry3<f64>>)| {
        let squares = stop.squares(setting, &state.cam_from_board(arms), state.scales);
        let corrections = stop.arms().into_iter().zip(arms).map(|(measured, arm)| correction(&measured, arm));
        let of_arm = |(arm, by): (usize, Vector6<f64>)| 0.5 * by.dot(&(stop.robot_information(arm, setting) * by));
        let robot: f64 = corrections.enumerate().map(of_arm).sum();
        0.5 * squares / setting.corner_sigma_px.powi(2) + robot
    };
    stops.iter().zip(&state.arms).map(of).sum()
}

fn equations(state: &State, index: usize, stop: &StopObservation<'_>, setting: &Setting<'_>) -> Option<StopEquations> {
    let arms = &state.arms[index];
    let corners = stop.corners(setting, &state.cam_from_board(arms), state.scales)?;
    let weight = 1.0 / setting.corner_sigma_px.powi(2);
    let links = state.links(arms);
    let poses = links.shared.ncols();
    let mut by_shared = DMatrix::zeros(LOCAL, state.shared_count(setting));
    by_shared.view_mut((0, 0), (POSE, poses)).copy_from(&links.shared);
    if setting.scales_free {
        by_shared.view_mut((POSE, poses), (SCALES, SCALES)).fill_with_identity();
    }
    let mut by_arms = DMatrix::zeros(LOCAL, links.arms.ncols());
    by_arms.view_mut((0, 0), (POSE, links.arms.ncols())).copy_from(&links.arms);
    let (information, gradient) = (corners.information * weight, corners.gradient * weight);
    let half = by_shared.transpose() * information;
    let mut equations = StopEquations {
        shared: &half * &by_shared,
        shared_gradient: by_shared.transpose() * gradient,
        mixed: half * &by_arms,
        arms: by_arms.transpose() * information * &by_arms,
        arms_gradient: by_arms.transpose() * gradient,
        cost: 0.5 * corners.squares * weight,
    };
    for (arm, (measured, corrected)) in stop.arms().iter().zip(arms).enumerate() {
        let (by, information) = (correction(measured, corrected), stop.robot_information(arm, setting));
        let jacobian = se3::right_jacobian_inverse(&by);
        let half = jacobian.transpose() * information;
        let mut block = equations.arms.fixed_view_mut::<POSE, POSE>(POSE * arm, POSE * arm);
        block += half * jacobian;
        let mut rows = equations.arms_gradient.fixed_rows_mut::<POSE>(POSE * arm);
        rows += half * by;
        equations.cost += 0.5 * by.dot(&(information * by));
    }
    Some(equations)
}

/// The equations of a stop with its arm corrections eliminated.
struct Eliminated {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Step of the arm corrections, and its derivative with respect to the shared parameters.
    own: DVector<f64>,
    follows: DMatrix<f64>,
}

fn eliminate(equations: &StopEquations, damping: f64) -> Option<Eliminated> {
    let mut arms = equations.arms.clone();
    for n in 0..arms.nrows() {
        arms[(n, n)] *= 1.0 + damping;
    }
    let factor = arms.cholesky()?;
    let follows = -factor.solve(&equations.mixed.transpose());
    let own = -factor.solve(&equations.arms_gradient);
    Some(Eliminated {
        information: &equations.shared + &equations.mixed * &follows,
        gradient: &equations.shared_gradient + &equations.mixed * &own,
        own,
        follows,
    })
}

/// The state after a damped step.
fn next(state: &State, stops: &[StopEquations], damping: f64) -> Option<State> {
    let eliminated = stops.iter().map(|stop| eliminate(stop, damping)).collect::<Option<Vec<_>>>()?;
    let mut information: DMatrix<f64> = eliminated.iter().map(|stop| &stop.information).sum();
    let gradient: DVector<f64> = eliminated.iter().map(|stop| &stop.gradient).sum();
    for n in 0..information.nrows() {
        information[(n, n)] *= 1.0 + damping;
    }
    let shared = -information.cholesky()?.solve(&gradient);
    let mut next = state.moved(&shared);
    for (index, stop) in eliminated.iter().enumerate() {
        next.correct(index, &(&stop.own + &stop.follows * &shared));
    }
    Some(next)
}

/// Adjusts all parameters from a start.
///
/// # Errors
/// A corner is not visible at the start, or no convergence.
pub(super) fn adjust(
    start: State,
    stops: &[StopObservation<'_>],
    setting: &Setting<'_>,
) -> Result<Adjusted, HandEyeError> {
    let mut state = start;
    let mut damping = DAMPING[0];
    for _ in 0..STEPS_MAX {
        let all = stops.iter().enumerate().map(|(index, stop)| equations(&state, index, stop, setting));
        let all = all.collect::<Option<Vec<_>>>().ok_or(HandEyeError::NotVisible)?;
        let before: f64 = all.iter().map(|stop| stop.cost).sum();
        let (after, better) = loop {
            if damping > DAMPING[1] {
                return end(state, &all);
            }
            let tried = next(&state, &all, damping).map(|next| (cost(&next, stops, setting), next));
            match tried {
                Some((after, next)) if after <= before * (1.0 + DECREASE_MIN) => break (after, next),
                _ => damping = (damping * 10.0).max(DAMPING[0]),
            }
        };
        damping *= 0.1;
        state = better;
        if before - after <= SETTLED * before + 1e-14 {
            let all = stops.iter().enumerate().map(|(index, stop)| equations(&state, index, stop, setting));
            return end(state.clone(), &all.collect::<Option<Vec<_>>>().ok_or(HandEyeError::NotVisible)?);
        }
    }
    Err(HandEyeError::NotSettled { steps: STEPS_MAX })
}

fn end(state: State, all: &[StopEquations]) -> Result<Adjusted, HandEyeError> {
    let undetermined = || HandEyeError::Undetermined { parameter: "the poses of the arms".to_owned() };
    let eliminated = all.iter().map(|stop| eliminate(stop, 0.0)).collect::<Option<Vec<_>>>();
    let (information, gradients) =
        eliminated.ok_or_else(undetermined)?.into_iter().map(|stop| (stop.information, stop.gradient)).unzip();
    Ok(Adjusted { state, chi2: 2.0 * all.iter().map(|stop| stop.cost).sum::<f64>(), information, gradients })
}
