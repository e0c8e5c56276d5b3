//! Our `calib.json`: camera matrices, `R` and `t_mm` of `X_right = R X_left + t`, millimetres.

use nalgebra::{Matrix3, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, RectificationObstacle, StereoRig};
use serde_json::json;

use super::document::Node;
use super::error::CalibrationFileError;
use super::{checks, opencv, write};

/// The only supported convention; a file may add text after it.
const CONVENTION: &str = "X_right = R X_left + t";

/// Keys that a file need not have: mistyped, they would be missed without a word, and the images be read without distortion.
const OPTIONAL: [&str; 6] =
    ["rectified", "distortion", "distortion_left", "distortion_right", "baseline_mm", "doffs_px"];

/// Largest number of wrong, missing, additional or exchanged letters of a mistyped key. Other unknown keys are notes.
const MISTYPED: usize = 2;

pub(super) fn recognises(root: &Node<'_>) -> bool {
    // OpenCV files may spell a camera matrix the same way, but always have coefficients. A mistyped `t_mm` is named as missing.
    let is_ours = root.find("t_mm").is_some() || !opencv::has_coefficients(root);
    root.find("K_left").is_some() && is_ours || root.find("convention").is_some()
}

pub(super) fn read(root: &Node<'_>) -> Result<StereoRig, CalibrationFileError> {
    if let Some(convention) = root.find("convention")
        && !convention.text()?.starts_with(CONVENTION)
    {
        return Err(convention.refuse(format!("must begin with {CONVENTION:?}")));
    }
    refuse_mistyped(root)?;
    let size = root.get("image_size")?.size_pair()?;
    let cameras = [camera(root, "left", size)?, camera(root, "right", size)?];
    check_offset(root, &cameras)?;
    let rotation_node = root.get("R")?;
    let rotation: Matrix3<f64> = checks::rotation(&rotation_node, &rotation_node.matrix()?)?;
    let translation = root.get("t_mm")?;
    let translation_mm: Vector3<f64> = translation.matrix()?;
    if let Some(node) = root.find("baseline_mm") {
        let (stated, length) = (node.number()?, translation_mm.norm());
        if (stated - length).abs() > 1e-3 * length {
            return Err(node.refuse(format!("is {stated}, but the length of t_mm is {length}")));
        }
    }
    let rig = checks::rig(&translation, cameras, &rotation, translation_mm * 1e-3)?;
    if let Some(node) = root.find("rectified")
        && node.truth()?
    {
        let contradictions: Vec<String> = rig.obstacles().map(|obstacle| contradiction(&rig, obstacle)).collect();
        if !contradictions.is_empty() {
            let reason = format!(
                "is true, but {}; write false for images as the cameras took them, and correct these values otherwise",
                contradictions.join(", ")
            );
            return Err(node.refuse(reason));
        }
    }
    Ok(rig)
}

/// The keys with an obstacle, with their values.
fn contradiction(rig: &StereoRig, obstacle: RectificationObstacle) -> String {
    use RectificationObstacle as Obstacle;
    let differ = |element: &str, of: fn(&Pinhole) -> f64| {
        let [left, right] = [rig.left(), rig.right()].map(|camera| of(camera.pinhole()));
        format!("K_left{element} is {left} and K_right{element} is {right}")
    };
    let pose = rig.cam_right_from_cam_left();
    match obstacle {
        Obstacle::LeftDistortion => "distortion_left is given".to_owned(),
        Obstacle::RightDistortion => "distortion_right is given".to_owned(),
        Obstacle::Rotation => format!("R turns by {:.3e} degrees", pose.rotation_angle_rad().to_degrees()),
        Obstacle::Baseline => {
            let t_mm = pose.translation_m() * 1e3;
            format!("t_mm is [{:.4}, {:.4}, {:.4}], not along x", t_mm.x, t_mm.y, t_mm.z)
        }
        Obstacle::Fx => differ("[0][0]", |pinhole| pinhole.fx),
        Obstacle::Fy => differ("[1][1]", |pinhole| pinhole.fy),
        Obstacle::Cy => differ("[1][2]", |pinhole| pinhole.cy),
    }
}

