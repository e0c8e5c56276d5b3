//! Verifies a calibration: with new views of the board, against a second calibration, and against measured lengths and points.
//!
//! The results are combined into one figure: the expected hand error at the working distance.

pub mod against;
pub mod lens;
pub mod limits;
pub mod touch;

use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use pb3dp_geometry::{RectificationError, StereoRig};

use self::against::Known;
use crate::adjust::{AdjustmentError, Observations, State, adjust};
use crate::board::{Chessboard, Sighting};
use crate::fit::{View, sides};
use crate::lens::LensModel;
use crate::quality::{RowError, row_error};
use crate::start::board_pose;

/// Minimum ratio of the view depths to estimate a change of scale with depth.
const DEPTH_RATIO_MIN: f64 = 1.15;
/// Minimum number of views for a slope.
const SLOPE_VIEWS_MIN: usize = 4;

/// Why a calibration could not be verified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum VerifyError {
    /// No views.
    #[error("no view shows the board in both images; take views as for a calibration")]
    NoViews,
    /// The board pose could not be computed.
    #[error("view {name}: no board pose with this calibration: {reason}")]
    View {
        /// The view.
        name: String,
        /// The reason.
        reason: String,
    },
    /// The stereo pair cannot be rectified.
    #[error("the stereo pair cannot be rectified")]
    Rectification(#[from] RectificationError),
    /// A corner that is not on the board, or that no view shows.
    #[error(
        "corner {column},{row} is visible to both cameras in no view; give column and row of a corner, counted from 0,0"
    )]
    Corner {
        /// Its column.
        column: u32,
        /// Its row.
        row: u32,
    },
}

/// One view evaluated with a known calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedView {
    /// Its name.
    pub name: String,
    /// Root mean square distance between predicted and detected corners, both cameras, with only the board pose fitted; px.
    pub reprojection_rms_px: f64,
    /// Depth of the board centre in the left camera, metres.
    pub depth_m: f64,
    /// Triangulated length of the squares over the stated one; 1 if the calibration is correct.
    pub scale: f64,
    /// Root mean square distance of the triangulated corners from a plane, metres; includes corner noise.
    pub flatness_m: f64,
}

/// New views evaluated with a known calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// View by view.
    pub views: Vec<CheckedView>,
    /// Over all corners, px.
    pub reprojection_rms_px: f64,
    /// Vertical misalignment of the rectified images.
    pub rows: RowError,
}

/// The scale at a depth, from views at several depths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleAt {
    /// Measured over true length.
    pub scale: f64,
    /// Standard deviation of the scale, from the scatter of the views.
    pub sigma: f64,
    /// Change of the scale per metre of depth, if the views determine it.
    pub slope_per_m: Option<f64>,
}

/// Evaluates views with a fixed calibration.
///
/// # Errors
/// No views, or a view without a board pose.
pub fn check(rig: &StereoRig, views: &[View<2>], board: &Chessboard) -> Result<Checked, VerifyError> {
    if views.is_empty() {
        return Err(VerifyError::NoViews);
    }
    let mut checked = Vec::with_capacity(views.len());
    let (mut squares, mut corners) = (0.0, 0_usize);
    for view in views {
        let refuse = |reason: String| VerifyError::View { name: view.name.clone(), reason };
        let (sum, count) = pose_errors(rig, view, board).map_err(|error| refuse(error.to_string()))?;
        let (on_board, in_cam_left) = triangulated(rig, view, board);
        let similarity = similarity(&on_board, &in_cam_left);
        let Similarity { scale, flatness, middle } =
            similarity.ok_or_else(|| refuse("fewer than four corners are visible to both cameras".to_owned()))?;
        squares += sum;
        corners += count;
        checked.push(CheckedView {
            name: view.name.clone(),
            reprojection_rms_px: (sum / count.max(1) as f64).sqrt(),
            depth_m: middle.z,
            scale,
            flatness_m: flatness,
        });
    }
    let reprojection_rms_px = (squares / corners.max(1) as f64).sqrt();
    Ok(Checked { views: checked, reprojection_rms_px, rows: row_error(rig, views)? })
}

