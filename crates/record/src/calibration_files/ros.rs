//! ROS `camera_info` pairs as `camera_calibration_parsers` writes them.
//!
//! The files do not contain the pose directly. With the rectifying rotations `R1`, `R2` and the right projection matrix `P2`,
//! whose element `[0][3]` is `-fx * B`, a point maps from left to right as `R2^T (R1 x + t)`, `t = (P2[0][3] / fx, 0, 0)`.

use nalgebra::{Matrix3, Matrix3x4, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, StereoRig};

use super::document::Node;
use super::error::{CalibrationFileError, one_line};
use super::sensor_window::{ImageCameras, SensorWindow, StatedCamera, camera_matrices};
use super::{CalibrationFormat, Remarks, checks, write};

/// Maximum ratio of the focal lengths of the raw and the rectified image.
const ZOOM_MAX: f64 = 5.0;

pub(super) fn recognises(root: &Node<'_>) -> bool {
    root.find("camera_matrix").is_some()
}

/// The rig for images of a known size, if it is known, with what the user should know. For rectified images it has the projection matrices.
pub(super) fn read(
    left: &Node<'_>,
    right: &Node<'_>,
    (images, rectified): (Option<ImageSize>, bool),
) -> Result<(StereoRig, Remarks), CalibrationFileError> {
    let stated = [stated_camera(left, rectified)?, stated_camera(right, rectified)?];
    let ImageCameras { sizes, pinholes, note, warning } = camera_matrices([&stated[0], &stated[1]], images)?;
    let of_images = |side: usize| {
        let StatedCamera { root, size, window, .. } = &stated[side];
        let distortion = if rectified { Distortion::None } else { distortion(root)? };
        // A small part of the sensor may be far from the principal point.
        let camera = if window.is_whole(*size) { checks::camera } else { checks::off_centre_camera };
        camera(&root.get("camera_matrix")?, sizes[side], pinholes[side], distortion)
    };
    let cameras = [of_images(0)?, of_images(1)?];
    let (left_rotation, right_rotation) = match rectified {
        true => (Matrix3::identity(), Matrix3::identity()),
        false => (rectification(left)?, rectification(right)?),
    };
    let (left_projection, _) = projection(left, &stated[0].pinhole)?;
    let (right_projection, node) = projection(right, &stated[1].pinhole)?;
    if left_projection[(0, 3)] != 0.0 {
        let reason = format!(
            "element [0][3] of the left camera is {}, it must be 0; the files are exchanged, or the left camera is not the first of its pair",
            left_projection[(0, 3)]
        );
        return Err(left.error("projection_matrix", reason));
    }
    if right_projection[(0, 3)] == 0.0 {
        let reason = "element [0][3] of the right camera is 0, it must be -fx times the baseline in metres; the cameras were calibrated one by one, not as a pair";
        return Err(node.refuse(reason));
    }
    for (row, column) in [(0, 0), (1, 1), (1, 2)] {
        let (l, r) = (left_projection[(row, column)], right_projection[(row, column)]);
        if (l - r).abs() > 1e-6 * l.abs().max(1.0) {
            let reason = format!(
                "element [{row}][{column}] is {r}, in the left file it is {l}; in a rectified pair both must be equal"
            );
            return Err(node.refuse(reason));
        }
    }
    let fx = right_projection[(0, 0)];
    let translation_rect_m = Vector3::new(right_projection[(0, 3)] / fx, 0.0, 0.0);
    let right_back = right_rotation.transpose();
    let rig = checks::rig(&node, cameras, &(right_back * left_rotation), right_back * translation_rect_m)?;
    Ok((rig, Remarks { notes: Vec::from_iter(note), warnings: Vec::from_iter(warning) }))
}

fn stated_camera<'a>(root: &Node<'a>, rectified: bool) -> Result<StatedCamera<'a>, CalibrationFileError> {
    let size = Node::size(&root.get("image_width")?, &root.get("image_height")?)?;
    let pinhole = if rectified {
        let p: Matrix3x4<f64> = root.get("projection_matrix")?.matrix()?;
        Pinhole { fx: p[(0, 0)], fy: p[(1, 1)], cx: p[(0, 2)], cy: p[(1, 2)] }
    } else {
        checks::pinhole(&root.get("camera_matrix")?)?
    };
    Ok(StatedCamera { root: root.clone(), size, pinhole, window: SensorWindow::read(root)? })
}

fn distortion(root: &Node<'_>) -> Result<Distortion, CalibrationFileError> {
    let model = root.get("distortion_model")?;
    checks::distortion(&model, model.text()?, &root.get("distortion_coefficients")?)
}

fn rectification(root: &Node<'_>) -> Result<Matrix3<f64>, CalibrationFileError> {
    let node = root.get("rectification_matrix")?;
    checks::rotation(&node, &node.matrix()?)
}

