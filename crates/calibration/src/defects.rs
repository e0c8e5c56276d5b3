//! What the errors of a fit say about how the images were taken: a board that is not flat, a camera that was refocused, a board
//! that moved between the exposures of the two eyes.
//!
//! The shape of the board is a part of the fit. The others add parameters to the model that the fit has none for: they are
//! estimated together, with everything that the fit estimates left free, by one Gauss-Newton step from the end of the fit, where
//! it is exact but for what is of second order in the defects. So a defect is told by its own name and size, however much of it
//! the other parameters have taken up.

use nalgebra::{DMatrix, DVector, Vector2};

use crate::adjust::{Predicted, SHAPE, State, reduced_with};
use crate::board::Chessboard;
use crate::fit::{Fit, View, observations};

/// How large the defects are thought to be before anything is seen: the standard deviation of each parameter. Wide, so that they
/// matter only for what the views do not determine.
const FOCUS_SHARE: f64 = 0.1;
const SHIFT_PX: f64 = 3.0;
/// The noise of corners, px, against which these are weighed.
const NOISE_PX: f64 = 0.1;
/// A change is looked for between views of which at least so many are on each side.
const SIDE_VIEWS_MIN: usize = 3;
/// So many standard deviations are taken off what is found, so that noise is not taken for a defect.
const SIGMAS: f64 = 3.0;

/// What was found; of each the part that noise does not explain.
#[derive(Clone, Debug, PartialEq)]
pub struct Defects {
    /// Distance of the two planes between which the board's corners lie, metres; `None` where the views did not determine its
    /// shape.
    pub flatness_m: Option<f64>,
    /// A camera whose focal length changed.
    pub refocused: Refocused,
    /// How the board moved between the exposures of the two eyes; of a stereo head only.
    pub moved: Option<Moved>,
}

/// The largest change of a focal length that can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refocused {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the first view after the change.
    pub from_view: usize,
    /// By which share of it the focal length changed; 0 if noise explains it.
    pub share: f64,
}

/// How the board in the right image lies beside the place where the left image and the head have it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Root mean square over views, along rows and columns together, less what noise explains, px.
    pub rms_px: f64,
    /// Index of the view with the largest.
    pub worst_view: usize,
}

impl Defects {
    /// What the errors of a fit to these views say; `None` where the equations cannot be solved.
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

/// The defects' parameters: the change of each camera, the shift of each view.
struct Estimate {
    values: DVector<f64>,
    /// Of the values, what they were thought to be before included.
    posterior: DMatrix<f64>,
    /// How they scatter where there are no defects: what the views do not determine stays near zero.
    scatter: DMatrix<f64>,
    cameras: usize,
    from_view: usize,
}

/// The normal equations of everything that the fit estimates, then the focal length of each camera in each view, then the shifts of
/// each view.
struct Equations {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    cost: f64,
    /// How many numbers were seen.
    numbers: usize,
    /// How many of the parameters are the fit's.
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

    /// With one change of each camera's focal length, which stays from a view on.
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

/// The derivatives of a corner's pixel by the focal length of its camera in its view, as a share, and by the shift of its view, px.
fn columns(state: &State, board: &Chessboard, views: usize, at: &Predicted) -> Vec<(usize, Vector2<f64>)> {
    let p = state.cameras[at.camera].pinhole();
    let mut columns = vec![(at.camera * views + at.view, at.pixel - Vector2::new(p.cx, p.cy))];
    if at.camera > 0 {
        // The board moves by what is one pixel at its distance.
        let cam_from_board = state.from_first[at.camera] * state.boards[at.view];
        let middle = cam_from_board * board.corner_in_board(board.columns() / 2, board.rows() / 2);
        let shift = state.cameras.len() * views + 2 * at.view;
        columns.push((shift, at.by_point.column(0) * (middle.z / p.fx)));
        columns.push((shift + 1, at.by_point.column(1) * (middle.z / p.fy)));
    }
    columns
}

impl Estimate {
    /// The change of a camera's focal length that noise does not explain.
    fn refocused(&self, camera: usize) -> Refocused {
        let beyond = self.values[camera].abs() - SIGMAS * self.scatter[(camera, camera)].sqrt();
        Refocused { camera, from_view: self.from_view, share: beyond.max(0.0) }
    }

    /// The shifts of the views less what noise explains.
    ///
    /// If shifts have the standard deviation tau, their squares in units of their information add up to the number of shifts that
    /// the views determine, plus tau^2 times the trace of the information: the estimate of DerSimonian and Laird (Controlled
    /// Clinical Trials 7 (1986), section 3), less the scatter of that sum.
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

/// From the lowest to the highest corner of the board, less what noise explains.
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
