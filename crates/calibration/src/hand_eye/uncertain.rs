//! Covariance from errors shared by several stops: errors of the stereo calibration, and of an arm that is stationary.

use nalgebra::{DMatrix, DVector, Point3, Vector2, Vector6};
use pb3dp_geometry::{StereoRig, se3};
use pb3dp_record::calibration_files::ParameterCovariance;

use super::HandEyeError;
use super::adjust::adjust;
use super::model::{POSE, Setting, State, StopObservation};
use crate::adjust as head;
use crate::depth::triangulated;
use crate::fit::sides;
use crate::fitted_rig::rig_of;
use crate::lens::LensModel;

/// The covariance of a stereo calibration, as stored in its file.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationCovariance {
    lens: LensModel,
    matrix: DMatrix<f64>,
}

impl CalibrationCovariance {
    /// Reads the covariance of our own file format.
    ///
    /// # Errors
    /// Parameters other than those of a stereo rig.
    pub fn new(rig: &StereoRig, covariance: &ParameterCovariance) -> Result<Self, HandEyeError> {
        let names_of = |lens: LensModel| head::State::of_rig(rig, lens).shared_names(&sides::<2>());
        let lens = LensModel::ALL.into_iter().find(|lens| names_of(*lens) == covariance.names);
        let lens = lens.ok_or_else(|| HandEyeError::RigCovariance {
            found: covariance.names.join(", "),
            expected: names_of(LensModel::Brown4).join(", "),
        })?;
        let count = covariance.names.len();
        let matrix = DMatrix::from_row_iterator(count, count, covariance.rows.iter().flatten().copied());
        Ok(Self { lens, matrix })
    }
}

/// One uncertain direction of the stereo rig: the results with the rig perturbed by one standard deviation to either side.
#[derive(Clone, Debug)]
pub(super) struct Direction {
    pub sides: [(StereoRig, State); 2],
}

impl Direction {
    /// Change of the shared poses per standard deviation.
    pub(super) fn step(&self) -> DVector<f64> {
        let [(_, below), (_, above)] = &self.sides;
        difference(below, above) * 0.5
    }

    /// Displacement on the flange, per standard deviation, of a point seen at the given pixels of both cameras, metres.
    pub(super) fn point_step_m(&self, [left, right]: &[Vector2<f64>; 2]) -> f64 {
        let on_flange = |(rig, state): &(StereoRig, State)| {
            Some(state.flange_from_cam * Point3::from(triangulated(rig, left, right)?))
        };
        let [below, above] = &self.sides;
        on_flange(below).zip(on_flange(above)).map_or(f64::INFINITY, |(a, b)| 0.5 * (b - a).norm())
    }
}

/// The uncertain directions of the stereo rig, each perturbed by one standard deviation to either side and readjusted.
pub(super) fn directions(
    state: &State,
    observations: &[StopObservation<'_>],
    setting: &Setting<'_>,
    covariance: &CalibrationCovariance,
) -> Result<Vec<Direction>, HandEyeError> {
    let head = head::State::of_rig(setting.rig, covariance.lens);
    // The parameters have different units: they are scaled to standard deviations, so that small values are not truncated to
    // zero.
    let sigma = covariance.matrix.diagonal().map(|variance| variance.max(0.0).sqrt());
    let inverse = sigma.map(|sigma| if sigma > 0.0 { 1.0 / sigma } else { 0.0 });
    let correlation = DMatrix::from_diagonal(&inverse) * &covariance.matrix * DMatrix::from_diagonal(&inverse);
    let eigen = correlation.symmetric_eigen();
    let mut directions = Vec::with_capacity(sigma.len());
    for (direction, value) in eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter()) {
        let step = direction.component_mul(&sigma) * value.max(0.0).sqrt();
        let moved = |sign: f64| -> Result<(StereoRig, State), HandEyeError> {
            let moved = head.moved(&(&step * sign), &[]).ok().and_then(|head| rig_of(&head).ok());
            let Some(rig) = moved else { return Err(HandEyeError::NotVisible) };
            let state = adjust(state.clone(), observations, &Setting { rig: &rig, ..setting.clone() })?.state;
            Ok((rig, state))
        };
        directions.push(Direction { sides: [moved(-1.0)?, moved(1.0)?] });
    }
    Ok(directions)
}

/// Change of the shared poses per standard deviation of each parameter of each pose that an arm keeps over several stops. The
/// error of that pose is the same at all these stops, so it does not appear as noise from stop to stop. `factor` is the variance
/// factor of the arms.
pub(super) fn rest_directions(
    state: &State,
    observations: &[StopObservation<'_>],
    setting: &Setting<'_>,
    factor: f64,
) -> Result<Vec<DVector<f64>>, HandEyeError> {
    let mut steps = Vec::new();
    for arm in 0..state.place.arm_count() {
        let mut places: Vec<usize> = observations.iter().filter_map(|stop| stop.rests[arm]).collect();
        places.sort_unstable();
        places.dedup();
        for (place, number) in places.into_iter().flat_map(|place| (0..POSE).map(move |number| (place, number))) {
            let sigma = (factor / setting.robot_information[(number, number)]).sqrt();
            let moved = |sign: f64| -> Result<State, HandEyeError> {
                let by = se3::exp(&Vector6::ith(number, sign * sigma));
                let (mut state, mut observations) = (state.clone(), observations.to_vec());
                for (stop, corrected) in
                    observations.iter_mut().zip(&mut state.arms).filter(|(stop, _)| stop.rests[arm] == Some(place))
                {
                    match (arm, &mut stop.tc) {
                        (0, _) => stop.vs *= by,
                        (_, Some(tc)) => *tc *= by,
                        _ => {}
                    }
                    corrected[arm] *= by;
                }
                Ok(adjust(state, &observations, setting)?.state)
            };
            steps.push(difference(&moved(-1.0)?, &moved(1.0)?) * 0.5);
        }
    }
    Ok(steps)
}

/// The difference between the shared poses of two states.
fn difference(from: &State, to: &State) -> DVector<f64> {
    let poses = from.poses().into_iter().zip(to.poses());
    let steps: Vec<f64> = poses
        .flat_map(|((_, from), (_, to))| se3::log(&(from.inverse() * to)).iter().copied().collect::<Vec<_>>())
        .collect();
    DVector::from_vec(steps)
}
