//! Whether a calibration still holds: on fresh views of the board, against a second calibration, and against lengths and places
//! that somebody has measured.
//!
//! Whatever is measured is put into one number that counts: how far the hand will be off at the working distance.

pub mod against;
pub mod limits;
pub mod touch;

use nalgebra::{Isometry3, Matrix3, Point3, Vector2, Vector3};
use pb3dp_geometry::{RectificationError, StereoRig};

use self::against::Known;
use crate::adjust::{AdjustmentError, Observations, State, adjust};
use crate::board::{Chessboard, Sighting};
use crate::depth::meeting;
use crate::fit::{View, sides};
use crate::lens::LensModel;
use crate::quality::{RowError, row_error};
use crate::start::board_pose;

/// The scale is taken to change with depth where the views' depths differ by this ratio at least.
const DEPTH_RATIO_MIN: f64 = 1.15;
/// Fewer views tell no slope.
const SLOPE_VIEWS_MIN: usize = 4;

/// Why a calibration cannot be verified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum VerifyError {
    /// Nothing to look at.
    #[error("no view shows the board in both images: take some as for a calibration")]
    NoViews,
    /// A board that cannot be placed.
    #[error("view {name}: this calibration cannot place the board: {reason}")]
    View {
        /// The view.
        name: String,
        /// What went wrong.
        reason: String,
    },
    /// It cannot be rectified.
    #[error("the pair cannot be rectified")]
    Rectification(#[from] RectificationError),
    /// A corner that the board does not have, or no view shows.
    #[error("corner {column},{row} is seen by both cameras in no view: give column and row of a corner, from 0,0")]
    Corner {
        /// Its column.
        column: u32,
        /// Its row.
        row: u32,
    },
}

/// One view as a known calibration sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedView {
    /// Its name.
    pub name: String,
    /// Root mean square of the distance between predicted and seen corners, both cameras, only the board's pose fitted; px.
    pub reprojection_rms_px: f64,
    /// Depth of the board's middle in the left camera, metres.
    pub depth_m: f64,
    /// Length of the squares as triangulated over the stated one; 1 if the calibration is right.
    pub scale: f64,
    /// Root mean square of the distance of the triangulated corners from a plane, metres; noise of the corners is in it.
    pub flatness_m: f64,
}

/// Fresh views as a known calibration sees them.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// View by view.
    pub views: Vec<CheckedView>,
    /// Of all corners, px.
    pub reprojection_rms_px: f64,
    /// Rows of the rectified images.
    pub rows: RowError,
}

/// The scale at a depth, from views at several ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleAt {
    /// Measured over true length.
    pub scale: f64,
    /// Standard deviation of it, from how much views differ.
    pub sigma: f64,
    /// Change of the scale per metre of depth, where the views tell it.
    pub slope_per_m: Option<f64>,
}

/// Looks at views with a calibration that stays as it is.
///
/// # Errors
/// No views, or one whose board the calibration cannot place.
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
            similarity.ok_or_else(|| refuse("fewer than four of its corners are seen by both cameras".to_owned()))?;
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
    /// The scale at a depth: a line over the depths of the views where they differ enough, else the mean. An error of the disparity
    /// makes the scale change with depth, an error of the baseline or of the squares does not.
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

/// Sum of squared errors of all corners with the board's pose fitted, px^2, and their number.
fn pose_errors(rig: &StereoRig, view: &View<2>, board: &Chessboard) -> Result<(f64, usize), AdjustmentError> {
    let unplaced = || AdjustmentError::Undetermined { parameter: "the pose of the board".to_owned() };
    let observations = Observations { board, views: vec![view.sightings.iter().collect()] };
    let start = State {
        // Not used where cameras stay.
        lens: LensModel::Radial1,
        cameras: vec![*rig.left(), *rig.right()],
        from_first: vec![Isometry3::identity(), *rig.cam_right_from_cam_left().isometry()],
        boards: vec![board_pose(rig.left(), &view.sightings[0], board).ok_or_else(unplaced)?],
        shape: None,
    };
    let state = adjust(start, &observations, true)?;
    let mut squares = (0.0, 0);
    for camera in 0..2 {
        let errors = state.errors(&observations, 0, camera).ok_or(AdjustmentError::NotVisible { view: 0 })?;
        squares.0 += errors.iter().map(Vector2::norm_squared).sum::<f64>();
        squares.1 += errors.len();
    }
    Ok(squares)
}

