//! Kalibr camchains: `cam0` is the left camera, `T_cn_cnm1` of `cam1` maps points of `cam0` to `cam1`, metres.

use nalgebra::{Matrix4, RowVector4};
use pb3dp_geometry::{Camera, Distortion, Pinhole, StereoRig};

use super::document::Node;
use super::error::CalibrationFileError;
use super::{CalibrationFormat, checks, write};

pub(super) fn recognises(root: &Node<'_>) -> bool {
    root.find("cam0").is_some()
}

pub(super) fn read(root: &Node<'_>) -> Result<StereoRig, CalibrationFileError> {
    let (left, right) = (root.get("cam0")?, root.get("cam1")?);
    if root.find("cam2").is_some() {
        return Err(root.error("cam2", "a chain of three or more cameras is not a stereo pair; keep cam0 and cam1"));
    }
    let cameras = [camera(&left, COEFFICIENTS)?, camera(&right, COEFFICIENTS)?];
    let transform = right.get("T_cn_cnm1")?;
    let matrix: Matrix4<f64> = transform.matrix()?;
    if matrix.row(3) != RowVector4::new(0.0, 0.0, 0.0, 1.0) {
        return Err(transform.refuse("is not a rigid transform: its last row must be 0, 0, 0, 1"));
    }
    let rotation = checks::rotation(&transform, &matrix.fixed_view::<3, 3>(0, 0).into_owned())?;
    checks::rig(&transform, cameras, &rotation, matrix.fixed_view::<3, 1>(0, 3).into_owned())
}

/// Key of the distortion coefficients.
const COEFFICIENTS: &str = "distortion_coeffs";

/// A pinhole camera; EuRoC has the same keys, but for that of the coefficients, and another name of `radtan`.
pub(super) fn camera(node: &Node<'_>, coefficients: &str) -> Result<Camera, CalibrationFileError> {
    let camera_model = node.get("camera_model")?;
    let name = camera_model.text()?;
    if name != "pinhole" {
        return Err(camera_model.refuse(format!("unknown camera model {name}; it must be pinhole")));
    }
    let intrinsics = node.get("intrinsics")?;
    let pinhole = match intrinsics.numbers()?.as_slice() {
        [fx, fy, cx, cy] => Pinhole { fx: *fx, fy: *fy, cx: *cx, cy: *cy },
        other => return Err(intrinsics.refuse(format!("has {} numbers, 4 are needed: fu, fv, pu, pv", other.len()))),
    };
    let model = node.get("distortion_model")?;
    let distortion = match model.text()? {
        "none" => Distortion::None,
        "radtan" | "radial-tangential" => checks::distortion(&model, "radtan", &node.get(coefficients)?)?,
        name @ "equidistant" => checks::distortion(&model, name, &node.get(coefficients)?)?,
        other => {
            let reason = format!("unknown distortion model {other}; use radtan, equidistant or none");
            return Err(model.refuse(reason));
        }
    };
    checks::camera(&intrinsics, node.get("resolution")?.size_pair()?, pinhole, distortion)
}

pub(super) fn write(rig: &StereoRig) -> Result<String, CalibrationFileError> {
    let mut text = String::new();
    for (name, camera) in [("cam0", rig.left()), ("cam1", rig.right())] {
        let (model, coefficients) = distortion(camera.distortion())?;
        let (p, size) = (camera.pinhole(), camera.size());
        text += &format!("{name}:\n  camera_model: pinhole\n");
        text += &format!("  intrinsics: {}\n", write::list(&[p.fx, p.fy, p.cx, p.cy]));
        text += &format!("  distortion_model: {model}\n");
        text += &format!("  distortion_coeffs: {}\n", write::list(&coefficients));
        text += &format!("  resolution: [{}, {}]\n", size.width, size.height);
    }
    text += "  T_cn_cnm1:\n";
    let transform = rig.cam_right_from_cam_left().to_homogeneous();
    for row in transform.row_iter() {
        text += &format!("  - {}\n", write::list(row.iter()));
    }
    Ok(text)
}

fn distortion(distortion: &Distortion) -> Result<(&'static str, Vec<f64>), CalibrationFileError> {
    let lacks = |what: &str| {
        let reason = format!("its radtan model has no {what}; use the ROS or OpenCV format");
        CalibrationFileError::NotRepresentable { format: CalibrationFormat::Kalibr, reason }
    };
    match distortion {
        Distortion::None => Ok(("radtan", vec![0.0; 4])),
        Distortion::BrownConrady5 { coefficients: [k1, k2, p1, p2, 0.0] } => Ok(("radtan", vec![*k1, *k2, *p1, *p2])),
        Distortion::BrownConrady5 { .. } => Err(lacks("k3")),
        Distortion::BrownConrady8 { .. } => Err(lacks("rational term")),
        Distortion::Equidistant { coefficients } => Ok(("equidistant", coefficients.to_vec())),
    }
}
