//! Fits cameras with one lens model to detected boards, and estimates the covariance.

use nalgebra::{DMatrix, Isometry3, UnitQuaternion, Vector2};
use pb3dp_geometry::frames::{Board, CamLeft};
use pb3dp_geometry::{Camera, ImageSize, Pose, StereoRig};

use crate::adjust::{AdjustmentError, Observations, SHAPE, State, adjust, reduced_at};
use crate::board::{BoardCorner, Chessboard, Sighting};
use crate::fitted_rig::{FitError, VIEWS_MIN, rig_of};
use crate::lens::LensModel;
use crate::start::{board_pose, first_camera};

/// One view of the board, taken by all `N` cameras at the same time.
#[derive(Clone, Debug, PartialEq)]
pub struct View<const N: usize> {
    /// Name of the view, for example its file name.
    pub name: String,
    /// The detected corners of each camera; the left camera first.
    pub sightings: [Sighting; N],
}

/// Names of the cameras in parameters and files.
pub fn sides<const N: usize>() -> [&'static str; N] {
    std::array::from_fn(|index| match (N, index) {
        (1, _) => "camera",
        (_, 0) => "left",
        _ => "right",
    })
}

/// The reprojection error of one corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerError {
    /// The detected corner.
    pub corner: BoardCorner,
    /// Predicted minus detected, px.
    pub error_px: Vector2<f64>,
}

/// The covariance of the parameters shared by all views.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    /// Names: `left.fx`, `right.k1`, `cam_right_from_cam_left.x_m`; pixels, metres and radians. The pose is perturbed by `exp([x
    /// y z rx ry rz])` in `cam_right`.
    pub names: Vec<String>,
    /// The matrix, in the order of the names.
    pub matrix: DMatrix<f64>,
    /// Standard deviation of a corner in a row or column, px, estimated from the residuals.
    pub corner_sigma_px: f64,
    /// Factor applied to the variance because views differ from each other by more than corner noise; 1 if they do not. The
    /// matrix includes this factor.
    pub view_scatter: f64,
}

impl Covariance {
    /// The covariance of the cameras and their pose, without the board shape.
    #[must_use]
    pub fn of_cameras(&self) -> Self {
        let kept: Vec<usize> =
            self.names.iter().enumerate().filter(|(_, name)| !name.starts_with("board.")).map(|(n, _)| n).collect();
        Self {
            names: kept.iter().map(|n| self.names[*n].clone()).collect(),
            matrix: self.matrix.select_rows(&kept).select_columns(&kept),
            ..self.clone()
        }
    }

    /// Standard deviation of a parameter.
    pub fn sigma(&self, name: &str) -> Option<f64> {
        let index = self.names.iter().position(|other| other == name)?;
        Some(self.matrix[(index, index)].max(0.0).sqrt())
    }
}

/// Cameras fitted to views of a board.
#[derive(Clone, Debug)]
pub struct Fit<const N: usize> {
    pub(crate) state: State,
    pub(crate) board: Chessboard,
    errors: Vec<[Vec<CornerError>; N]>,
    covariance: Covariance,
}

impl<const N: usize> Fit<N> {
    /// Fits cameras with images of the given size to all views together.
    ///
    /// # Errors
    /// Too few views, a parameter that the views do not determine, or views that fit no camera model.
    pub fn new(views: &[View<N>], board: &Chessboard, size: ImageSize, lens: LensModel) -> Result<Self, FitError> {
        let start = start(views, board, size)?;
        Self::from_start(views, board, lens, &start)
    }

    /// As [`Self::new`], starting from another fit to the same or more views.
    pub(crate) fn near(&self, views: &[View<N>], board: &Chessboard, lens: LensModel) -> Result<Self, FitError> {
        let boards = poses(&self.state, views, board).ok_or(FitError::NoStart { side: sides::<N>()[0] })?;
        Self::from_start(views, board, lens, &State { boards, ..self.state.clone() })
    }

    /// Refines this fit with the board shape as additional parameters: a surface of second order.
    ///
    /// # Errors
    /// The views do not determine the shape: the board is not tilted enough.
    pub fn with_shape(&self, views: &[View<N>]) -> Result<Self, FitError> {
        let start = State { shape: Some([0.0; SHAPE]), ..self.state.clone() };
        Self::from_start(views, &self.board, self.state.lens, &start)
    }

