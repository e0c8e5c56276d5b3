//! Stereo rig: two cameras fixed to each other.

use nalgebra::Vector3;

use crate::camera::{Camera, CameraError, Distortion};
use crate::frames::{CamLeft, CamRight};
use crate::pose::Pose;

/// Two calibrated cameras that are fixed to each other; not necessarily rectified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoRig {
    left: Camera,
    right: Camera,
    cam_right_from_cam_left: Pose<CamRight, CamLeft>,
}

/// Why a rig was rejected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StereoRigError {
    /// The baseline is out of range.
    #[error("baseline is {baseline_m} m: it must be longer than 0.1 mm and shorter than 10 m")]
    Baseline {
        /// Distance between the optical centres, metres.
        baseline_m: f64,
    },
    /// The rotation between the cameras is not finite.
    #[error("the rotation from the left to the right camera is not finite: check the calibration")]
    Rotation,
    /// Left and right are swapped, or one camera is in front of the other.
    #[error(
        "the right camera is {:.1} mm to the {} of the left camera, but must be to the right of it, or above or below it, by at least half \
         the baseline: exchange left and right, or check the sign of the translation",
        right_by_m.abs() * 1e3,
        if *right_by_m < 0.0 { "left" } else { "right" }
    )]
    Swapped {
        /// x of the right camera's centre in `cam_left`, metres.
        right_by_m: f64,
    },
    /// A camera was rejected.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

impl StereoRig {
    /// Creates a rig from its cameras and `cam_right_from_cam_left` (maps coordinates in `cam_left` to `cam_right`, metres).
    ///
    /// # Errors
    /// A baseline out of range, a rotation that is not finite, or a right camera at the wrong side: it must be to the right of the left
    /// camera by at least half the baseline. If the baseline is more vertical than horizontal, it must be above or below the left
    /// camera by at least half the baseline instead.
    pub fn new(
        left: Camera,
        right: Camera,
        cam_right_from_cam_left: Pose<CamRight, CamLeft>,
    ) -> Result<Self, StereoRigError> {
        let rig = Self { left, right, cam_right_from_cam_left };
        let baseline_m = rig.baseline_m();
        if !(baseline_m > 1e-4 && baseline_m < 10.0) {
            return Err(StereoRigError::Baseline { baseline_m });
        }
        let centre = rig.right_centre_in_cam_left();
        if !centre.iter().all(|coordinate| coordinate.is_finite()) {
            return Err(StereoRigError::Rotation);
        }
        let is_beside = centre.x >= 0.5 * baseline_m;
        let is_vertical = centre.y.abs() >= 0.5 * baseline_m && centre.y.abs() > centre.x.abs();
        if !is_beside && !is_vertical {
            return Err(StereoRigError::Swapped { right_by_m: centre.x });
        }
        Ok(rig)
    }

    /// The left camera.
    #[inline]
    pub fn left(&self) -> &Camera {
        &self.left
    }

    /// The right camera.
    #[inline]
    pub fn right(&self) -> &Camera {
        &self.right
    }

    /// Maps coordinates in `cam_left` to `cam_right`.
    #[inline]
    pub fn cam_right_from_cam_left(&self) -> &Pose<CamRight, CamLeft> {
        &self.cam_right_from_cam_left
    }

    /// Distance between the optical centres, metres.
    pub fn baseline_m(&self) -> f64 {
        self.cam_right_from_cam_left.translation_m().norm()
    }

    /// Optical centre of the right camera in `cam_left`, metres.
    pub fn right_centre_in_cam_left(&self) -> Vector3<f64> {
        self.cam_right_from_cam_left.inverse().translation_m()
    }

    /// The rig with the same pinholes without distortion, for images remapped by [`crate::maps::RemapTable::undistort`].
    pub fn undistorted(&self) -> Self {
        Self { left: self.left.undistorted(), right: self.right.undistorted(), ..*self }
    }

    /// The rig that would see a target at rest as this one sees a target that moves between the two exposures of a pair: `later_from_now`
    /// maps points of the target in `cam_left` from the left exposure to the right one.
    pub fn with_motion_between_exposures(&self, later_from_now: &Pose<CamLeft, CamLeft>) -> Self {
        Self { cam_right_from_cam_left: self.cam_right_from_cam_left * *later_from_now, ..*self }
    }

    /// Whether rows are epipolar lines and columns differ by disparity only: no distortion, no rotation, a baseline along x,
    /// equal fx, fy and cy (cx may differ).
    pub fn is_rectified(&self) -> bool {
        self.obstacles().next().is_none()
    }

    /// What keeps the rig from being rectified.
    pub fn obstacles(&self) -> impl Iterator<Item = RectificationObstacle> + use<> {
        use RectificationObstacle::{Baseline, Cy, Fx, Fy, LeftDistortion, RightDistortion, Rotation};
        let (l, r) = (self.left.pinhole(), self.right.pinhole());
        let t = self.cam_right_from_cam_left.translation_m();
        let differ = |a: f64, b: f64| (a - b).abs() > 1e-6 * a.abs().max(1.0);
        let is_distorted = |camera: &Camera| !matches!(camera.distortion(), Distortion::None);
        [
            (LeftDistortion, is_distorted(&self.left)),
            (RightDistortion, is_distorted(&self.right)),
            (Rotation, self.cam_right_from_cam_left.rotation_angle_rad() >= 1e-9),
            (Baseline, t.y.abs() > 1e-9 || t.z.abs() > 1e-9),
            (Fx, differ(l.fx, r.fx)),
            (Fy, differ(l.fy, r.fy)),
            (Cy, differ(l.cy, r.cy)),
        ]
        .into_iter()
        .filter_map(|(obstacle, is_there)| is_there.then_some(obstacle))
    }
}

/// What rectified cameras do not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RectificationObstacle {
    /// Distortion of the left camera.
    LeftDistortion,
    /// Distortion of the right camera.
    RightDistortion,
    /// A rotation between the cameras.
    Rotation,
    /// A baseline that is not along x.
    Baseline,
    /// Different focal lengths along the rows.
    Fx,
    /// Different focal lengths along the columns.
    Fy,
    /// Different principal rows.
    Cy,
}
