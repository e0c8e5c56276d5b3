//! Joint bundle adjustment: cameras, poses between the cameras and the board pose of every view, by least squares of the
//! reprojection errors of all corners.
//!
//! Levenberg-Marquardt on the normal equations. The board poses are eliminated view by view (Schur complement: Triggs et al.,
//! Bundle Adjustment: A Modern Synthesis, 2000, section 6.1), so the reduced system only has the parameters shared by all views.
//! Poses are updated by `exp(xi)`, `xi` = [translation; rotation]: the pose of the second camera in its own frame, the board
//! poses in the frame of the board.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2x3, Matrix3, Matrix6, Matrix6xX, MatrixXx6, Point3, SMatrix, Vector2, Vector6,
};
use pb3dp_geometry::{Camera, CameraError, Pinhole, StereoRig, se3, so3};

use crate::board::{BoardCorner, Chessboard, Sighting};
use crate::lens::LensModel;

/// Maximum number of iterations; a good start takes five to fifteen.
const STEPS_MAX: usize = 200;
/// Initial damping, and the damping at which the adjustment gives up.
const DAMPING: [f64; 2] = [1e-4, 1e12];
/// The adjustment ends when an iteration lowers the cost by a smaller share.
const DECREASE_MIN: f64 = 1e-13;
/// Number of board shape parameters: the surfaces of [`Chessboard::surfaces`].
pub(crate) const SHAPE: usize = 3;
/// Number of pinhole parameters.
const PINHOLE: usize = 4;
/// Number of pose parameters.
pub(crate) const POSE: usize = 6;
/// Names of the pose parameters.
pub(crate) const POSE_NUMBERS: [&str; POSE] = ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"];

/// The observations: the detected corners of each view, one set per camera.
pub(crate) struct Observations<'a> {
    pub board: &'a Chessboard,
    pub views: Vec<Vec<&'a Sighting>>,
}

/// All estimated parameters.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub lens: LensModel,
    pub cameras: Vec<Camera>,
    /// `cam_c_from_cam_0`; the first one is fixed to the identity.
    pub from_first: Vec<Isometry3<f64>>,
    /// `cam_0_from_board` of each view.
    pub boards: Vec<Isometry3<f64>>,
    /// Out-of-plane deviation of the board, metres; `None` if the board is assumed flat.
    pub shape: Option<[f64; SHAPE]>,
}

/// The normal equations of one view.
#[derive(Clone)]
struct ViewEquations {
    /// Block of the shared parameters.
    shared: DMatrix<f64>,
    shared_gradient: DVector<f64>,
    /// Block of the shared parameters and the board pose.
    mixed: DMatrix<f64>,
    pose: Matrix6<f64>,
    pose_gradient: Vector6<f64>,
    cost: f64,
}

/// The normal equations with the board poses eliminated.
pub(crate) struct Reduced {
    /// Information matrix of the shared parameters, per px^2 of noise.
    pub information: DMatrix<f64>,
    /// Contribution of each view to the information.
    pub by_view: Vec<DMatrix<f64>>,
    /// Gradient contribution of each view.
    pub gradients: Vec<DVector<f64>>,
    /// Inverse of each view's information about its pose, with the shared parameters fixed.
    pub pose_inverses: Vec<Matrix6<f64>>,
    /// Derivative of each pose with respect to the shared parameters: minus `pose_inverse * mixed^T`.
    pub pose_by_shared: Vec<Matrix6xX<f64>>,
}

/// Why an adjustment failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AdjustmentError {
    /// A corner is not visible with the current camera estimates.
    #[error(
        "view {view}: a corner lies behind the camera or outside the valid range of the lens model; leave this view out"
    )]
    NotVisible {
        /// Index of the view.
        view: usize,
    },
    /// The views do not determine a parameter.
    #[error(
        "the views do not determine {parameter}: show the board tilted by 20 to 40 degrees in several directions, and in all corners of the image"
    )]
    Undetermined {
        /// The least determined parameter.
        parameter: String,
    },
    /// No convergence within the allowed iterations.
    #[error(
        "the adjustment did not converge within {steps} steps; add views of the board, tilted and near the image borders"
    )]
    NotSettled {
        /// Number of iterations.
        steps: usize,
    },
    /// The camera parameters became invalid.
    #[error("the adjustment led to invalid camera parameters")]
    Camera(#[from] CameraError),
}