/// The projection matrix as stated, checked for its shape and against the stated camera matrix. Only ratios of it are used, so that it
/// needs no binning.
fn projection<'a>(root: &Node<'a>, stated: &Pinhole) -> Result<(Matrix3x4<f64>, Node<'a>), CalibrationFileError> {
    let node = root.get("projection_matrix")?;
    let p: Matrix3x4<f64> = node.matrix()?;
    let zeros = [(0, 1), (1, 0), (1, 3), (2, 0), (2, 1), (2, 3)];
    if let Some((row, column)) = zeros.into_iter().find(|at| p[*at].abs() > 1e-9) {
        let reason = format!(
            "element [{row}][{column}] is {}, it must be 0; the matrix must be [fx, 0, cx, -fx B, 0, fy, cy, 0, 0, 0, 1, 0] for a horizontal stereo pair",
            p[(row, column)]
        );
        return Err(node.refuse(reason));
    }
    if (p[(2, 2)] - 1.0).abs() > 1e-9 {
        return Err(node.refuse(format!("element [2][2] is {}, it must be 1", p[(2, 2)])));
    }
    for (row, raw, name) in [(0, stated.fx, "fx"), (1, stated.fy, "fy")] {
        let rectified = p[(row, row)];
        if !(rectified > raw / ZOOM_MAX && rectified < raw * ZOOM_MAX) {
            let reason = format!(
                "its {name} is {rectified}, in camera_matrix it is {raw}; they differ by more than a factor of {ZOOM_MAX}, so they do not belong together"
            );
            return Err(node.refuse(reason));
        }
    }
    Ok((p, node))
}

/// A `camera_info` of ROS.
#[derive(Clone, Debug, PartialEq)]
pub struct RosCameraInfo {
    /// Size of the images.
    pub size: ImageSize,
    /// Name of the distortion model.
    pub distortion_model: &'static str,
    /// Its coefficients.
    pub distortion: Vec<f64>,
    /// Camera matrix, row by row, pixels.
    pub camera_matrix: [f64; 9],
    /// Rotation from the camera to its rectified frame, row by row.
    pub rectification: [f64; 9],
    /// Projection of the rectified camera, row by row; the fourth element is `-fx B`, in pixels times metres.
    pub projection: [f64; 12],
}

pub(super) fn camera_infos(rig: &StereoRig) -> Result<[RosCameraInfo; 2], CalibrationFileError> {
    let rectified = rig.rectify().map_err(|error| CalibrationFileError::NotRepresentable {
        format: CalibrationFormat::RosPair,
        reason: format!("this format needs a rectifiable pair, but {}", one_line(&error)),
    })?;
    let shift = -rectified.rig.left().pinhole().fx * rectified.rig.baseline_m();
    let left_turn = rectified.cam_left_rect_from_cam_left.rotation_matrix();
    let right_turn = rectified.cam_right_rect_from_cam_right.rotation_matrix();
    Ok([
        camera_info(rig.left(), &left_turn, rectified.rig.left(), 0.0),
        camera_info(rig.right(), &right_turn, rectified.rig.right(), shift),
    ])
}

fn camera_info(camera: &Camera, turn: &Matrix3<f64>, rectified: &Camera, shift: f64) -> RosCameraInfo {
    let (distortion_model, distortion) = write::distortion(camera.distortion());
    let p = rectified.pinhole();
    RosCameraInfo {
        size: camera.size(),
        distortion_model,
        distortion,
        camera_matrix: in_rows(&camera.pinhole().matrix()),
        rectification: in_rows(turn),
        projection: [p.fx, 0.0, p.cx, shift, 0.0, p.fy, p.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

/// The elements row by row.
fn in_rows(matrix: &Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|k| matrix[(k / 3, k % 3)])
}

/// The contents of the left and the right file.
pub(super) fn write(rig: &StereoRig) -> Result<[String; 2], CalibrationFileError> {
    let [left, right] = camera_infos(rig)?;
    Ok([text("left", &left), text("right", &right)])
}

fn text(name: &str, info: &RosCameraInfo) -> String {
    let matrix = |key: &str, rows: usize, columns: usize, data: &[f64]| {
        format!("{key}:\n  rows: {rows}\n  cols: {columns}\n  data: {}\n", write::list(data))
    };
    let mut text = format!("image_width: {}\nimage_height: {}\n", info.size.width, info.size.height);
    text += &format!("camera_name: {name}\n");
    text += &matrix("camera_matrix", 3, 3, &info.camera_matrix);
    text += &format!("distortion_model: {}\n", info.distortion_model);
    text += &matrix("distortion_coefficients", 1, info.distortion.len(), &info.distortion);
    text += &matrix("rectification_matrix", 3, 3, &info.rectification);
    text += &matrix("projection_matrix", 3, 4, &info.projection);
    text
}