impl Checked {
    /// The scale at a depth: a line over the view depths if they differ enough, otherwise the mean. An error of the disparity
    /// makes the scale change with depth; an error of the baseline or of the squares does not.
    pub fn scale_at(&self, depth_m: f64) -> ScaleAt {
        let count = self.views.len() as f64;
        let mean = |of: &dyn Fn(&CheckedView) -> f64| self.views.iter().map(of).sum::<f64>() / count.max(1.0);
        let (depth, scale) = (mean(&|view| view.depth_m), mean(&|view| view.scale));
        let spread = mean(&|view| (view.depth_m - depth).powi(2));
        let depths = self.views.iter().map(|view| view.depth_m);
        let (near, far) = depths.fold((f64::INFINITY, 0.0_f64), |(near, far), z| (near.min(z), far.max(z)));
        let tells_slope = self.views.len() >= SLOPE_VIEWS_MIN && far >= DEPTH_RATIO_MIN * near;
        let slope = if tells_slope { mean(&|view| (view.depth_m - depth) * view.scale) / spread } else { 0.0 };
        let residual = mean(&|view| (view.scale - scale - slope * (view.depth_m - depth)).powi(2));
        let freedom = (count - if tells_slope { 2.0 } else { 1.0 }).max(1.0);
        let leverage = if tells_slope { (depth_m - depth).powi(2) / spread } else { 0.0 };
        let sigma = (residual * count / freedom * (1.0 + leverage) / count.max(1.0)).sqrt();
        ScaleAt { scale: scale + slope * (depth_m - depth), sigma, slope_per_m: tells_slope.then_some(slope) }
    }
}

/// Sum of the squared errors of all corners with the board pose fitted, px^2, and the number of corners.
fn pose_errors(rig: &StereoRig, view: &View<2>, board: &Chessboard) -> Result<(f64, usize), AdjustmentError> {
    let unplaced = || AdjustmentError::Undetermined { parameter: "the pose of the board".to_owned() };
    let observations = Observations { board, views: vec![view.sightings.iter().collect()] };
    let boards = vec![board_pose(rig.left(), &view.sightings[0], board).ok_or_else(unplaced)?];
    let start = State { boards, ..State::of_rig(rig, LensModel::Radial1) };
    let state = adjust(start, &observations, true)?;
    let mut squares = (0.0, 0);
    for camera in 0..2 {
        let errors = state.errors(&observations, 0, camera).ok_or(AdjustmentError::NotVisible { view: 0 })?;
        squares.0 += errors.iter().map(Vector2::norm_squared).sum::<f64>();
        squares.1 += errors.len();
    }
    Ok(squares)
}

/// Standard deviation of the depth of a point straight ahead according to the covariance of a calibration, metres; `None` if the
/// covariance is incomplete.
pub fn depth_sigma_m(known: &Known, depth_m: f64) -> Option<f64> {
    let is_it = |state: &State| state.shared_names(&sides::<2>()) == known.names;
    let state = LensModel::ALL.into_iter().map(|lens| State::of_rig(&known.rig, lens)).find(is_it)?;
    crate::depth::sigma_m(&state, &known.covariance, depth_m).ok()
}

/// The point in `cam_left` triangulated from two pixels, metres: the midpoint between the rays. `None` outside the valid range of
/// a lens model.
pub fn triangulate(rig: &StereoRig, left_px: &Vector2<f64>, right_px: &Vector2<f64>) -> Option<Point3<f64>> {
    let point = crate::depth::triangulated(rig, left_px, right_px)?;
    point.iter().all(|value| value.is_finite()).then(|| point.into())
}

