//! OpenCV `FileStorage` YAML of a stereo calibration, in one file or split into intrinsics and extrinsics.
//!
//! OpenCV fixes no key names, so several spellings are accepted: `M1` `K1` `cameraMatrix1` ... for the camera matrices, `D1`
//! `distCoeffs1` ... for the distortion, `R`, `T`, and `image_width` with `image_height` or `image_size` for the size. `R` and
//! `T` map points of the first (left) camera to the second, `X2 = R X1 + T`. A file without size (OpenCV's own stereo sample
//! writes none) can be read if the image size is known otherwise.
//!
//! **Unit of `T`.** OpenCV's unit is the unit in which the board was measured. The key `units` (`mm`, `cm` or `m`) decides if
//! present. Otherwise a `T` shorter than 1 is interpreted as metres and one longer than 10 as millimetres, with a note. Between 1
//! and 10 the file is refused, because centimetres, metres and board squares are all plausible.
//!
//! **Distortion.** 4, 5 or 8 coefficients; longer lists if the rest is zero (thin prism and tilt are not supported). A fisheye
//! calibration cannot be recognised by its 4 coefficients. Such a file must contain `distortion_model: fisheye`, or
//! `distortion_model1` and `distortion_model2` for cameras that differ. Files written here contain `units` and both models.

use nalgebra::{Matrix3, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, StereoRig};

use super::document::Node;
use super::error::CalibrationFileError;
use super::{checks, write};

/// Spellings of each camera's matrix and distortion, left then right.
const MATRIX: [[&str; 9]; 2] = [
    [
        "M1",
        "K1",
        "cameraMatrix1",
        "camera_matrix_1",
        "cameraMatrixL",
        "camera_matrix_left",
        "left_camera_matrix",
        "KL",
        "K_left",
    ],
    [
        "M2",
        "K2",
        "cameraMatrix2",
        "camera_matrix_2",
        "cameraMatrixR",
        "camera_matrix_right",
        "right_camera_matrix",
        "KR",
        "K_right",
    ],
];
const COEFFICIENTS: [[&str; 9]; 2] = [
    [
        "D1",
        "distCoeffs1",
        "dist_coeffs_1",
        "distCoeffsL",
        "dist_coeffs_left",
        "left_distortion_coefficients",
        "DL",
        "D_left",
        "distortion1",
    ],
    [
        "D2",
        "distCoeffs2",
        "dist_coeffs_2",
        "distCoeffsR",
        "dist_coeffs_right",
        "right_distortion_coefficients",
        "DR",
        "D_right",
        "distortion2",
    ],
];
const ROTATION: [&str; 3] = ["R", "rotation_matrix", "rotation"];
const TRANSLATION: [&str; 4] = ["T", "translation_vector", "translation", "t"];
const WIDTH: [&str; 3] = ["image_width", "imageWidth", "width"];
const HEIGHT: [&str; 3] = ["image_height", "imageHeight", "height"];
const SIZE: [&str; 4] = ["image_size", "imageSize", "img_size", "size"];
const UNITS: [&str; 2] = ["units", "unit"];

pub(super) fn recognises(root: &Node<'_>) -> bool {
    let keys = MATRIX.iter().chain(&COEFFICIENTS).flatten();
    keys.into_iter().any(|key| root.find(key).is_some())
}

pub(super) fn has_coefficients(root: &Node<'_>) -> bool {
    COEFFICIENTS.iter().flatten().any(|key| root.find(key).is_some())
}

/// Reads one file or the two files of a split calibration.
pub(super) fn read(
    roots: &[Node<'_>],
    images: Option<ImageSize>,
) -> Result<(StereoRig, Vec<String>), CalibrationFileError> {
    if let ([root], None, None) = (roots, find(roots, &ROTATION), find(roots, &TRANSLATION)) {
        let reason = "are missing, the pose between the cameras; if a second file has them, give both, as intrinsics.yml,extrinsics.yml";
        return Err(root.error("R and T", reason));
    }
    let (size, size_note) = image_size(roots, images)?;
    let cameras = [camera(roots, 0, size)?, camera(roots, 1, size)?];
    let rotation_node = get(roots, &ROTATION)?;
    let rotation: Matrix3<f64> = checks::rotation(&rotation_node, &rotation_node.matrix()?)?;
    let translation = get(roots, &TRANSLATION)?;
    let in_file_units: Vector3<f64> = translation.matrix()?;
    let (metres, note) = metres_per_unit(roots, &translation, in_file_units.norm())?;
    let rig = checks::rig(&translation, cameras, &rotation, in_file_units * metres)?;
    Ok((rig, size_note.into_iter().chain(note).collect()))
}

fn find<'a>(roots: &[Node<'a>], keys: &[&str]) -> Option<Node<'a>> {
    keys.iter().find_map(|key| roots.iter().find_map(|root| root.find(key)))
}

