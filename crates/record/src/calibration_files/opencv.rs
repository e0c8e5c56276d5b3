//! OpenCV `FileStorage` YAML of a stereo calibration, in one file or split into intrinsics and extrinsics.
//!
//! OpenCV fixes no key names, so several spellings are accepted: `M1` `K1` `cameraMatrix1` ... for the camera matrices, `D1`
//! `distCoeffs1` ... for the distortion, `R`, `T`, and `image_width` with `image_height` or `image_size` for the size. `R` and
//! `T` map points of the first (left) camera to the second, `X2 = R X1 + T`. A file without size (OpenCV's own stereo sample
//! writes none) can be read if the image size is known otherwise.
//!
//! **Unit of `T`.** OpenCV's unit is the unit in which the board was measured. The key `units` (`mm`, `cm` or `m`) decides, or the
//! caller. Otherwise metres, centimetres and millimetres are tried: if one of them alone gives a baseline between 10 mm and 2 m (with
//! centimetres 0.4 m), it is used, with a warning. Otherwise the file is refused.
//!
//! **Image size.** A file without size is read for the size of the images, with a warning, if the principal points are then near the
//! middle. Otherwise it is refused, with the sizes that it may have been made for.
//!
//! **Distortion.** 4, 5 or 8 coefficients; longer lists if the rest is zero (thin prism and tilt are not supported). Four coefficients
//! can be those of Brown-Conrady or of a fisheye lens: `distortion_model: fisheye` (or `plumb_bob`) decides, or `distortion_model1` and
//! `distortion_model2` for cameras that differ, or the caller. Otherwise both readings are returned
//! ([`other_lens`](super::StereoCalibration::other_lens)). Files written here contain `units` and both models.
//!
//! **Rectified images.** `P1` and `P2` are the cameras of rectified images.

use nalgebra::{Matrix3, Matrix3x4, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, StereoRig};

use super::document::Node;
use super::error::CalibrationFileError;
use super::sensor_window::is_centred;
use super::stated::{LengthUnit, LensModel, StatedCalibration};
use super::{Remarks, checks, write};

/// Baselines of a plausible reading of an unstated unit, metres. Boards are measured in centimetres for small rigs only; with one range, every file
/// in millimetres with a baseline of 40 to 200 mm, the most usual ones, would be refused.
fn plausible_m(unit: LengthUnit) -> std::ops::RangeInclusive<f64> {
    match unit {
        LengthUnit::Centimetres => 0.01..=0.4,
        LengthUnit::Millimetres | LengthUnit::Metres => 0.01..=2.0,
    }
}
/// Scales at which images are usually reduced or enlarged, tried for an unstated image size.
const USUAL_SCALES: [f64; 6] = [0.5, 2.0, 0.25, 4.0, 2.0 / 3.0, 1.5];

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
const PROJECTION: [[&str; 1]; 2] = [["P1"], ["P2"]];
/// Keys of the lens model, of one camera and of both.
const MODEL: [[&str; 2]; 2] = [["distortion_model1", "distortion_model"], ["distortion_model2", "distortion_model"]];

/// What the files state.
pub(super) struct OpenCvRig {
    pub(super) rig: StereoRig,
    /// The equidistant reading, if `rig` is the Brown-Conrady reading of an unstated lens model and both are possible.
    pub(super) other_lens: Option<StereoRig>,
    pub(super) remarks: Remarks,
}

pub(super) fn recognises(root: &Node<'_>) -> bool {
    let keys = MATRIX.iter().chain(&COEFFICIENTS).flatten();
    keys.into_iter().any(|key| root.find(key).is_some())
}

pub(super) fn has_coefficients(root: &Node<'_>) -> bool {
    COEFFICIENTS.iter().flatten().any(|key| root.find(key).is_some())
}

