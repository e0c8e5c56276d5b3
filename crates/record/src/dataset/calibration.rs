//! The calibration file of a case or sequence: `calib.json`.

use std::path::Path;

use pb3dp_geometry::{Camera, Distortion, StereoRig};
use serde_json::{Value, json};

use super::DatasetError;
use super::writer::write_object;

/// Writes `calib.json` of a rig; `calibration_files::load_stereo` reads it.
///
/// # Errors
/// If the file can not be written.
pub fn write_calibration(file: &Path, rig: &StereoRig) -> Result<(), DatasetError> {
    let (left, right) = (rig.left(), rig.right());
    let pose = rig.cam_right_from_cam_left();
    let t_mm: [f64; 3] = (pose.translation_m() * 1e3).into();
    let size = left.size();
    let mut keys = vec![
        ("image_size", json!([size.width, size.height])),
        ("rectified", json!(rig.is_rectified())),
        ("K_left", rows(&left.pinhole().matrix())),
        ("K_right", rows(&right.pinhole().matrix())),
        ("R", rows(&pose.rotation_matrix())),
        ("t_mm", json!(t_mm)),
        ("baseline_mm", json!(rig.baseline_m() * 1e3)),
        ("convention", json!("X_right = R X_left + t; x right, y down, z forward; pixel centres at integers")),
    ];
    if [left, right].iter().all(|camera| *camera.distortion() == Distortion::None) {
        keys.push(("distortion", json!("none")));
    } else {
        keys.push(("distortion_left", distortion_value(left)));
        keys.push(("distortion_right", distortion_value(right)));
    }
    write_object(file, &keys)
}

fn rows(m: &nalgebra::Matrix3<f64>) -> Value {
    json!([0, 1, 2].map(|row| [m[(row, 0)], m[(row, 1)], m[(row, 2)]]))
}

fn distortion_value(camera: &Camera) -> Value {
    match camera.distortion() {
        Distortion::None => json!({"model": "none", "coefficients": []}),
        Distortion::BrownConrady5 { coefficients } => json!({"model": "plumb_bob", "coefficients": coefficients}),
        Distortion::BrownConrady8 { coefficients } => {
            json!({"model": "rational_polynomial", "coefficients": coefficients})
        }
        Distortion::Equidistant { coefficients } => json!({"model": "equidistant", "coefficients": coefficients}),
    }
}
