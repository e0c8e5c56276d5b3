//! Quality figures of a calibration, judged by the gates.

use nalgebra::{Vector2, Vector3};
use pb3dp_geometry::{Camera, ImageSize, RectificationError, StereoRig};

use crate::board::Sighting;
use crate::defects::Defects;
use crate::fit::{CornerError, Fit, View};
use crate::fitted_rig::FitError;
use crate::held_out::Chosen;
use crate::stand::Cells;

/// Number of views that must be tilted at least by the reported tilt.
const TILTED_VIEWS: usize = 3;

/// Vertical misalignment (epipolar error) of the rectified images, right row minus left row, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowError {
    /// Root mean square.
    pub rms_px: f64,
    /// Mean: a constant shift.
    pub mean_px: f64,
    /// 95th percentile of the absolute value.
    pub p95_px: f64,
}

/// The quality figures of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Quality {
    /// Number of views used.
    pub views: usize,
    /// Number of corners in all views and cameras.
    pub corners: usize,
    /// Reprojection error: root mean square distance between predicted and detected corners, px, all cameras together.
    pub reprojection_rms_px: f64,
    /// Reprojection error per camera.
    pub reprojection_rms_by_camera_px: Vec<f64>,
    /// Reprojection error per view.
    pub reprojection_rms_by_view_px: Vec<(String, f64)>,
    /// Reprojection error of held-out views.
    pub held_out_rms_px: f64,
    /// Share of the image cells that contain a corner, of the camera with the lowest share.
    pub coverage: f64,
    /// At least three views show the board tilted by this angle or more, degrees.
    pub tilt_deg: f64,
    /// Detected defects of the board and of the image set; `None` if they could not be estimated.
    pub defects: Option<Defects>,
    /// Baseline divided by an independently measured one, minus 1; only if one was given.
    pub scale_error_share: Option<f64>,
    /// Vertical misalignment of the rectified images; only for a stereo rig.
    pub rows: Option<RowError>,
    /// Standard deviation of depth caused by the calibration at the working distance, as a share of it; only for a stereo rig.
    pub depth_sigma_share: Option<f64>,
}

impl Quality {
    /// Index, name and root mean square of the errors in px of each view, the largest first.
    pub fn views_by_error(&self) -> Vec<(usize, &str, f64)> {
        let views = self.reprojection_rms_by_view_px.iter().enumerate();
        let mut views: Vec<_> = views.map(|(index, (name, rms_px))| (index, name.as_str(), *rms_px)).collect();
        views.sort_by(|a, b| b.2.total_cmp(&a.2));
        views
    }

    /// Error of held-out views divided by the error of the fitted views.
    pub fn held_out_ratio(&self) -> f64 {
        self.held_out_rms_px / self.reprojection_rms_px
    }

    /// The same with the scale judged by an independently known baseline, from a ruler or the data sheet.
    #[must_use]
    pub fn with_known_baseline(self, rig: &StereoRig, known_m: f64) -> Self {
        Self { scale_error_share: Some(rig.baseline_m() / known_m - 1.0), ..self }
    }

    /// The quality of a single camera.
    pub fn of_camera(chosen: &Chosen<1>, views: &[View<1>], size: ImageSize) -> Self {
        of(chosen, views, size)
    }

    /// The quality of a stereo rig with working distance `depth_m`.
    ///
    /// # Errors
    /// The stereo pair cannot be rectified.
    pub fn of_stereo(
        chosen: &Chosen<2>,
        views: &[View<2>],
        size: ImageSize,
        depth_m: f64,
    ) -> Result<Self, QualityError> {
        let rows = row_error(&chosen.fit.rig()?, views)?;
        let depth_sigma_share = Some(chosen.fit.depth_sigma_m(depth_m)? / depth_m);
        Ok(Self { rows: Some(rows), depth_sigma_share, ..of(chosen, views, size) })
    }
}

/// Why a stereo calibration could not be judged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QualityError {
    /// The cameras do not form a valid stereo rig.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The stereo pair cannot be rectified.
    #[error("the stereo pair cannot be rectified")]
    Rectification(#[from] RectificationError),
}