impl State {
    /// A stereo rig without views; its lens model is not read if the cameras are fixed.
    pub(crate) fn of_rig(rig: &StereoRig, lens: LensModel) -> Self {
        let from_first = vec![Isometry3::identity(), *rig.cam_right_from_cam_left().isometry()];
        Self { lens, cameras: vec![*rig.left(), *rig.right()], from_first, boards: Vec::new(), shape: None }
    }

    fn shared_per_camera(&self) -> usize {
        PINHOLE + self.lens.coefficient_count()
    }

    /// Number of parameters shared by all views.
    pub(crate) fn shared_count(&self) -> usize {
        self.shape_column() + if self.shape.is_some() { SHAPE } else { 0 }
    }

    /// First column of the board shape parameters.
    pub(crate) fn shape_column(&self) -> usize {
        self.cameras.len() * self.shared_per_camera() + (self.cameras.len() - 1) * POSE
    }

    /// A corner of the board in the frame `board`, including the board shape.
    fn corner_in_board(&self, board: &Chessboard, corner: &BoardCorner) -> Point3<f64> {
        let mut in_board = board.corner_in_board(corner.column, corner.row);
        if let Some(shape) = &self.shape {
            let surfaces = board.surfaces(corner.column, corner.row);
            in_board.z += shape.iter().zip(surfaces).map(|(height, surface)| height * surface).sum::<f64>();
        }
        in_board
    }

    /// Names of the shared parameters, in order; `sides` are the names of the cameras.
    pub(crate) fn shared_names(&self, sides: &[&str]) -> Vec<String> {
        let of_camera = |side: &str| {
            let names = ["fx", "fy", "cx", "cy"].into_iter().chain(self.lens.coefficient_names().iter().copied());
            names.map(|name| format!("{side}.{name}")).collect::<Vec<_>>()
        };
        let mut names: Vec<String> = sides.iter().flat_map(|side| of_camera(side)).collect();
        for side in sides.iter().skip(1) {
            names.extend(POSE_NUMBERS.map(|name| format!("cam_{side}_from_cam_{}.{name}", sides[0])));
        }
        if self.shape.is_some() {
            names.extend(["bow_of_rows_m", "bow_of_columns_m", "twist_m"].map(|name| format!("board.{name}")));
        }
        names
    }

    /// The state updated by a step of the shared parameters and of each pose.
    pub(crate) fn moved(&self, shared: &DVector<f64>, poses: &[Vector6<f64>]) -> Result<Self, CameraError> {
        let mut next = self.clone();
        for (board, step) in next.boards.iter_mut().zip(poses) {
            *board *= se3::exp(step);
        }
        // Fixed cameras are kept unchanged, so that they may have any lens model.
        if shared.iter().all(|step| *step == 0.0) {
            return Ok(next);
        }
        let per_camera = self.shared_per_camera();
        for (index, camera) in self.cameras.iter().enumerate() {
            let step = shared.rows(index * per_camera, per_camera);
            let p = camera.pinhole();
            let pinhole = Pinhole { fx: p.fx + step[0], fy: p.fy + step[1], cx: p.cx + step[2], cy: p.cy + step[3] };
            let old = camera.distortion().coefficients().iter().chain(std::iter::repeat(&0.0));
            let values: Vec<f64> = step.iter().skip(PINHOLE).zip(old).map(|(step, old)| old + step).collect();
            next.cameras[index] = Camera::new(camera.size(), pinhole, self.lens.lens(&values))?;
        }
        for index in 1..self.cameras.len() {
            let at = self.pose_column(index);
            next.from_first[index] = se3::exp(&shared.fixed_rows::<POSE>(at).into_owned()) * self.from_first[index];
        }
        let at = self.shape_column();
        for (n, height) in next.shape.iter_mut().flatten().enumerate() {
            *height += shared[at + n];
        }
        Ok(next)
    }

    /// First column of a camera's pose parameters.
    fn pose_column(&self, camera: usize) -> usize {
        self.cameras.len() * self.shared_per_camera() + (camera - 1) * POSE
    }

    /// The normal equations of one view; `None` if a corner is not visible.
    fn view_equations(&self, observations: &Observations<'_>, view: usize) -> Option<ViewEquations> {
        self.view_equations_with(observations, view, 0, |_| Vec::new())
    }

