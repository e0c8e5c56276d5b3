//! Stereo rigs and target poses for the examples.
#![allow(dead_code)]

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, CameraError, Distortion, ImageSize, Pinhole, Pose, StereoRig, StereoRigError};
use pb3dp_sim::scene::ScenePoses;

/// Lens model of the example rig.
#[derive(Clone, Copy, PartialEq)]
pub enum Lens {
    /// No distortion.
    Ideal,
    /// Distortion of a typical 6 mm lens.
    Distorted,
}

impl Lens {
    /// Both lens models.
    pub const ALL: [Self; 2] = [Self::Ideal, Self::Distorted];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        if self == Self::Ideal { "ideal" } else { "distorted" }
    }
}

/// 640x480, fx 740 px, baseline 100 mm.
pub fn rig(lens: Lens) -> Result<StereoRig, StereoRigError> {
    let camera = |shift: f64| -> Result<Camera, CameraError> {
        let distortion = match lens {
            Lens::Ideal => Distortion::None,
            Lens::Distorted => {
                Distortion::BrownConrady5 { coefficients: [-0.12 - 0.01 * shift, 0.09, 0.0006, -0.0004, 0.0] }
            }
        };
        let pinhole = Pinhole { fx: 740.0, fy: 740.0, cx: 319.5, cy: 239.5 };
        Camera::new(ImageSize { width: 640, height: 480 }, pinhole, distortion)
    };
    StereoRig::new(camera(0.0)?, camera(1.0)?, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0)))
}

/// The camera axis is +x of the world, one metre up; the target is in front of it, rotated about its axes (radians).
pub fn frontal(distance_m: f64, turn_x_rad: f64, turn_y_rad: f64) -> ScenePoses {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let world_from_cam_left = Pose::from_rotation_matrix(&axes, Vector3::new(0.3, 0.1, 0.5));
    let turn = UnitQuaternion::from_euler_angles(turn_x_rad, turn_y_rad, 0.0);
    let cam_left_from_target: Pose<CamLeft, Target> = Pose::from_parts(Vector3::new(0.05, 0.0, distance_m), turn);
    ScenePoses { world_from_cam_left, world_from_target: world_from_cam_left * cam_left_from_target }
}