fn of<const N: usize>(chosen: &Chosen<N>, views: &[View<N>], size: ImageSize) -> Quality {
    let errors = chosen.fit.errors();
    let rms = |list: &mut dyn Iterator<Item = &CornerError>| {
        let (sum, count) =
            list.fold((0.0, 0_usize), |(sum, count), corner| (sum + corner.error_px.norm_squared(), count + 1));
        (sum / count.max(1) as f64).sqrt()
    };
    let by_view =
        views.iter().zip(errors).map(|(view, of_view)| (view.name.clone(), rms(&mut of_view.iter().flatten())));
    Quality {
        views: views.len(),
        corners: errors.iter().flatten().map(Vec::len).sum(),
        reprojection_rms_px: rms(&mut errors.iter().flatten().flatten()),
        reprojection_rms_by_camera_px: (0..N)
            .map(|camera| rms(&mut errors.iter().flat_map(|of| &of[camera])))
            .collect(),
        reprojection_rms_by_view_px: by_view.collect(),
        held_out_rms_px: chosen.held_out_rms_px,
        coverage: (0..N)
            .map(|camera| coverage(views.iter().map(|view| &view.sightings[camera]), size))
            .fold(1.0, f64::min),
        tilt_deg: tilt_deg(&chosen.fit),
        defects: Defects::of(&chosen.fit, views),
        scale_error_share: None,
        rows: None,
        depth_sigma_share: None,
    }
}

/// Share of the image cells that contain a corner.
fn coverage<'a>(sightings: impl Iterator<Item = &'a Sighting>, size: ImageSize) -> f64 {
    sightings.fold(Cells::default(), |cells, sighting| cells.with(Cells::of(sighting, size))).share()
}

/// Angle between the board normal and the axis of the first camera in the third most tilted view, degrees.
fn tilt_deg<const N: usize>(fit: &Fit<N>) -> f64 {
    let tilt = |normal: Vector3<f64>| normal.z.abs().min(1.0).acos().to_degrees();
    let mut tilts: Vec<f64> =
        fit.cam_left_from_board().map(|pose| tilt(pose.transform_vector(&Vector3::z()))).collect();
    tilts.sort_by(|a, b| b.total_cmp(a));
    tilts.get(TILTED_VIEWS - 1).copied().unwrap_or(0.0)
}

/// Vertical misalignment of one corner in the rectified images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowDifference {
    /// Position in the left image, px.
    pub left_px: Vector2<f64>,
    /// Right row minus left row, px of the rectified images.
    pub difference_px: f64,
}

/// Vertical misalignment of all corners detected in both cameras.
///
/// # Errors
/// The stereo pair cannot be rectified.
pub fn row_differences(rig: &StereoRig, views: &[View<2>]) -> Result<Vec<RowDifference>, RectificationError> {
    let rectified = rig.rectify()?;
    let (left_turn, right_turn) = (
        rectified.cam_left_rect_from_cam_left.rotation_matrix(),
        rectified.cam_right_rect_from_cam_right.rotation_matrix(),
    );
    let row = |camera: &Camera, turn: &nalgebra::Matrix3<f64>, ideal: &Camera, pixel: &Vector2<f64>| -> Option<f64> {
        let ray = turn * camera.unproject(pixel).ok()?;
        Some(ideal.project(&ray.into())?.y)
    };
    let mut differences = Vec::new();
    for view in views {
        let [left, right] = &view.sightings;
        for corner in left.corners() {
            let Some(other) = right.at(corner.column, corner.row) else { continue };
            let of_left = row(rig.left(), &left_turn, rectified.rig.left(), &corner.pixel);
            let of_right = row(rig.right(), &right_turn, rectified.rig.right(), &other.pixel);
            let Some((left, right)) = of_left.zip(of_right) else { continue };
            differences.push(RowDifference { left_px: corner.pixel, difference_px: right - left });
        }
    }
    Ok(differences)
}

/// Statistics of the vertical misalignment over all corners.
///
/// # Errors
/// The stereo pair cannot be rectified.
pub fn row_error(rig: &StereoRig, views: &[View<2>]) -> Result<RowError, RectificationError> {
    let mut differences: Vec<f64> = row_differences(rig, views)?.iter().map(|row| row.difference_px).collect();
    let count = differences.len().max(1) as f64;
    let mean_px = differences.iter().sum::<f64>() / count;
    let rms_px = (differences.iter().map(|d| d * d).sum::<f64>() / count).sqrt();
    differences.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let p95 = differences.get((differences.len() * 95 / 100).min(differences.len().saturating_sub(1)));
    Ok(RowError { rms_px, mean_px, p95_px: p95.map_or(0.0, |d| d.abs()) })
}