    /// As [`Self::view_equations`], with `count` additional parameters after the shared ones; `columns` gives the derivatives of
    /// a corner's pixel with respect to the additional parameters.
    fn view_equations_with(
        &self,
        observations: &Observations<'_>,
        view: usize,
        further: usize,
        columns: impl Fn(&Predicted) -> Vec<(usize, Vector2<f64>)>,
    ) -> Option<ViewEquations> {
        let count = self.shared_count() + further;
        let mut equations = ViewEquations {
            shared: DMatrix::zeros(count, count),
            shared_gradient: DVector::zeros(count),
            mixed: DMatrix::zeros(count, POSE),
            pose: Matrix6::zeros(),
            pose_gradient: Vector6::zeros(),
            cost: 0.0,
        };
        for (index, sighting) in observations.views[view].iter().enumerate() {
            let mut rows = Vec::with_capacity(sighting.corners().len());
            for corner in sighting.corners() {
                let in_board = self.corner_in_board(observations.board, corner);
                let surfaces = observations.board.surfaces(corner.column, corner.row);
                let (predicted, mut row) = self.corner_row(index, view, &in_board, &surfaces)?;
                let behind = columns(&predicted).into_iter().map(|(n, by)| (self.shared_count() + n, by));
                row.shared.extend(behind);
                rows.push((predicted.pixel - corner.pixel, row));
            }
            equations.add(&rows);
        }
        Some(equations)
    }

    /// Predicted pixel of a corner, and its derivatives.
    fn corner_row(
        &self,
        index: usize,
        view: usize,
        in_board: &Point3<f64>,
        surfaces: &[f64; SHAPE],
    ) -> Option<(Predicted, Row)> {
        let camera = &self.cameras[index];
        let cam_from_board = self.from_first[index] * self.boards[view];
        let in_cam = cam_from_board * in_board;
        let (pixel, by_point) = camera.project_with_jacobian(&in_cam)?;
        let xy = Vector2::new(in_cam.x / in_cam.z, in_cam.y / in_cam.z);
        let (distorted, p) = (camera.distort(&xy), camera.pinhole());
        let first = index * self.shared_per_camera();
        let mut shared = vec![
            (first, Vector2::new(distorted.x, 0.0)),
            (first + 1, Vector2::new(0.0, distorted.y)),
            (first + 2, Vector2::x()),
            (first + 3, Vector2::y()),
        ];
        let by_coefficients = camera.distortion().distort_by_coefficients(&xy);
        for (n, by) in by_coefficients.iter().take(self.lens.coefficient_count()).enumerate() {
            shared.push((first + PINHOLE + n, Vector2::new(p.fx * by.x, p.fy * by.y)));
        }
        if index > 0 {
            let by_pose = by_point * point_by_motion(&in_cam, &Matrix3::identity());
            let at = self.pose_column(index);
            shared.extend((0..POSE).map(|n| (at + n, by_pose.column(n).into_owned())));
        }
        let turn = cam_from_board.rotation.to_rotation_matrix();
        let pose = by_point * point_by_motion(in_board, turn.matrix());
        if self.shape.is_some() {
            let by_height = by_point * turn.matrix().column(2);
            let at = self.shape_column();
            shared.extend(surfaces.iter().enumerate().map(|(n, surface)| (at + n, by_height * *surface)));
        }
        let predicted = Predicted { view, camera: index, pixel, by_point };
        Some((predicted, Row { shared, pose }))
    }

    fn equations(&self, observations: &Observations<'_>) -> Result<Vec<ViewEquations>, AdjustmentError> {
        let of = |view| self.view_equations(observations, view).ok_or(AdjustmentError::NotVisible { view });
        (0..observations.views.len()).map(of).collect()
    }

    /// Errors of all corners of one camera in one view, predicted minus observed, px; `None` if a corner is not visible.
    pub(crate) fn errors(
        &self,
        observations: &Observations<'_>,
        view: usize,
        camera: usize,
    ) -> Option<Vec<Vector2<f64>>> {
        let cam_from_board = self.from_first[camera] * self.boards[view];
        let corners = observations.views[view][camera].corners().iter();
        let of = |corner: &BoardCorner| {
            let in_cam = cam_from_board * self.corner_in_board(observations.board, corner);
            Some(self.cameras[camera].project(&in_cam)? - corner.pixel)
        };
        corners.map(of).collect()
    }