fn refuse_mistyped(root: &Node<'_>) -> Result<(), CalibrationFileError> {
    for (key, node) in root.entries()? {
        let is_like = |known: &&&str| strsim::damerau_levenshtein(&key, known) <= MISTYPED;
        if !OPTIONAL.contains(&key.as_str())
            && let Some(known) = OPTIONAL.iter().find(is_like)
        {
            return Err(node.refuse(format!("is not a key of a calibration; did you mean {known}?")));
        }
    }
    Ok(())
}

/// The statement of a file that its numbers are not measured. The key is a free note, so other files may have any value there.
pub(super) fn not_measured(root: &Node<'_>) -> Option<String> {
    let text = root.find("calibration_quality")?.text().ok()?;
    text.starts_with("none").then(|| text.to_owned())
}

fn camera(root: &Node<'_>, side: &str, size: ImageSize) -> Result<Camera, CalibrationFileError> {
    let intrinsics = root.get(&format!("K_{side}"))?;
    let distortion = match root.find(&format!("distortion_{side}")) {
        Some(node) => {
            let model = node.get("model")?;
            checks::distortion(&model, model.text()?, &node.get("coefficients")?)?
        }
        None => {
            check_undistorted(root, side)?;
            Distortion::None
        }
    };
    checks::camera(&intrinsics, size, checks::pinhole(&intrinsics)?, distortion)
}

/// The free text `distortion` must not mention a distortion if the coefficients are missing.
fn check_undistorted(root: &Node<'_>, side: &str) -> Result<(), CalibrationFileError> {
    let Some(node) = root.find("distortion") else {
        return Ok(());
    };
    let text = node.text()?;
    if text.starts_with("none") {
        return Ok(());
    }
    Err(node.refuse(format!(
        "is {text:?}, but distortion_{side} is missing; give model and coefficients there, or write none here"
    )))
}

fn check_offset(root: &Node<'_>, [left, right]: &[Camera; 2]) -> Result<(), CalibrationFileError> {
    let Some(node) = root.find("doffs_px") else {
        return Ok(());
    };
    let (stated, offset) = (node.number()?, right.pinhole().cx - left.pinhole().cx);
    if (stated - offset).abs() > 0.01 {
        return Err(node.refuse(format!("is {stated}, but cx of K_right minus cx of K_left is {offset}")));
    }
    Ok(())
}

pub(super) fn write(rig: &StereoRig) -> String {
    let (left, right) = (rig.left(), rig.right());
    let pose = rig.cam_right_from_cam_left();
    let translation_mm = pose.translation_m() * 1e3;
    let rows = |matrix: &Matrix3<f64>| write::row_major(matrix).chunks(3).map(<[f64]>::to_vec).collect::<Vec<_>>();
    let mut value = json!({
        "image_size": [left.size().width, left.size().height],
        "rectified": rig.is_rectified(),
        "K_left": rows(&left.pinhole().matrix()),
        "K_right": rows(&right.pinhole().matrix()),
        "R": rows(&pose.rotation_matrix()),
        "t_mm": translation_mm.as_slice(),
        "baseline_mm": translation_mm.norm(),
        "doffs_px": right.pinhole().cx - left.pinhole().cx,
        "convention": format!("{CONVENTION}; x right, y down, z forward; pixel centres at integers"),
    });
    for (key, camera) in [("distortion_left", left), ("distortion_right", right)] {
        if *camera.distortion() != Distortion::None {
            let (model, coefficients) = write::distortion(camera.distortion());
            value[key] = json!({ "model": model, "coefficients": coefficients });
        }
    }
    format!("{value:#}\n")
}
