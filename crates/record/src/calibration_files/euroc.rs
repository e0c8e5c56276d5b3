//! The `sensor.yaml` of two cameras in the layout of the EuRoC MAV dataset: `T_BS` is the pose of the camera in the body, metres.

use nalgebra::{Matrix4, RowVector4};
use pb3dp_geometry::{Camera, Distortion, Pinhole, StereoRig};

use super::checks;
use super::document::Node;
use super::error::CalibrationFileError;

pub(super) fn read(left: &Node<'_>, right: &Node<'_>) -> Result<StereoRig, CalibrationFileError> {
    let cameras = [camera(left)?, camera(right)?];
    let (left_pose, _) = pose(left)?;
    let (right_pose, node) = pose(right)?;
    // The inverse of a rigid transform: its rotation was checked.
    let right_back = right_pose.fixed_view::<3, 3>(0, 0).transpose();
    let between = left_pose.fixed_view::<3, 1>(0, 3) - right_pose.fixed_view::<3, 1>(0, 3);
    checks::rig(&node, cameras, &(right_back * left_pose.fixed_view::<3, 3>(0, 0)), right_back * between)
}

fn pose<'a>(root: &Node<'a>) -> Result<(Matrix4<f64>, Node<'a>), CalibrationFileError> {
    let node = root.get("T_BS")?;
    let mut matrix: Matrix4<f64> = node.matrix()?;
    if matrix.row(3) != RowVector4::new(0.0, 0.0, 0.0, 1.0) {
        return Err(node.refuse("is not a rigid transform: its last row must be 0, 0, 0, 1"));
    }
    let rotation = checks::rotation(&node, &matrix.fixed_view::<3, 3>(0, 0).into_owned())?;
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    Ok((matrix, node))
}

fn camera(root: &Node<'_>) -> Result<Camera, CalibrationFileError> {
    let camera_model = root.get("camera_model")?;
    let name = camera_model.text()?;
    if name != "pinhole" {
        return Err(camera_model.refuse(format!("unknown camera model {name}; it must be pinhole")));
    }
    let intrinsics = root.get("intrinsics")?;
    let pinhole = match intrinsics.numbers()?.as_slice() {
        [fx, fy, cx, cy] => Pinhole { fx: *fx, fy: *fy, cx: *cx, cy: *cy },
        other => return Err(intrinsics.refuse(format!("has {} numbers, 4 are needed: fu, fv, cu, cv", other.len()))),
    };
    let model = root.get("distortion_model")?;
    let coefficients = || root.get("distortion_coefficients");
    let distortion = match model.text()? {
        "none" => Distortion::None,
        "radial-tangential" | "radtan" => checks::distortion(&model, "radtan", &coefficients()?)?,
        "equidistant" => checks::distortion(&model, "equidistant", &coefficients()?)?,
        other => {
            let reason = format!("unknown distortion model {other}; use radial-tangential, equidistant or none");
            return Err(model.refuse(reason));
        }
    };
    checks::camera(&intrinsics, root.get("resolution")?.size_pair()?, pinhole, distortion)
}