    /// Half the sum of the squared errors, px^2; infinite if a corner is not visible.
    fn cost(&self, observations: &Observations<'_>) -> f64 {
        let all =
            (0..observations.views.len()).flat_map(|view| (0..self.cameras.len()).map(move |camera| (view, camera)));
        let costs = all.map(|(view, camera)| match self.errors(observations, view, camera) {
            Some(errors) => 0.5 * errors.iter().map(Vector2::norm_squared).sum::<f64>(),
            None => f64::INFINITY,
        });
        costs.sum()
    }
}

/// The predicted image of a corner.
pub(crate) struct Predicted {
    pub view: usize,
    pub camera: usize,
    pub pixel: Vector2<f64>,
    /// Derivative of the pixel with respect to the point in the camera frame, px per metre.
    pub by_point: Matrix2x3<f64>,
}

/// The derivatives of one corner's pixel.
struct Row {
    /// Column of a shared parameter, and the derivative with respect to it.
    shared: Vec<(usize, Vector2<f64>)>,
    pose: SMatrix<f64, 2, POSE>,
}

/// Derivative of a point, seen after `turn`, with respect to a motion `[translation; rotation]` of its frame.
pub(crate) fn point_by_motion(point: &Point3<f64>, turn: &Matrix3<f64>) -> SMatrix<f64, 3, POSE> {
    let mut by = SMatrix::<f64, 3, POSE>::zeros();
    by.fixed_view_mut::<3, 3>(0, 0).copy_from(turn);
    by.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-turn * so3::hat(&point.coords)));
    by
}

impl ViewEquations {
    /// Adds the corners of one camera, which all depend on the same parameters.
    fn add(&mut self, rows: &[(Vector2<f64>, Row)]) {
        let Some((_, first)) = rows.first() else { return };
        let count = first.shared.len();
        let (mut shared, mut pose) = (DMatrix::zeros(2 * rows.len(), count), MatrixXx6::zeros(2 * rows.len()));
        let mut errors = DVector::zeros(2 * rows.len());
        for (index, (error, row)) in rows.iter().enumerate() {
            errors.fixed_rows_mut::<2>(2 * index).copy_from(error);
            pose.fixed_view_mut::<2, POSE>(2 * index, 0).copy_from(&row.pose);
            for (n, (_, by)) in row.shared.iter().enumerate() {
                shared.fixed_view_mut::<2, 1>(2 * index, n).copy_from(by);
            }
        }
        let (squares, mixed) = (shared.tr_mul(&shared), shared.tr_mul(&pose));
        let gradient = shared.tr_mul(&errors);
        for (n, (column, _)) in first.shared.iter().enumerate() {
            self.shared_gradient[*column] += gradient[n];
            for (m, (other, _)) in first.shared.iter().enumerate() {
                self.shared[(*column, *other)] += squares[(n, m)];
            }
            for m in 0..POSE {
                self.mixed[(*column, m)] += mixed[(n, m)];
            }
        }
        self.pose += pose.tr_mul(&pose);
        self.pose_gradient += pose.tr_mul(&errors);
        self.cost += 0.5 * errors.norm_squared();
    }

    /// The equations with the diagonal enlarged by the share `damping`.
    fn damped(mut self, damping: f64) -> Self {
        for n in 0..POSE {
            self.pose[(n, n)] *= 1.0 + damping;
        }
        for n in 0..self.shared.nrows() {
            self.shared[(n, n)] *= 1.0 + damping;
        }
        self
    }
}

/// Eliminates the poses; `None` if a view does not determine its pose.
fn reduce(views: &[ViewEquations]) -> Option<Reduced> {
    let count = views.first()?.shared.nrows();
    let mut reduced = Reduced {
        information: DMatrix::zeros(count, count),
        by_view: Vec::with_capacity(views.len()),
        gradients: Vec::with_capacity(views.len()),
        pose_inverses: Vec::with_capacity(views.len()),
        pose_by_shared: Vec::with_capacity(views.len()),
    };
    for view in views {
        let inverse = view.pose.cholesky()?.inverse();
        let follows = -(inverse * view.mixed.transpose());
        let information = &view.shared + &view.mixed * &follows;
        reduced.information += &information;
        reduced.gradients.push(&view.shared_gradient + follows.transpose() * view.pose_gradient);
        reduced.by_view.push(information);
        reduced.pose_inverses.push(inverse);
        reduced.pose_by_shared.push(follows);
    }
    Some(reduced)
}