    /// The board.
    pub fn board(&self) -> &Chessboard {
        &self.board
    }

    /// Out-of-plane deviation of the board, metres: bow along its rows and its columns, in the middle, and twist, at corner (0,
    /// 0); `None` if the board is assumed flat.
    pub fn board_shape_m(&self) -> Option<[f64; 3]> {
        self.state.shape
    }

    fn from_start(views: &[View<N>], board: &Chessboard, lens: LensModel, start: &State) -> Result<Self, FitError> {
        let observations = observations(views, board);
        let state = adjust(with_lens(start, lens)?, &observations, false)?;
        let errors = corner_errors(&state, &observations)?;
        let covariance = covariance(&state, &observations)?;
        Ok(Self { state, board: *board, errors, covariance })
    }

    /// The cameras, the left one first.
    pub fn cameras(&self) -> [Camera; N] {
        std::array::from_fn(|index| self.state.cameras[index])
    }

    /// The lens model.
    pub fn lens(&self) -> LensModel {
        self.state.lens
    }

    /// The board pose in the first camera, view by view.
    pub fn cam_left_from_board(&self) -> impl Iterator<Item = Pose<CamLeft, Board>> + '_ {
        self.state.boards.iter().map(|pose| Pose::from_isometry(*pose))
    }

    /// The shared parameters by name, in the order of the covariance: pixels, metres and radians; a pose is given by its
    /// translation and rotation vector.
    pub fn parameters(&self) -> Vec<(String, f64)> {
        let of_camera = |camera: &Camera| {
            let p = camera.pinhole();
            let coefficients = camera.distortion().coefficients().iter().copied().take(self.lens().coefficient_count());
            [p.fx, p.fy, p.cx, p.cy].into_iter().chain(coefficients).collect::<Vec<_>>()
        };
        let of_pose = |pose: &Isometry3<f64>| {
            let turn = pose.rotation.scaled_axis();
            pose.translation.vector.iter().chain(turn.iter()).copied().collect::<Vec<_>>()
        };
        let cameras = self.state.cameras.iter().flat_map(of_camera);
        let poses = self.state.from_first.iter().skip(1).flat_map(of_pose);
        let values = cameras.chain(poses).chain(self.state.shape.into_iter().flatten());
        self.covariance.names.iter().cloned().zip(values).collect()
    }

    /// The errors of all corners: view by view, camera by camera.
    pub fn errors(&self) -> &[[Vec<CornerError>; N]] {
        &self.errors
    }

    /// The covariance of the shared parameters.
    pub fn covariance(&self) -> &Covariance {
        &self.covariance
    }

    /// Corner errors of held-out views; only the board pose is fitted to each of these views.
    ///
    /// # Errors
    /// The board pose of a view cannot be computed.
    pub(crate) fn errors_of_other_views(
        &self,
        views: &[View<N>],
        board: &Chessboard,
    ) -> Result<Vec<Vector2<f64>>, FitError> {
        let observations = observations(views, board);
        let boards = poses(&self.state, views, board).ok_or(FitError::NoStart { side: sides::<N>()[0] })?;
        let state = adjust(State { boards, ..self.state.clone() }, &observations, true)?;
        let errors = corner_errors::<N>(&state, &observations)?;
        Ok(errors.into_iter().flatten().flatten().map(|corner| corner.error_px).collect())
    }
}

impl Fit<2> {
    /// The stereo rig.
    ///
    /// # Errors
    /// The right camera is not to the right of the left camera, nor above or below it.
    pub fn rig(&self) -> Result<StereoRig, FitError> {
        rig_of(&self.state)
    }

    /// Standard deviation of the depth of a point straight ahead of the left camera that is caused by calibration errors, metres;
    /// image corners are assumed exact.
    ///
    /// # Errors
    /// As [`Self::rig`].
    pub fn depth_sigma_m(&self, depth_m: f64) -> Result<f64, FitError> {
        crate::depth::sigma_m(&self.state, &self.covariance.matrix, depth_m)
    }
}

pub(crate) fn observations<'a, const N: usize>(views: &'a [View<N>], board: &'a Chessboard) -> Observations<'a> {
    Observations { board, views: views.iter().map(|view| view.sightings.iter().collect()).collect() }
}

