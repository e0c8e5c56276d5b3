//! Rectification of a stereo rig: both cameras turned so that image rows are epipolar lines.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::{Camera, CameraError, Distortion, ImageSize, Pinhole};
use crate::frames::{CamLeft, CamLeftRect, CamRight, CamRightRect};
use crate::maps::RemapTable;
use crate::pose::Pose;
use crate::stereo_rig::{StereoRig, StereoRigError};

/// The smallest sine of the angle between the baseline and the mean viewing direction: below it the cameras look along
/// the line that joins them and no common image plane is left.
const BASELINE_SINE_MIN: f64 = 0.2;
/// The smallest cosine between an original optical axis and the rectified one (60 degrees): beyond it the rectified image
/// would be mostly empty.
const TURN_COSINE_MIN: f64 = 0.5;

/// A rectified rig and the way to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Rectification {
    /// The rectified rig: no distortion, no rotation, equal fx, fy and cy, the right camera at `(B, 0, 0)`. What the type
    /// calls `cam_left` and `cam_right` are here the rectified frames.
    pub rig: StereoRig,
    /// Makes the rectified left image from the original one.
    pub left: RemapTable,
    /// Makes the rectified right image from the original one.
    pub right: RemapTable,
    /// The turn of the left camera about its optical centre.
    pub cam_left_rect_from_cam_left: Pose<CamLeftRect, CamLeft>,
    /// The turn of the right camera about its optical centre.
    pub cam_right_rect_from_cam_right: Pose<CamRightRect, CamRight>,
}

/// Why a rig cannot be rectified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RectificationError {
    /// The baseline runs along the viewing direction.
    #[error(
        "the baseline is only {angle_deg:.1} degrees off the mean viewing direction: such a pair has no common image plane; check the translation of the calibration"
    )]
    BaselineAlongView {
        /// Angle between baseline and mean optical axis, degrees.
        angle_deg: f64,
    },
    /// A camera would have to be turned too far.
    #[error(
        "the {camera} camera would have to be turned by {angle_deg:.1} degrees, 60 are allowed; check the rotation of the calibration"
    )]
    Turn {
        /// `left` or `right`.
        camera: &'static str,
        /// Angle between the optical axis and the rectified one, degrees.
        angle_deg: f64,
    },
    /// The rectified camera was refused, or a source image's centre has no ray.
    #[error("no rectified camera")]
    Camera(#[from] CameraError),
    /// The rectified rig was refused.
    #[error("no rectified rig")]
    Rig(#[from] StereoRigError),
}

impl StereoRig {
    /// The rectified rig, the turns that lead to it and the tables that rectify images.
    ///
    /// The common x axis is the baseline, the common z axis is the mean viewing direction made perpendicular to it, so the
    /// turn is shared by the two cameras. Focal lengths are the means of both cameras, each image keeps its centre (hence
    /// cx may differ and disparities have an offset), cy is common, and both images take the larger size. A rig that is
    /// rectified already comes out unchanged. Costs about as much as projecting every pixel twice.
    ///
    /// # Errors
    /// A baseline along the viewing direction, a camera that would have to be turned by more than 60 degrees, or a lens
    /// without a ray at its image's centre.
    pub fn rectify(&self) -> Result<Rectification, RectificationError> {
        let left_turn = rectified_axes(self)?;
        // Directions: right rectified = left rectified = turn * left = turn * left_from_right * right.
        let right_turn = left_turn * self.cam_right_from_cam_left().rotation_matrix().transpose();
        check_turn("left", &left_turn)?;
        check_turn("right", &right_turn)?;
        let cam_left_rect_from_cam_left = Pose::from_rotation_matrix(&left_turn, Vector3::zeros());
        let cam_right_rect_from_cam_right = Pose::from_rotation_matrix(&right_turn, Vector3::zeros());
        let (left, right) = rectified_cameras(self, &left_turn, &right_turn)?;
        let cam_right_from_cam_left = Pose::from_translation(Vector3::new(-self.baseline_m(), 0.0, 0.0));
        Ok(Rectification {
            rig: StereoRig::new(left, right, cam_right_from_cam_left)?,
            left: RemapTable::rotate(self.left(), &left, &cam_left_rect_from_cam_left),
            right: RemapTable::rotate(self.right(), &right, &cam_right_rect_from_cam_right),
            cam_left_rect_from_cam_left,
            cam_right_rect_from_cam_right,
        })
    }
}

/// Rows: the rectified axes in `cam_left`.
fn rectified_axes(rig: &StereoRig) -> Result<Matrix3<f64>, RectificationError> {
    if rig.is_rectified() {
        return Ok(Matrix3::identity());
    }
    let x = rig.right_centre_in_cam_left() / rig.baseline_m();
    let right_view_in_cam_left = rig.cam_right_from_cam_left().inverse().transform_vector(&Vector3::z());
    let view = Vector3::z() + right_view_in_cam_left;
    let y = view.cross(&x);
    // Opposite views, whose sum is zero, are refused here too.
    if y.norm() <= BASELINE_SINE_MIN * view.norm() {
        return Err(RectificationError::BaselineAlongView { angle_deg: view.angle(&x).to_degrees() });
    }
    let y = y.normalize();
    Ok(Matrix3::from_rows(&[x.transpose(), y.transpose(), x.cross(&y).transpose()]))
}

fn check_turn(camera: &'static str, turn: &Matrix3<f64>) -> Result<(), RectificationError> {
    let cosine = turn[(2, 2)];
    if cosine < TURN_COSINE_MIN {
        let angle_deg = cosine.clamp(-1.0, 1.0).acos().to_degrees();
        return Err(RectificationError::Turn { camera, angle_deg });
    }
    Ok(())
}

/// Cameras with common focal lengths and row, in which each source image's centre stays at the centre.
fn rectified_cameras(
    rig: &StereoRig,
    left_turn: &Matrix3<f64>,
    right_turn: &Matrix3<f64>,
) -> Result<(Camera, Camera), RectificationError> {
    let (l, r) = (rig.left(), rig.right());
    let size = ImageSize { width: l.size().width.max(r.size().width), height: l.size().height.max(r.size().height) };
    let fx = 0.5 * (l.pinhole().fx + r.pinhole().fx);
    let fy = 0.5 * (l.pinhole().fy + r.pinhole().fy);
    let principal = |camera: &Camera, turn: &Matrix3<f64>| -> Result<Vector2<f64>, CameraError> {
        let ray = turn * camera.unproject(&centre(camera.size()))?;
        Ok(centre(size) - Vector2::new(fx * ray.x, fy * ray.y) / ray.z)
    };
    let (left, right) = (principal(l, left_turn)?, principal(r, right_turn)?);
    let cy = 0.5 * (left.y + right.y);
    let camera = |cx: f64| Camera::new(size, Pinhole { fx, fy, cx, cy }, Distortion::None);
    Ok((camera(left.x)?, camera(right.x)?))
}

/// The centre of an image whose pixel centres have integer coordinates.
fn centre(size: ImageSize) -> Vector2<f64> {
    Vector2::new(f64::from(size.width) - 1.0, f64::from(size.height) - 1.0) * 0.5
}