/// The corners visible to both cameras: on the board, and triangulated.
fn triangulated(rig: &StereoRig, view: &View<2>, board: &Chessboard) -> (Vec<Point3<f64>>, Vec<Point3<f64>>) {
    let [left, right] = &view.sightings;
    let both = left.corners().iter().filter_map(|corner| {
        let other = right.at(corner.column, corner.row)?;
        let in_cam_left = triangulate(rig, &corner.pixel, &other.pixel)?;
        Some((board.corner_in_board(corner.column, corner.row), in_cam_left))
    });
    both.unzip()
}

/// Triangulated size of the squares over the stated size, the median over neighbouring corners of all views. `None` if too few
/// corners are visible to both cameras. The value is far from 1 if the square size was entered wrong, independently of other
/// errors.
pub fn length_ratio<'a>(
    rig: &StereoRig,
    views: impl Iterator<Item = &'a [Sighting; 2]>,
    board: &Chessboard,
) -> Option<f64> {
    let mut ratios = Vec::new();
    for [left, right] in views {
        let visible =
            |column: u32, row: u32| triangulate(rig, &left.at(column, row)?.pixel, &right.at(column, row)?.pixel);
        for corner in left.corners() {
            let (column, row) = (corner.column, corner.row);
            for (next_column, next_row) in [(column + 1, row), (column, row + 1)] {
                let Some((here, there)) = visible(column, row).zip(visible(next_column, next_row)) else { continue };
                let stated_m =
                    (board.corner_in_board(next_column, next_row) - board.corner_in_board(column, row)).norm();
                ratios.push((there - here).norm() / stated_m);
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    ratios.get(ratios.len() / 2).copied().filter(|ratio| ratio.is_finite())
}

/// A corner of the board in `cam_left`, metres; `None` if not both cameras see it.
pub fn corner_in_cam_left(rig: &StereoRig, view: &View<2>, [column, row]: [u32; 2]) -> Option<Point3<f64>> {
    let [left, right] = &view.sightings;
    triangulate(rig, &left.at(column, row)?.pixel, &right.at(column, row)?.pixel)
}

/// Triangulated distance of two board corners, view by view, metres.
///
/// # Errors
/// No view shows one of the corners.
pub fn lengths_m(rig: &StereoRig, views: &[View<2>], corners: [[u32; 2]; 2]) -> Result<Vec<f64>, VerifyError> {
    for [column, row] in corners {
        if views.iter().all(|view| corner_in_cam_left(rig, view, [column, row]).is_none()) {
            return Err(VerifyError::Corner { column, row });
        }
    }
    let length = |view: &View<2>| {
        let [a, b] = corners.map(|corner| corner_in_cam_left(rig, view, corner));
        Some((a? - b?).norm())
    };
    Ok(views.iter().filter_map(length).collect())
}

/// The similarity between triangulated points and board points.
struct Similarity {
    scale: f64,
    flatness: f64,
    middle: Vector3<f64>,
}

/// The scale between the first and the second points (Umeyama, TPAMI 13 (1991), equations 40 to 42), and the distance of the
/// second points from a plane.
fn similarity(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Similarity> {
    if from.len() < 4 {
        return None;
    }
    let count = from.len() as f64;
    let mean = |points: &[Point3<f64>]| points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / count;
    let (from_mean, to_mean) = (mean(from), mean(to));
    let (mut mixed, mut own, mut square) = (Matrix3::zeros(), Matrix3::zeros(), 0.0);
    for (a, b) in from.iter().zip(to) {
        let (a, b) = (a.coords - from_mean, b.coords - to_mean);
        mixed += b * a.transpose();
        own += b * b.transpose();
        square += a.norm_squared();
    }
    let svd = mixed.svd(true, true);
    let is_mirrored = (svd.u? * svd.v_t?).determinant() < 0.0;
    let mut values = [svd.singular_values[0], svd.singular_values[1], svd.singular_values[2]];
    values.sort_by(|a, b| b.total_cmp(a));
    let scale = (values[0] + values[1] + if is_mirrored { -values[2] } else { values[2] }) / square;
    let flatness = (own.symmetric_eigenvalues().min().max(0.0) / count).sqrt();
    scale.is_finite().then_some(Similarity { scale, flatness, middle: to_mean })
}