/// Initial values: each camera separately, then the poses between the cameras from the view that agrees best with the others.
fn start<const N: usize>(views: &[View<N>], board: &Chessboard, size: ImageSize) -> Result<State, FitError> {
    if views.len() < VIEWS_MIN {
        return Err(FitError::Views { given: views.len() });
    }
    let mut alone = Vec::with_capacity(N);
    for (index, side) in sides::<N>().into_iter().enumerate() {
        let sightings: Vec<&Sighting> = views.iter().map(|view| &view.sightings[index]).collect();
        alone.push(start_of_one(&sightings, board, size).ok_or(FitError::NoStart { side })??);
    }
    if let [left, right] = alone.as_slice() {
        check_pairs(views, [&left.boards, &right.boards])?;
    }
    let from_first = (0..N).map(|index| middle_pose(&alone[0].boards, &alone[index].boards)).collect();
    let cameras = alone.iter().map(|state| state.cameras[0]).collect();
    Ok(State { lens: alone[0].lens, cameras, from_first, boards: alone.swap_remove(0).boards, shape: None })
}

/// Refuses pairs whose images were not taken at the same moment: the pose between the cameras must be the same in all of them.
fn check_pairs<const N: usize>(views: &[View<N>], [left, right]: [&[Isometry3<f64>]; 2]) -> Result<(), FitError> {
    /// Median angle between poses of pairs that do not belong together, radians. Chosen by hand, not varied: boards of 50 px show their
    /// turn to a few degrees; a board that is moved between images turns by 10 degrees and more.
    const APART_MIN_RAD: f64 = 0.15;
    /// Pairs are shifted if the angle falls to this share. Chosen by hand, not varied.
    const SHIFTED_SHARE: f64 = 0.25;
    // Left image i with right image i + shift.
    let apart = |shift: isize| {
        let of_pair = |i: usize| {
            let other = right.get(i.checked_add_signed(shift)?)?;
            Some(other.rotation * left[i].rotation.inverse())
        };
        let turns: Vec<_> = (0..left.len()).filter_map(of_pair).collect();
        let median = |centre: &UnitQuaternion<f64>| {
            let mut angles: Vec<f64> = turns.iter().map(|turn| turn.angle_to(centre)).collect();
            angles.sort_by(f64::total_cmp);
            angles[angles.len() / 2]
        };
        (turns.len() >= VIEWS_MIN).then(|| turns.iter().map(median).fold(f64::INFINITY, f64::min))
    };
    let Some(found) = apart(0).filter(|angle| *angle > APART_MIN_RAD) else { return Ok(()) };
    let shifted = [1, -1].into_iter().find(|shift| apart(*shift).is_some_and(|angle| angle < SHIFTED_SHARE * found));
    let advice = match shifted {
        Some(shift) => {
            let which = if shift > 0 { "after" } else { "before" };
            format!(
                "; the left image of each pair fits the right image of the pair {which} it: the pairs are one off, check the names of the \
                 files, and whether the first images were taken at the same time"
            )
        }
        None => ": take both images at the same time, and check the names of the files".to_owned(),
    };
    let name = |view: Option<&View<N>>| view.map_or_else(String::new, |view| view.name.clone());
    let pairs = format!("{} to {}, {} pairs", name(views.first()), name(views.last()), views.len());
    Err(FitError::Pairs { pairs, angle_deg: found.to_degrees(), advice })
}

/// Initial values of one camera with a simple lens.
fn start_of_one(sightings: &[&Sighting], board: &Chessboard, size: ImageSize) -> Option<Result<State, FitError>> {
    let camera = first_camera(sightings, board, size)?;
    let boards: Option<Vec<_>> = sightings.iter().map(|sighting| board_pose(&camera, sighting, board)).collect();
    let state = State {
        lens: LensModel::Radial1,
        cameras: vec![camera],
        from_first: vec![Isometry3::identity()],
        boards: boards?,
        shape: None,
    };
    let observations = Observations { board, views: sightings.iter().map(|sighting| vec![*sighting]).collect() };
    let settle =
        |lens, state: &State| -> Result<State, FitError> { Ok(adjust(with_lens(state, lens)?, &observations, false)?) };
    Some(settle(LensModel::Radial1, &state).and_then(|state| settle(LensModel::Radial2, &state)))
}