fn get<'a>(roots: &[Node<'a>], keys: &[&str]) -> Result<Node<'a>, CalibrationFileError> {
    // Of two files, the one with the cameras has all but the pose.
    let is_pose = keys == ROTATION || keys == TRANSLATION;
    let root = roots.iter().find(|root| recognises(root) != is_pose).or(roots.last());
    find(roots, keys).ok_or_else(|| match (root, keys) {
        (Some(root), [first, others @ ..]) => {
            root.error(first, format!("is missing (other accepted names: {})", others.join(", ")))
        }
        _ => CalibrationFileError::Paths { count: roots.len() },
    })
}

/// The size stated in the file, or the size of the images if the file states none, with a note.
fn image_size(
    roots: &[Node<'_>],
    images: Option<ImageSize>,
) -> Result<(ImageSize, Option<String>), CalibrationFileError> {
    match (find(roots, &SIZE), find(roots, &WIDTH), images) {
        (Some(node), ..) => Ok((node.size_pair()?, None)),
        (None, None, Some(size)) => {
            let note = "the calibration states no image size; the size of the images is used";
            Ok((size, Some(note.to_owned())))
        }
        _ => Ok((Node::size(&get(roots, &WIDTH)?, &get(roots, &HEIGHT)?)?, None)),
    }
}

fn camera(roots: &[Node<'_>], side: usize, size: ImageSize) -> Result<Camera, CalibrationFileError> {
    let intrinsics = get(roots, &MATRIX[side])?;
    let coefficients = get(roots, &COEFFICIENTS[side])?;
    let model_keys = [["distortion_model1", "distortion_model"], ["distortion_model2", "distortion_model"]][side];
    let distortion = match find(roots, &model_keys) {
        Some(model) => checks::distortion(&model, model.text()?, &coefficients)?,
        None => distortion(&coefficients)?,
    };
    checks::camera(&intrinsics, size, checks::pinhole(&intrinsics)?, distortion)
}

/// The Brown-Conrady model with this number of coefficients.
fn distortion(node: &Node<'_>) -> Result<Distortion, CalibrationFileError> {
    let numbers = node.numbers()?;
    let wrong = format!("has {} coefficients, OpenCV uses 4, 5, 8, 12 or 14", numbers.len());
    if ![4, 5, 8, 12, 14].contains(&numbers.len()) {
        return Err(node.refuse(wrong));
    }
    if numbers.iter().skip(8).any(|number| *number != 0.0) {
        return Err(
            node.refuse("has a thin prism or tilt term, which is not supported; calibrate with 5 or 8 coefficients")
        );
    }
    let mut eight = [0.0; 8];
    for (to, from) in eight.iter_mut().zip(&numbers) {
        *to = *from;
    }
    let [k1, k2, p1, p2, k3, rational @ ..] = eight;
    Ok(match (eight == [0.0; 8], rational == [0.0; 3]) {
        (true, _) => Distortion::None,
        (_, true) => Distortion::BrownConrady5 { coefficients: [k1, k2, p1, p2, k3] },
        _ => Distortion::BrownConrady8 { coefficients: eight },
    })
}

/// Metres per unit of length of the file, with a note if the unit was guessed.
fn metres_per_unit(
    roots: &[Node<'_>],
    translation: &Node<'_>,
    length: f64,
) -> Result<(f64, Option<String>), CalibrationFileError> {
    if let Some(node) = find(roots, &UNITS) {
        return match node.text()? {
            "m" | "metre" | "metres" | "meter" | "meters" => Ok((1.0, None)),
            "cm" => Ok((1e-2, None)),
            "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => Ok((1e-3, None)),
            other => Err(node.refuse(format!("unknown unit {other:?}; use mm, cm or m"))),
        };
    }
    if length < 1.0 {
        Ok((1.0, Some(format!("the file states no units and the length of T is {length}; metres are assumed"))))
    } else if length > 10.0 {
        Ok((1e-3, Some(format!("the file states no units and the length of T is {length}; millimetres are assumed"))))
    } else {
        let reason = format!(
            "has length {length}, which may be metres, centimetres or squares; add the key units with mm, cm or m"
        );
        Err(translation.refuse(reason))
    }
}

/// The text of the file; the keys are those of OpenCV's stereo sample.
pub(super) fn write(rig: &StereoRig) -> String {
    let size = rig.left().size();
    let mut text = format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", size.width, size.height);
    for (side, camera) in [(1, rig.left()), (2, rig.right())] {
        let (model, coefficients) = write::distortion(camera.distortion());
        text += &matrix(&format!("M{side}"), 3, &write::row_major(&camera.pinhole().matrix()));
        text += &format!("distortion_model{side}: {model}\n");
        text += &matrix(&format!("D{side}"), 1, &coefficients);
    }
    let pose = rig.cam_right_from_cam_left();
    text += &matrix("R", 3, &write::row_major(&pose.rotation_matrix()));
    text += &matrix("T", 3, pose.translation_m().as_slice());
    text + "units: m\n"
}

fn matrix(key: &str, rows: usize, data: &[f64]) -> String {
    let columns = data.len() / rows;
    format!("{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: {}\n", write::list(data))
}
