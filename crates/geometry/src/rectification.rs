//! Rectification of a stereo rig: rotates both cameras so that image rows are epipolar lines.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::{Camera, CameraError, Distortion, ImageSize, Pinhole};
use crate::frames::{CamLeft, CamLeftRect, CamRight, CamRightRect};
use crate::maps::RemapTable;
use crate::pose::Pose;
use crate::stereo_rig::{StereoRig, StereoRigError};

/// Smallest sine of the angle between the baseline and the mean viewing direction. Below it the cameras look along the
/// baseline, and there is no common image plane.
const BASELINE_SINE_MIN: f64 = 0.2;
/// Smallest cosine between an original optical axis and the rectified one (60 degrees); at larger angles the rectified image
/// would be mostly empty.
const TURN_COSINE_MIN: f64 = 0.5;

/// A rectified rig, and the rotations and remap tables that lead to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Rectification {
    /// The rectified rig: no distortion, no rotation, equal fx, fy and cy, the right camera at `(B, 0, 0)`. The type's
    /// `cam_left` and `cam_right` are the rectified frames here.
    pub rig: StereoRig,
    /// Converts the original left image into the rectified one.
    pub left: RemapTable,
    /// Converts the original right image into the rectified one.
    pub right: RemapTable,
    /// The rotation of the left camera about its optical centre.
    pub cam_left_rect_from_cam_left: Pose<CamLeftRect, CamLeft>,
    /// The rotation of the right camera about its optical centre.
    pub cam_right_rect_from_cam_right: Pose<CamRightRect, CamRight>,
}

/// Why a rig cannot be rectified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RectificationError {
    /// The baseline is almost parallel to the viewing direction.
    #[error(
        "the baseline is only {angle_deg:.1} degrees from the mean viewing direction, so the pair has no common image plane: check the translation of the calibration"
    )]
    BaselineAlongView {
        /// Angle between baseline and mean optical axis, degrees.
        angle_deg: f64,
    },
    /// Rectification would have to rotate a camera too far.
    #[error(
        "rectification would rotate the {camera} camera by {angle_deg:.1} degrees (limit 60): check the rotation of the calibration"
    )]
    Turn {
        /// `left` or `right`.
        camera: &'static str,
        /// Angle between the optical axis and the rectified one, degrees.
        angle_deg: f64,
    },
    /// The rectified camera is invalid, or the centre of a source image has no ray.
    #[error("no rectified camera")]
    Camera(#[from] CameraError),
    /// The rectified rig is invalid.
    #[error("no rectified rig")]
    Rig(#[from] StereoRigError),
}

impl StereoRig {
    /// Computes the rectified rig, the rotations to it, and the remap tables for the images.
    ///
    /// The common x axis is the baseline. The common z axis is the mean viewing direction made perpendicular to it, so both
    /// cameras share the rotation. Focal lengths are the means of both cameras, each image keeps its centre (hence cx may
    /// differ and disparities have an offset), cy is common, and both images take the larger size. A rig that is already
    /// rectified remains unchanged. The cost is about that of projecting every pixel twice.
    ///
    /// # Errors
    /// A baseline along the viewing direction, a camera that would have to be rotated by more than 60 degrees, or a lens
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
    // This also rejects opposite views, whose sum is zero.
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

/// Cameras with common focal lengths and common cy, in which each source image's centre stays at the centre.
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
