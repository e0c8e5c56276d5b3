//! Outlier rejection: each stop is compared with the calibration from all others.

use nalgebra::{DMatrix, Matrix6, Vector6};
use pb3dp_geometry::se3;

use super::adjust::{Adjusted, adjust};
use super::model::{Corners, POSE, SCALES, Setting, State, StopObservation};
use super::start::{Poses, start};
use super::{Difference, HandEyeError};

/// Squared Mahalanobis distance in six dimensions that one in a thousand good stops exceeds.
const SQUARED_SIGMAS_MAX: f64 = 22.46;
/// Median of the squared Mahalanobis distance of good stops.
const SQUARED_SIGMAS_MEDIAN: f64 = 5.35;
/// Share of the stops, those nearest to the start, used in the first adjustment.
const AT_FIRST: f64 = 0.6;
/// Minimum share of agreeing stops for a majority.
const MAJORITY: f64 = 0.55;

/// The agreeing stops and their adjustment.
pub(super) struct Settled {
    pub used: Vec<bool>,
    pub adjusted: Adjusted,
    pub variance_factor: f64,
}

/// Variance factor by which the arm noise exceeds the stated noise: the errors that the chain of poses adds to the independent
/// corner errors, per degree of freedom.
pub(super) fn variance_factor(adjusted: &Adjusted, squares_alone: f64, setting: &Setting<'_>) -> f64 {
    let stops = adjusted.information.len();
    let free = (POSE * stops).saturating_sub(adjusted.state.shared_count(setting)).max(1);
    let by_corners = squares_alone / setting.corner_sigma_px.powi(2);
    ((adjusted.chi2 - by_corners) / free as f64).max(0.0)
}

/// Finds the agreeing stops; the setting decides whether lengths are estimated.
///
/// The start explains most pairs of stops. The stop with the largest difference from the calibration by all others is then
/// removed, as long as this difference exceeds that of one in a thousand good stops. A removed stop is restored once it agrees.
/// If the arms are noisier than stated, all differences are compared with the typical difference among the stops.
pub(super) fn settle(
    observations: &[StopObservation<'_>],
    alone: &[(Poses, Corners)],
    setting: &Setting<'_>,
) -> Result<Settled, HandEyeError> {
    let poses: Vec<Poses> = alone.iter().map(|(poses, _)| *poses).collect();
    let first = start(&poses)?;
    let mut used = near_start(&first, &poses);
    let mut left_out = vec![0_usize; observations.len()];
    let mut is_first = true;
    loop {
        let agree = used.iter().filter(|used| **used).count();
        if (agree as f64) < (MAJORITY * observations.len() as f64).max(super::STOPS_MIN as f64) {
            return Err(HandEyeError::Contradiction { agree, all: observations.len() });
        }
        let (adjusted, alone, checks) = match checked(&first, observations, alone, &used, setting) {
            // The stops nearest to the start may belong to one arm only, or rotate about one axis.
            Err(_) if is_first && agree < observations.len() => {
                (used, is_first) = (vec![true; observations.len()], false);
                continue;
            }
            checked => checked?,
        };
        is_first = false;
        let limit = SQUARED_SIGMAS_MAX * usual(&checks, &used);
        let all = || checks.iter().map(|check| check.squared_sigmas).enumerate();
        let worst = all().filter(|(i, d)| used[*i] && *d > limit).max_by(|a, b| a.1.total_cmp(&b.1));
        // A stop is restored only once, so that the loop ends.
        let best =
            all().filter(|(i, d)| !used[*i] && *d < limit && left_out[*i] < 2).min_by(|a, b| a.1.total_cmp(&b.1));
        match (worst, best) {
            (Some((index, _)), _) => {
                used[index] = false;
                left_out[index] += 1;
            }
            (None, Some((index, _))) => {
                used[index] = true;
                left_out[index] += 1;
            }
            (None, None) => {
                let squares_alone = alone.iter().zip(&used).filter(|(_, used)| **used).map(|((_, c), _)| c.squares);
                let variance_factor = variance_factor(&adjusted, squares_alone.sum(), setting);
                return Ok(Settled { used, adjusted, variance_factor });
            }
        }
    }
}

/// The adjustment of the used stops, the board pose from each stop alone with the adjusted lengths, and each stop's difference.
type Checked = (Adjusted, Vec<(Poses, Corners)>, Vec<Difference>);

fn checked(
    first: &State,
    observations: &[StopObservation<'_>],
    alone: &[(Poses, Corners)],
    used: &[bool],
    setting: &Setting<'_>,
) -> Result<Checked, HandEyeError> {
    let adjusted = adjust(only(first, used), &only_detected(observations, used), setting)?;
    let alone = with_scales(observations, alone, adjusted.state.scales, setting)?;
    let checks = checks(observations, &alone, used, &adjusted, setting)?;
    Ok((adjusted, alone, checks))
}

/// Typical difference among the used stops, as variance over its expected value; at least 1.
fn usual(checks: &[Difference], used: &[bool]) -> f64 {
    let of_used = checks.iter().zip(used).filter(|(_, used)| **used);
    let mut squared: Vec<f64> = of_used.map(|(check, _)| check.squared_sigmas).collect();
    squared.sort_by(f64::total_cmp);
    let median = squared.get(squared.len() / 2).copied().unwrap_or(0.0);
    (median / SQUARED_SIGMAS_MEDIAN).max(1.0)
}

/// The board pose from each stop alone, with the lengths of an adjustment.
fn with_scales(
    observations: &[StopObservation<'_>],
    alone: &[(Poses, Corners)],
    scales: [f64; SCALES],
    setting: &Setting<'_>,
) -> Result<Vec<(Poses, Corners)>, HandEyeError> {
    let of = |(observations, (poses, _)): (&StopObservation<'_>, &(Poses, Corners))| {
        let (cam_from_board, corners) = observations.by_itself(setting, poses.cam_from_board, scales)?;
        Some((Poses { cam_from_board, ..*poses }, corners))
    };
    observations.iter().zip(alone).map(of).collect::<Option<Vec<_>>>().ok_or(HandEyeError::NotVisible)
}

/// The stops nearest to the start.
fn near_start(state: &State, poses: &[Poses]) -> Vec<bool> {
    let off = |(poses, arms): (&Poses, &Vec<_>)| {
        let apart = se3::log(&(poses.cam_from_board.inverse() * state.cam_from_board(arms)));
        // One radian counts as half a metre.
        apart.fixed_rows::<3>(0).norm() + 0.5 * apart.fixed_rows::<3>(3).norm()
    };
    let off: Vec<f64> = poses.iter().zip(&state.arms).map(off).collect();
    let mut sorted = off.clone();
    sorted.sort_by(f64::total_cmp);
    let kept = ((AT_FIRST * off.len() as f64).ceil() as usize).max(super::STOPS_MIN).min(off.len());
    let farthest = sorted.get(kept.saturating_sub(1)).copied().unwrap_or(f64::INFINITY);
    off.iter().map(|off| *off <= farthest).collect()
}

fn only(state: &State, used: &[bool]) -> State {
    let arms = state.arms.iter().zip(used).filter(|(_, used)| **used).map(|(arms, _)| arms.clone()).collect();
    State { arms, ..state.clone() }
}

fn only_detected<'a>(observations: &[StopObservation<'a>], used: &[bool]) -> Vec<StopObservation<'a>> {
    observations.iter().zip(used).filter(|(_, used)| **used).map(|(observations, _)| observations.clone()).collect()
}

