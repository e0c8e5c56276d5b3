//! Detects defects of the image set from the residuals of a fit: a board that is not flat, a camera that was refocused, a board
//! that moved between the exposures of the two cameras.
//!
//! The board shape is part of the fit. The other defects add parameters that the fit does not have. They are estimated together
//! with all parameters of the fit, by one Gauss-Newton step from the solution of the fit; the step is exact up to second order in
//! the defects. Each defect is therefore reported with its own name and size, even if other parameters have absorbed part of it.

use nalgebra::{DMatrix, DVector, Vector2};

use crate::adjust::{Predicted, SHAPE, State, reduced_with};
use crate::board::Chessboard;
use crate::fit::{Fit, View, observations};

/// Prior standard deviation of each defect parameter. The priors are wide, so that they only matter for parameters that the views
/// do not determine.
const FOCUS_SHARE: f64 = 0.1;
const SHIFT_PX: f64 = 3.0;
/// Assumed corner noise, px, for weighting the priors.
const NOISE_PX: f64 = 0.1;
/// Minimum number of views on each side of a searched focal length change.
const SIDE_VIEWS_MIN: usize = 3;
/// Number of standard deviations subtracted from each result, so that noise is not reported as a defect.
const SIGMAS: f64 = 3.0;

/// The detected defects; noise is subtracted from each value.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Distance between the two planes that enclose the board corners, metres; `None` if the views do not determine the board
    /// shape.
    pub flatness_m: Option<f64>,
    /// A camera whose focal length changed.
    pub refocused: Refocused,
    /// Motion of the board between the exposures of the two cameras; only for a stereo rig.
    pub moved: Option<Moved>,
}

/// The largest detected change of a focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refocused {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the first view after the change.
    pub from_view: usize,
    /// Relative change of the focal length; 0 if noise explains it.
    pub share: f64,
}

/// Displacement of the board in the right image from the position predicted by the left image and the stereo rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Root mean square over the views, rows and columns together, noise subtracted, px.
    pub rms_px: f64,
    /// Index of the view with the largest displacement.
    pub worst_view: usize,
}

impl Defects {
    /// Estimates the defects from the residuals of a fit to these views; `None` if the equations cannot be solved.
    pub fn of<const N: usize>(fit: &Fit<N>, views: &[View<N>]) -> Option<Self> {
        let changes = SIDE_VIEWS_MIN..=views.len().saturating_sub(SIDE_VIEWS_MIN);
        let equations = Equations::of(fit, views)?;
        let all: Vec<Estimate> = changes.clone().map(|from_view| equations.solved(from_view)).collect::<Option<_>>()?;
        let refocused = all.iter().flat_map(|estimate| (0..N).map(|camera| estimate.refocused(camera)));
        let refocused = refocused.max_by(|a, b| a.share.total_cmp(&b.share));
        let best = match refocused {
            Some(found) => all.into_iter().nth(found.from_view - changes.start())?,
            None => equations.solved(views.len())?,
        };
        let none = Refocused { camera: 0, from_view: views.len(), share: 0.0 };
        Some(Self {
            flatness_m: flatness_m(fit),
            refocused: refocused.unwrap_or(none),
            moved: if N > 1 { Some(best.moved(views.len())?) } else { None },
        })
    }
}

/// The defect parameters: the change of each camera, the shift of each view.
struct Estimate {
    values: DVector<f64>,
    /// Posterior covariance of the values, priors included.
    posterior: DMatrix<f64>,
    /// Covariance of the estimates if there are no defects; parameters that the views do not determine stay near zero.
    scatter: DMatrix<f64>,
    cameras: usize,
    from_view: usize,
}

/// The normal equations of all fit parameters, then the focal length of each camera in each view, then the shifts of each view.
struct Equations {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    cost: f64,
    /// Number of observations.
    numbers: usize,
    /// Number of fit parameters.
    first: usize,
    cameras: usize,
    views: usize,
}

impl Equations {
    fn of<const N: usize>(fit: &Fit<N>, views: &[View<N>]) -> Option<Self> {
        let state = &fit.state;
        let (focus, shifts) = (N * views.len(), if N > 1 { 2 * views.len() } else { 0 });
        let columns = |at: &Predicted| columns(state, &fit.board, views.len(), at);
        let (reduced, cost) = reduced_with(state, &observations(views, &fit.board), focus + shifts, columns)?;
        Some(Self {
            information: reduced.information,
            gradient: reduced.gradients.iter().sum(),
            cost,
            numbers: 2 * fit.errors().iter().flatten().map(Vec::len).sum::<usize>(),
            first: state.shared_count(),
            cameras: N,
            views: views.len(),
        })
    }