/// The pose with the smallest distance to all others, of the poses from the views.
fn middle_pose(first: &[Isometry3<f64>], other: &[Isometry3<f64>]) -> Isometry3<f64> {
    let poses: Vec<Isometry3<f64>> = first.iter().zip(other).map(|(first, other)| other * first.inverse()).collect();
    let length = poses.iter().map(|pose| pose.translation.vector.norm()).sum::<f64>() / poses.len().max(1) as f64;
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let apart = a.inverse() * b;
        apart.rotation.angle() + apart.translation.vector.norm() / length.max(1e-6)
    };
    let sum = |pose: &Isometry3<f64>| poses.iter().map(|other| distance(pose, other)).sum::<f64>();
    poses.iter().min_by(|a, b| sum(a).total_cmp(&sum(b))).copied().unwrap_or_default()
}

/// The board poses in other views, from the first camera.
fn poses<const N: usize>(state: &State, views: &[View<N>], board: &Chessboard) -> Option<Vec<Isometry3<f64>>> {
    views.iter().map(|view| board_pose(&state.cameras[0], &view.sightings[0], board)).collect()
}

/// The same state with another lens model; additional coefficients start at zero.
fn with_lens(state: &State, lens: LensModel) -> Result<State, FitError> {
    let camera =
        |camera: &Camera| Camera::new(camera.size(), *camera.pinhole(), lens.lens(camera.distortion().coefficients()));
    let cameras = state.cameras.iter().map(camera).collect::<Result<Vec<_>, _>>().map_err(AdjustmentError::from)?;
    Ok(State { lens, cameras, ..state.clone() })
}

fn corner_errors<const N: usize>(
    state: &State,
    observations: &Observations<'_>,
) -> Result<Vec<[Vec<CornerError>; N]>, FitError> {
    let mut all = Vec::with_capacity(observations.views.len());
    for (view, sightings) in observations.views.iter().enumerate() {
        let mut of_view: [Vec<CornerError>; N] = std::array::from_fn(|_| Vec::new());
        for (camera, (list, sighting)) in of_view.iter_mut().zip(sightings).enumerate() {
            let errors = state.errors(observations, view, camera).ok_or(AdjustmentError::NotVisible { view })?;
            let corners = sighting.corners().iter().zip(errors);
            list.extend(corners.map(|(corner, error_px)| CornerError { corner: *corner, error_px }));
        }
        all.push(of_view);
    }
    Ok(all)
}

/// The covariance of the shared parameters at the solution.
///
/// The noise is estimated from the residuals, equally for all corners. Errors shared by the corners of a view (a bent board, an
/// unsuitable lens model) make views differ by more than this noise. The sum of the view gradients is zero. With independent
/// errors the sum of their squares equals the noise times the trace that follows from the information. If the sum exceeds this
/// value by more than two standard deviations of chance, the covariance is multiplied by the ratio.
fn covariance(state: &State, observations: &Observations<'_>) -> Result<Covariance, FitError> {
    let all_sides: &[&str] = if state.cameras.len() == 1 { &sides::<1>() } else { &sides::<2>() };
    let reduced = reduced_at(state, observations, all_sides)?;
    let undetermined = || AdjustmentError::Undetermined { parameter: "the cameras".to_owned() };
    let mut inverse = reduced.information.clone().cholesky().ok_or_else(undetermined)?.inverse();
    let count = state.shared_count();
    let mut squares = 0.0;
    let mut numbers = 0;
    for view in 0..observations.views.len() {
        for camera in 0..state.cameras.len() {
            let errors = state.errors(observations, view, camera).ok_or(AdjustmentError::NotVisible { view })?;
            squares += errors.iter().map(Vector2::norm_squared).sum::<f64>();
            numbers += 2 * errors.len();
        }
    }
    let parameters = count + crate::adjust::POSE * observations.views.len();
    let variance = squares / numbers.saturating_sub(parameters).max(1) as f64;
    let scatter: f64 = reduced.gradients.iter().map(|gradient| gradient.dot(&(&inverse * gradient))).sum();
    let expected: f64 = reduced
        .by_view
        .iter()
        .map(|information| {
            let share = &inverse * information;
            share.trace() - (&share * &share).trace()
        })
        .sum();
    let ratio = scatter / (variance * expected);
    let by_chance = 1.0 + 2.0 * (2.0 / expected).sqrt();
    let view_scatter = if ratio.is_finite() && ratio > by_chance { ratio } else { 1.0 };
    inverse *= variance * view_scatter;
    Ok(Covariance {
        names: state.shared_names(all_sides),
        matrix: inverse,
        corner_sigma_px: variance.sqrt(),
        view_scatter,
    })
}