/// Compares each stop with the calibration from all (other) used stops.
///
/// The calibration without the stop is approximated by one step of the equations of the other stops. With many stops and small
/// contradictions the equations are the same there.
pub(super) fn checks(
    observations: &[StopObservation<'_>],
    alone: &[(Poses, Corners)],
    used: &[bool],
    adjusted: &Adjusted,
    setting: &Setting<'_>,
) -> Result<Vec<Difference>, HandEyeError> {
    let mut at = 0;
    let mut checks = Vec::with_capacity(observations.len());
    for (((observations, (poses, corners)), used), index) in observations.iter().zip(alone).zip(used).zip(0..) {
        let (state, covariance) = if *used {
            let covariance = adjusted.covariance_without(Some(at), setting)?;
            let state = adjusted.state.moved(&(&covariance * &adjusted.gradients[at]));
            at += 1;
            (state, covariance)
        } else {
            (adjusted.state.clone(), adjusted.covariance_without(None, setting)?)
        };
        let arms = observations.arms();
        let links = state.links(&arms);
        let by = se3::log(&(poses.cam_from_board.inverse() * state.cam_from_board(&arms)));
        let of_poses = covariance.view((0, 0), (links.shared.ncols(), links.shared.ncols()));
        let mut of_difference: DMatrix<f64> = &links.shared * of_poses * links.shared.transpose();
        for arm in 0..arms.len() {
            let block = links.arms.columns(POSE * arm, POSE);
            let information = observations.robot_information(arm, setting);
            let robot = information.cholesky().map(|factor| factor.inverse()).unwrap_or_else(Matrix6::zeros);
            of_difference += block * robot * block.transpose();
        }
        let undetermined = || HandEyeError::Undetermined { parameter: format!("the board at stop {index}") };
        let information: Matrix6<f64> = corners.information.fixed_view::<POSE, POSE>(0, 0).into_owned();
        let by_corners = information.cholesky().ok_or_else(undetermined)?.inverse() * setting.corner_sigma_px.powi(2);
        let total = Matrix6::from_iterator(of_difference.iter().copied()) + by_corners;
        let solved: Vector6<f64> = total.cholesky().ok_or_else(undetermined)?.solve(&by);
        checks.push(Difference { by, squared_sigmas: by.dot(&solved) });
    }
    Ok(checks)
}