/// Reads one file or the two files of a split calibration, for images of a known size, if it is known.
pub(super) fn read(
    roots: &[Node<'_>],
    images: Option<ImageSize>,
    stated: &StatedCalibration,
) -> Result<OpenCvRig, CalibrationFileError> {
    if let ([root], None, None) = (roots, find(roots, &ROTATION), find(roots, &TRANSLATION)) {
        let reason = "are missing, the pose between the cameras; if a second file has them, give both, as intrinsics.yml,extrinsics.yml";
        return Err(root.error("R and T", reason));
    }
    let mut remarks = Remarks::default();
    let size = image_size(roots, images, stated.size, &mut remarks)?;
    let rotation_node = get(roots, &ROTATION)?;
    let rotation: Matrix3<f64> = checks::rotation(&rotation_node, &rotation_node.matrix()?)?;
    let translation = get(roots, &TRANSLATION)?;
    let in_file_units: Vector3<f64> = translation.matrix()?;
    let unit = unit(roots, (&translation, in_file_units.norm()), stated.unit, &mut remarks)?;
    let translation_m = in_file_units * unit.metres();
    if let (true, Some(left), Some(right)) =
        (stated.rectified, find(roots, &PROJECTION[0]), find(roots, &PROJECTION[1]))
    {
        let rig = of_projections([&left, &right], size, unit)?;
        return Ok(OpenCvRig { rig, other_lens: None, remarks });
    }
    let with_lens = |lens: LensModel| {
        let cameras = [camera(roots, 0, size, lens)?, camera(roots, 1, size, lens)?];
        checks::rig(&translation, cameras, &rotation, translation_m)
    };
    let lens = match (is_lens_unstated(roots)?, stated.lens) {
        (Some(_), None) => {
            let readings = [with_lens(LensModel::BrownConrady), with_lens(LensModel::Equidistant)];
            return of_readings(readings, remarks);
        }
        (Some(_), Some(lens)) => lens,
        (None, Some(lens)) => {
            check_stated_lens(roots, lens)?;
            lens
        }
        (None, None) => LensModel::BrownConrady,
    };
    Ok(OpenCvRig { rig: with_lens(lens)?, other_lens: None, remarks })
}

/// The readings of an unstated lens model that are a rig which can be rectified.
fn of_readings(
    [brown, equidistant]: [Result<StereoRig, CalibrationFileError>; 2],
    mut remarks: Remarks,
) -> Result<OpenCvRig, CalibrationFileError> {
    let is_possible = |reading: &Result<StereoRig, _>| reading.as_ref().is_ok_and(|rig| rig.rectify().is_ok());
    let mut only = |rig, lens: LensModel, other: LensModel| {
        remarks.warnings.push(format!(
            "the file states no lens model, and has four coefficients: {lens} is used, because they are no lens of the model {other}; if this \
             is wrong, state it with --calib-lens {}",
            other.name()
        ));
        Ok(OpenCvRig { rig, other_lens: None, remarks: std::mem::take(&mut remarks) })
    };
    match (is_possible(&brown), is_possible(&equidistant)) {
        (false, true) => only(equidistant?, LensModel::Equidistant, LensModel::BrownConrady),
        (true, false) => only(brown?, LensModel::BrownConrady, LensModel::Equidistant),
        _ => Ok(OpenCvRig { rig: brown?, other_lens: Some(equidistant?), remarks }),
    }
}

/// The rig of rectified images, from P1 and P2.
fn of_projections(
    [left, right]: [&Node<'_>; 2],
    size: ImageSize,
    unit: LengthUnit,
) -> Result<StereoRig, CalibrationFileError> {
    let matrices: [Matrix3x4<f64>; 2] = [left.matrix()?, right.matrix()?];
    let camera = |node: &Node<'_>, p: &Matrix3x4<f64>| {
        let pinhole = Pinhole { fx: p[(0, 0)], fy: p[(1, 1)], cx: p[(0, 2)], cy: p[(1, 2)] };
        checks::camera(node, size, pinhole, Distortion::None)
    };
    let cameras = [camera(left, &matrices[0])?, camera(right, &matrices[1])?];
    let between: Vector3<f64> = matrices[1].column(3) - matrices[0].column(3);
    if between.y != 0.0 {
        return Err(right.refuse(
            "element [1][3] is not 0: the cameras are one above the other; only pairs side by side are read rectified",
        ));
    }
    let translation_m = Vector3::new(between.x / matrices[1][(0, 0)] * unit.metres(), 0.0, 0.0);
    checks::rig(right, cameras, &Matrix3::identity(), translation_m)
}

/// The node of the left coefficients, if both cameras have four and no model is stated. Zeros are no distortion.
fn is_lens_unstated<'a>(roots: &[Node<'a>]) -> Result<Option<Node<'a>>, CalibrationFileError> {
    if MODEL.iter().any(|keys| find(roots, keys).is_some()) {
        return Ok(None);
    }
    let nodes = [get(roots, &COEFFICIENTS[0])?, get(roots, &COEFFICIENTS[1])?];
    let numbers = [nodes[0].numbers()?, nodes[1].numbers()?];
    let is_open =
        numbers.iter().all(|numbers| numbers.len() == 4) && numbers.iter().flatten().any(|number| *number != 0.0);
    let [left, _] = nodes;
    Ok(is_open.then_some(left))
}