/// Solves the damped equations for a step of the shared parameters and of each pose.
fn step(views: &[ViewEquations], damping: f64, cameras_stay: bool) -> Option<(DVector<f64>, Vec<Vector6<f64>>)> {
    let damped: Vec<ViewEquations> = views.iter().cloned().map(|view| view.damped(damping)).collect();
    let reduced = reduce(&damped)?;
    let gradient: DVector<f64> = reduced.gradients.iter().sum();
    let shared =
        if cameras_stay { DVector::zeros(gradient.len()) } else { -reduced.information.cholesky()?.solve(&gradient) };
    let pose = |view: usize| {
        let own = -(reduced.pose_inverses[view] * damped[view].pose_gradient);
        let follows = &reduced.pose_by_shared[view] * &shared;
        own + Vector6::from_iterator(follows.iter().copied())
    };
    let poses = (0..views.len()).map(pose).collect();
    Some((shared, poses))
}

/// Adjusts all parameters, or only the board poses if `cameras_stay` is set.
///
/// # Errors
/// A corner is not visible at the start, or no convergence.
pub(crate) fn adjust(
    start: State,
    observations: &Observations<'_>,
    cameras_stay: bool,
) -> Result<State, AdjustmentError> {
    let mut state = start;
    let mut damping = DAMPING[0];
    for _ in 0..STEPS_MAX {
        let equations = state.equations(observations)?;
        let cost: f64 = equations.iter().map(|view| view.cost).sum();
        let better = loop {
            if damping > DAMPING[1] {
                return Ok(state);
            }
            let next =
                step(&equations, damping, cameras_stay).and_then(|(shared, poses)| state.moved(&shared, &poses).ok());
            match next.map(|next| (next.cost(observations), next)) {
                Some((next_cost, next)) if next_cost < cost => break (next_cost, next),
                // Equal cost within rounding also counts as convergence.
                Some((next_cost, next)) if next_cost <= cost * (1.0 + DECREASE_MIN) => break (next_cost, next),
                _ => damping *= 10.0,
            }
        };
        damping = (damping * 0.1).max(1e-12);
        state = better.1;
        if cost - better.0 <= DECREASE_MIN * cost {
            return Ok(state);
        }
    }
    Err(AdjustmentError::NotSettled { steps: STEPS_MAX })
}

/// The reduced equations at a state.
///
/// # Errors
/// A corner is not visible, or the views do not determine a parameter.
pub(crate) fn reduced_at(
    state: &State,
    observations: &Observations<'_>,
    sides: &[&str],
) -> Result<Reduced, AdjustmentError> {
    let equations = state.equations(observations)?;
    let pose = || AdjustmentError::Undetermined { parameter: "the pose of the board".to_owned() };
    let reduced = reduce(&equations).ok_or_else(pose)?;
    let scale = reduced.information.diagonal().map(|value| 1.0 / value.sqrt());
    let scaled = DMatrix::from_diagonal(&scale) * &reduced.information * DMatrix::from_diagonal(&scale);
    let names = state.shared_names(sides);
    let undetermined = |index: usize| AdjustmentError::Undetermined { parameter: names[index].clone() };
    if let Some(index) = scale.iter().position(|value| !value.is_finite()) {
        return Err(undetermined(index));
    }
    let eigen = scaled.symmetric_eigen();
    let (least, greatest) = (eigen.eigenvalues.imin(), eigen.eigenvalues.max());
    if eigen.eigenvalues[least] < 1e-11 * greatest {
        return Err(undetermined(eigen.eigenvectors.column(least).icamax()));
    }
    Ok(reduced)
}

/// The normal equations with `count` additional parameters after the shared ones and the poses eliminated, and the cost, px^2;
/// `None` if a corner is not visible or a view does not determine its pose.
pub(crate) fn reduced_with(
    state: &State,
    observations: &Observations<'_>,
    count: usize,
    columns: impl Fn(&Predicted) -> Vec<(usize, Vector2<f64>)>,
) -> Option<(Reduced, f64)> {
    let of = |view| state.view_equations_with(observations, view, count, &columns);
    let equations: Vec<ViewEquations> = (0..observations.views.len()).map(of).collect::<Option<_>>()?;
    Some((reduce(&equations)?, equations.iter().map(|view| view.cost).sum()))
}
