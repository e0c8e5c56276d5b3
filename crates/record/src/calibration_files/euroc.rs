//! The `sensor.yaml` of two cameras in the layout of the EuRoC MAV dataset: `T_BS` is the pose of the camera in the body, metres.

use nalgebra::{Matrix4, RowVector4};
use pb3dp_geometry::StereoRig;

use super::checks;
use super::document::Node;
use super::error::CalibrationFileError;
use super::kalibr::camera;

/// Key of the distortion coefficients.
const COEFFICIENTS: &str = "distortion_coefficients";

pub(super) fn read(left: &Node<'_>, right: &Node<'_>) -> Result<StereoRig, CalibrationFileError> {
    let cameras = [camera(left, COEFFICIENTS)?, camera(right, COEFFICIENTS)?];
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