/// Refuses a lens model of the caller that differs from that of the file.
fn check_stated_lens(roots: &[Node<'_>], lens: LensModel) -> Result<(), CalibrationFileError> {
    for (side, keys) in MODEL.iter().enumerate() {
        let (node, is_fisheye) = match find(roots, keys) {
            Some(model) => {
                let is_fisheye = matches!(model.text()?, "equidistant" | "fisheye");
                (model, is_fisheye)
            }
            // The number of coefficients decides.
            None => (get(roots, &COEFFICIENTS[side])?, false),
        };
        if is_fisheye != (lens == LensModel::Equidistant) && !is_all_zero(&node) {
            let found = if is_fisheye { LensModel::Equidistant } else { LensModel::BrownConrady };
            return Err(node.refuse(format!(
                "states the lens model {found}, --calib-lens states {}: leave the option out, or correct the file",
                lens.name()
            )));
        }
    }
    Ok(())
}

fn is_all_zero(node: &Node<'_>) -> bool {
    node.numbers().is_ok_and(|numbers| numbers.iter().all(|number| *number == 0.0))
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

/// The size of the images that the calibration was made with: that of the file, of the caller, or of the images.
fn image_size(
    roots: &[Node<'_>],
    images: Option<ImageSize>,
    stated: Option<ImageSize>,
    remarks: &mut Remarks,
) -> Result<ImageSize, CalibrationFileError> {
    let (pair, width) = (find(roots, &SIZE), find(roots, &WIDTH));
    if let Some(node) = &pair {
        return node.size_pair();
    }
    if width.is_some() {
        return Node::size(&get(roots, &WIDTH)?, &get(roots, &HEIGHT)?);
    }
    if let Some(size) = stated {
        return Ok(size);
    }
    let Some(images) = images else {
        let root = roots.iter().find(|root| recognises(root)).or(roots.first());
        return Err(root.map_or(CalibrationFileError::Paths { count: roots.len() }, |root| {
            root.error(
                "image_width",
                "is missing: the file states no image size; add image_width and image_height, or state it with --calib-size WxH",
            )
        }));
    };
    let matrices = [get(roots, &MATRIX[0])?, get(roots, &MATRIX[1])?];
    let pinholes = [checks::pinhole(&matrices[0])?, checks::pinhole(&matrices[1])?];
    if !is_centred(pinholes, images) {
        return Err(matrices[0].refuse(off_centre(pinholes, images)));
    }
    remarks.warnings.push(format!(
        "the calibration states no image size: that of the images, {}x{}, is used; if it was made with other images, state their size with \
         --calib-size",
        images.width, images.height
    ));
    Ok(images)
}

/// Why the size of the images is not that of the calibration, and the sizes that it may have.
fn off_centre(pinholes: [Pinhole; 2], images: ImageSize) -> String {
    let sizes = USUAL_SCALES.map(|scale| {
        let side = |pixels: u32| (f64::from(pixels) / scale).round().max(1.0) as u32;
        ImageSize { width: side(images.width), height: side(images.height) }
    });
    let fitting: Vec<String> = sizes
        .into_iter()
        .filter(|size| is_centred(pinholes, *size))
        .map(|size| format!("--calib-size {}x{}", size.width, size.height))
        .collect();
    let [Pinhole { cx, cy, .. }, Pinhole { cx: right_cx, cy: right_cy, .. }] = pinholes;
    let remedy = match fitting.as_slice() {
        [] => "state the size of the images that it was made with, as --calib-size WxH".to_owned(),
        [one] => format!("it may have been made with larger or smaller images: {one} states that"),
        several => {
            format!("it may have been made with larger or smaller images: state which, {}", several.join(" or "))
        }
    };
    format!(
        "the file states no image size, and for the images of {}x{} the principal points ({cx:.1}, {cy:.1}) and ({right_cx:.1}, \
         {right_cy:.1}) are more than 20 % of a side from the middle; {remedy}",
        images.width, images.height
    )
}

/// A camera; `lens` decides if the file does not.
fn camera(roots: &[Node<'_>], side: usize, size: ImageSize, lens: LensModel) -> Result<Camera, CalibrationFileError> {
    let intrinsics = get(roots, &MATRIX[side])?;
    let coefficients = get(roots, &COEFFICIENTS[side])?;
    let distortion = match (find(roots, &MODEL[side]), lens) {
        (Some(model), _) => checks::distortion(&model, model.text()?, &coefficients)?,
        (None, LensModel::BrownConrady) => distortion(&coefficients)?,
        (None, LensModel::Equidistant) => checks::distortion(&coefficients, "equidistant", &coefficients)?,
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
    checks::none_of_prism_and_tilt(node, numbers.get(8..).unwrap_or_default())?;
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

/// The unit of length of the file: stated by it, by the caller, or the only plausible one.
fn unit(
    roots: &[Node<'_>],
    (translation, length): (&Node<'_>, f64),
    stated: Option<LengthUnit>,
    remarks: &mut Remarks,
) -> Result<LengthUnit, CalibrationFileError> {
    if let Some(node) = find(roots, &UNITS) {
        let unit: LengthUnit = node.text()?.parse().map_err(|reason: String| node.refuse(reason))?;
        return match stated.filter(|stated| *stated != unit) {
            Some(other) => Err(node.refuse(format!(
                "is {}, --calib-unit states {}: leave the option out, or correct the file",
                unit.name(),
                other.name()
            ))),
            None => Ok(unit),
        };
    }
    if let Some(unit) = stated {
        return Ok(unit);
    }
    let baseline = |unit: &LengthUnit| format!("{:.1} mm with the unit {}", length * unit.metres() * 1e3, unit.name());
    let baselines = |units: &[LengthUnit]| units.iter().map(baseline).collect::<Vec<_>>().join(", ");
    let plausible: Vec<LengthUnit> =
        LengthUnit::ALL.into_iter().filter(|unit| plausible_m(*unit).contains(&(length * unit.metres()))).collect();
    let options = |units: &[LengthUnit]| {
        units.iter().map(|unit| format!("--calib-unit {}", unit.name())).collect::<Vec<_>>().join(" or ")
    };
    match plausible.as_slice() {
        [unit] => {
            let others = LengthUnit::ALL.into_iter().filter(|other| other != unit).collect::<Vec<_>>();
            remarks.warnings.push(format!(
                "the calibration states no unit of length: {} is used, because the baseline is then {:.1} mm (otherwise {}); if this is wrong, \
                 state it with --calib-unit",
                unit.name(),
                length * unit.metres() * 1e3,
                baselines(&others)
            ));
            Ok(*unit)
        }
        units => {
            let shown = if units.is_empty() { &LengthUnit::ALL } else { units };
            let how_many = if units.is_empty() { "none is plausible" } else { "both are plausible" };
            Err(translation.refuse(format!(
                "has length {length:.4}, and the file states no unit; the baseline is {}: {how_many}; state the unit with {}, or add \
                 the key units with mm, cm or m",
                baselines(shown),
                options(shown)
            )))
        }
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