/// Standard deviation of the depth of a point straight ahead that a calibration leaves by its own account, metres; `None` if it does
/// not say enough.
pub fn depth_sigma_m(known: &Known, depth_m: f64) -> Option<f64> {
    let cameras = vec![*known.rig.left(), *known.rig.right()];
    let from_first = vec![Isometry3::identity(), *known.rig.cam_right_from_cam_left().isometry()];
    let state = |lens| {
        let (cameras, from_first) = (cameras.clone(), from_first.clone());
        State { lens, cameras, from_first, boards: Vec::new(), shape: None }
    };
    let is_it = |state: &State| state.shared_names(&sides::<2>()) == known.names;
    let state = LensModel::ALL.into_iter().map(state).find(is_it)?;
    crate::depth::sigma_m(&state, &known.covariance, depth_m).ok()
}

/// A point that both cameras see, in `cam_left`, metres: the middle between its two rays. `None` beyond what a lens can image.
pub fn triangulate(rig: &StereoRig, left_px: &Vector2<f64>, right_px: &Vector2<f64>) -> Option<Point3<f64>> {
    let (a, b) = (rig.left().unproject(left_px).ok()?, rig.right().unproject(right_px).ok()?);
    let cam_left_from_cam_right = rig.cam_right_from_cam_left().inverse();
    let point = meeting(&a, &cam_left_from_cam_right.transform_vector(&b), &cam_left_from_cam_right.translation_m());
    point.iter().all(|value| value.is_finite()).then(|| point.into())
}

/// The corners that both cameras see: on the board, and triangulated.
fn triangulated(rig: &StereoRig, view: &View<2>, board: &Chessboard) -> (Vec<Point3<f64>>, Vec<Point3<f64>>) {
    let [left, right] = &view.sightings;
    let both = left.corners().iter().filter_map(|corner| {
        let other = right.at(corner.column, corner.row)?;
        let in_cam_left = triangulate(rig, &corner.pixel, &other.pixel)?;
        Some((board.corner_in_board(corner.column, corner.row), in_cam_left))
    });
    both.unzip()
}

/// How long the squares of a board are by triangulation over how long they are said to be, the median over neighbouring corners of all
/// views; `None` where too few corners are seen by both cameras. It is far from 1 where the squares were typed wrong, whatever else is.
pub fn length_ratio<'a>(
    rig: &StereoRig,
    views: impl Iterator<Item = &'a [Sighting; 2]>,
    board: &Chessboard,
) -> Option<f64> {
    let mut ratios = Vec::new();
    for [left, right] in views {
        let seen =
            |column: u32, row: u32| triangulate(rig, &left.at(column, row)?.pixel, &right.at(column, row)?.pixel);
        for corner in left.corners() {
            let (column, row) = (corner.column, corner.row);
            for (next_column, next_row) in [(column + 1, row), (column, row + 1)] {
                let Some((here, there)) = seen(column, row).zip(seen(next_column, next_row)) else { continue };
                let stated_m =
                    (board.corner_in_board(next_column, next_row) - board.corner_in_board(column, row)).norm();
                ratios.push((there - here).norm() / stated_m);
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    ratios.get(ratios.len() / 2).copied().filter(|ratio| ratio.is_finite())
}

/// Where a corner of the board is in `cam_left` in a view, metres; `None` if not both cameras see it.
pub fn corner_in_cam_left(rig: &StereoRig, view: &View<2>, [column, row]: [u32; 2]) -> Option<Point3<f64>> {
    let [left, right] = &view.sightings;
    triangulate(rig, &left.at(column, row)?.pixel, &right.at(column, row)?.pixel)
}

/// The distance of two corners of the board as triangulated, view by view, metres.
///
/// # Errors
/// A corner that no view shows.
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

/// How triangulated points lie beside those of the board.
struct Similarity {
    scale: f64,
    flatness: f64,
    middle: Vector3<f64>,
}

/// The scale that takes the first points to the second ones (Umeyama, TPAMI 13 (1991), equations 40 to 42), and how far the second
/// ones are from a plane.
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