    /// Solves with one change of each camera's focal length, from the given view on.
    fn solved(&self, from_view: usize) -> Option<Estimate> {
        let behind = self.first + self.cameras * self.views;
        let count = self.information.nrows() - behind + self.cameras;
        let mut of_all = DMatrix::zeros(self.information.nrows(), self.first + count);
        of_all.view_mut((0, 0), (self.first, self.first)).fill_with_identity();
        for camera in 0..self.cameras {
            for view in from_view..self.views {
                of_all[(self.first + camera * self.views + view, self.first + camera)] = 1.0;
            }
        }
        for n in self.cameras..count {
            of_all[(behind + n - self.cameras, self.first + n)] = 1.0;
        }
        let gradient = of_all.tr_mul(&self.gradient);
        let before = |n: usize| match n.checked_sub(self.first) {
            None => 0.0,
            Some(n) if n < self.cameras => (NOISE_PX / FOCUS_SHARE).powi(2),
            Some(_) => (NOISE_PX / SHIFT_PX).powi(2),
        };
        let before = DMatrix::from_diagonal(&DVector::from_fn(self.first + count, |n, _| before(n)));
        let information = of_all.tr_mul(&(&self.information * &of_all)) + &before;
        let scale = DMatrix::from_diagonal(&information.diagonal().map(|value| 1.0 / value.sqrt()));
        let inverse = &scale * (&scale * &information * &scale).cholesky()?.inverse() * &scale;
        let step = -(&inverse * &gradient);
        let scatter = &inverse - &inverse * before * &inverse;
        let left = 2.0 * self.cost + gradient.dot(&step);
        let parameters = self.first + count + crate::adjust::POSE * self.views;
        let variance = left / self.numbers.saturating_sub(parameters).max(1) as f64;
        let of = |matrix: &DMatrix<f64>| matrix.view((self.first, self.first), (count, count)) * variance;
        Some(Estimate {
            values: step.rows(self.first, count).into_owned(),
            posterior: of(&inverse),
            scatter: of(&scatter),
            cameras: self.cameras,
            from_view,
        })
    }
}

/// Derivatives of a corner's pixel with respect to the relative focal length of its camera in its view, and to the shift of its
/// view, px.
fn columns(state: &State, board: &Chessboard, views: usize, at: &Predicted) -> Vec<(usize, Vector2<f64>)> {
    let p = state.cameras[at.camera].pinhole();
    let mut columns = vec![(at.camera * views + at.view, at.pixel - Vector2::new(p.cx, p.cy))];
    if at.camera > 0 {
        // A shift of the board that corresponds to one pixel at its distance.
        let cam_from_board = state.from_first[at.camera] * state.boards[at.view];
        let middle = cam_from_board * board.corner_in_board(board.columns() / 2, board.rows() / 2);
        let shift = state.cameras.len() * views + 2 * at.view;
        columns.push((shift, at.by_point.column(0) * (middle.z / p.fx)));
        columns.push((shift + 1, at.by_point.column(1) * (middle.z / p.fy)));
    }
    columns
}

impl Estimate {
    /// The change of a camera's focal length, noise subtracted.
    fn refocused(&self, camera: usize) -> Refocused {
        let beyond = self.values[camera].abs() - SIGMAS * self.scatter[(camera, camera)].sqrt();
        Refocused { camera, from_view: self.from_view, share: beyond.max(0.0) }
    }

    /// The shifts of the views, noise subtracted.
    ///
    /// If shifts have the standard deviation tau, the sum of their squares, weighted by their information, is the number of
    /// shifts that the views determine plus tau^2 times the trace of the information. This is the estimate of DerSimonian and
    /// Laird (Controlled Clinical Trials 7 (1986), section 3), minus the scatter of that sum.
    fn moved(&self, views: usize) -> Option<Moved> {
        let (first, count) = (self.cameras, 2 * views);
        let shifts = self.values.rows(first, count).into_owned();
        let (posterior, scatter) =
            (self.posterior.view((first, first), (count, count)), self.scatter.view((first, first), (count, count)));
        let information = posterior.into_owned().cholesky()?.inverse();
        let squares = shifts.dot(&(&information * &shifts));
        let determined = &information * scatter;
        let (number, trace) = (determined.trace(), (&determined * &information).trace());
        let beyond = squares - number - SIGMAS * (2.0 * number).sqrt();
        let square = |view: usize| shifts.rows(2 * view, 2).norm_squared();
        let worst_view = (0..views).max_by(|a, b| square(*a).total_cmp(&square(*b))).unwrap_or(0);
        Some(Moved { rms_px: (beyond.max(0.0) / trace).sqrt(), worst_view })
    }
}

/// Height between the lowest and the highest corner of the board, noise subtracted.
fn flatness_m<const N: usize>(fit: &Fit<N>) -> Option<f64> {
    let shape = DVector::from_row_slice(&fit.board_shape_m()?);
    let board = &fit.board;
    let corners = (0..board.rows()).flat_map(|row| (0..board.columns()).map(move |column| (column, row)));
    let heights: Vec<(f64, DVector<f64>)> = corners
        .map(|(column, row)| {
            let surfaces = DVector::from_row_slice(&board.surfaces(column, row));
            (surfaces.dot(&shape), surfaces)
        })
        .collect();
    let order = |a: &&(f64, DVector<f64>), b: &&(f64, DVector<f64>)| a.0.total_cmp(&b.0);
    let (low, high) = (heights.iter().min_by(order)?, heights.iter().max_by(order)?);
    let surfaces = &high.1 - &low.1;
    let at = fit.state.shape_column();
    let covariance = fit.covariance().matrix.view((at, at), (SHAPE, SHAPE));
    let variance = surfaces.dot(&(covariance * &surfaces));
    Some((high.0 - low.0 - SIGMAS * variance.max(0.0).sqrt()).max(0.0))
}
