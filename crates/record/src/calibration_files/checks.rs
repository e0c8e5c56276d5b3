//! Converts the numbers of a file to cameras and rigs; every error names the key.

use nalgebra::{Matrix3, Vector3};
use pb3dp_geometry::{Camera, CameraError, Distortion, ImageSize, Pinhole, Pose, StereoRig, StereoRigError};

use super::document::Node;
use super::error::CalibrationFileError;

/// Tolerance of `R R^T` against the identity and of the determinant against 1; some files have only four digits.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Allowed range of the baseline, metres.
const BASELINE_RANGE_M: std::ops::RangeInclusive<f64> = 1e-3..=10.0;
/// Maximum distance of the principal point outside the image, in image sides.
const OUTSIDE_MAX: f64 = 0.5;

/// A pinhole from a 3x3 camera matrix.
pub(super) fn pinhole(node: &Node<'_>) -> Result<Pinhole, CalibrationFileError> {
    let k: Matrix3<f64> = node.matrix()?;
    if k[(0, 1)].abs() > 1e-9 * k[(0, 0)].abs() {
        return Err(node.refuse(format!("element [0][1], the skew, is {}; it must be 0", k[(0, 1)])));
    }
    if k[(1, 0)] != 0.0 || k[(2, 0)] != 0.0 || k[(2, 1)] != 0.0 || (k[(2, 2)] - 1.0).abs() > 1e-12 {
        return Err(node.refuse("is not a camera matrix; it must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]"));
    }
    Ok(Pinhole { fx: k[(0, 0)], fy: k[(1, 1)], cx: k[(0, 2)], cy: k[(1, 2)] })
}

/// A camera; `node` is the position of its intrinsics.
pub(super) fn camera(
    node: &Node<'_>,
    size: ImageSize,
    pinhole: Pinhole,
    distortion: Distortion,
) -> Result<Camera, CalibrationFileError> {
    near_the_image(node, size, &pinhole)?;
    off_centre_camera(node, size, pinhole, distortion)
}

/// A camera whose images may be any part of those that its lens gives.
pub(super) fn off_centre_camera(
    node: &Node<'_>,
    size: ImageSize,
    pinhole: Pinhole,
    distortion: Distortion,
) -> Result<Camera, CalibrationFileError> {
    Camera::new(size, pinhole, distortion).map_err(|error| match error {
        CameraError::Parameter { name, value, expected } => node.refuse(format!("{name} is {value}: it {expected}")),
        other => node.refuse(other),
    })
}

/// Refuses a principal point far outside the image.
pub(super) fn near_the_image(node: &Node<'_>, size: ImageSize, pinhole: &Pinhole) -> Result<(), CalibrationFileError> {
    let sides = [("cx", pinhole.cx, "width", size.width), ("cy", pinhole.cy, "height", size.height)];
    for (name, value, side, length) in sides {
        let length = f64::from(length);
        if !(-OUTSIDE_MAX * length..=(1.0 + OUTSIDE_MAX) * length).contains(&value) {
            let reason = format!(
                "{name} is {value}, far outside the image, whose {side} is {length}; the calibration belongs to another image size, or the order of the numbers is wrong"
            );
            return Err(node.refuse(reason));
        }
    }
    Ok(())
}

/// A distortion from a model name and its coefficients in the order of that model.
///
/// Brown-Conrady coefficients that are all zero give [`Distortion::None`].
pub(super) fn distortion(
    model: &Node<'_>,
    name: &str,
    coefficients: &Node<'_>,
) -> Result<Distortion, CalibrationFileError> {
    let numbers = coefficients.numbers()?;
    let wrong_count = |needed: &str| {
        Err(coefficients.refuse(format!("has {} coefficients, the model {name} has {needed}", numbers.len())))
    };
    match name {
        "plumb_bob" | "radtan" => match numbers.as_slice() {
            [k1, k2, p1, p2] => Ok(brown([*k1, *k2, *p1, *p2, 0.0])),
            [k1, k2, p1, p2, k3] if name == "plumb_bob" => Ok(brown([*k1, *k2, *p1, *p2, *k3])),
            _ if name == "radtan" => wrong_count("4 (k1 k2 p1 p2)"),
            _ => wrong_count("5 (k1 k2 p1 p2 k3)"),
        },
        // ROS drivers also write the 12 or 14 coefficients of OpenCV under this name.
        "rational_polynomial" => match numbers.split_first_chunk::<8>() {
            Some((eight, rest)) if [0, 4, 6].contains(&rest.len()) => {
                none_of_prism_and_tilt(coefficients, rest)?;
                Ok(if *eight == [0.0; 8] {
                    Distortion::None
                } else {
                    Distortion::BrownConrady8 { coefficients: *eight }
                })
            }
            _ => wrong_count("8 (k1 k2 p1 p2 k3 k4 k5 k6)"),
        },
        "equidistant" | "fisheye" => match <[f64; 4]>::try_from(numbers.as_slice()) {
            Ok(coefficients) => Ok(Distortion::Equidistant { coefficients }),
            Err(_) => wrong_count("4 (k1 k2 k3 k4)"),
        },
        "none" if numbers.iter().all(|number| *number == 0.0) => Ok(Distortion::None),
        "none" => wrong_count("none"),
        _ => Err(model.refuse(format!(
            "unknown distortion model {name}; use plumb_bob or radtan, rational_polynomial, equidistant or fisheye, or none"
        ))),
    }
}

/// Refuses coefficients after the eighth that are not zero.
pub(super) fn none_of_prism_and_tilt(node: &Node<'_>, rest: &[f64]) -> Result<(), CalibrationFileError> {
    match rest.iter().all(|number| *number == 0.0) {
        true => Ok(()),
        false => {
            Err(node
                .refuse("has a thin prism or tilt term, which is not supported; calibrate with 5 or 8 coefficients"))
        }
    }
}

fn brown(coefficients: [f64; 5]) -> Distortion {
    if coefficients == [0.0; 5] { Distortion::None } else { Distortion::BrownConrady5 { coefficients } }
}

/// A rotation matrix, checked.
pub(super) fn rotation(node: &Node<'_>, matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, CalibrationFileError> {
    let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    let determinant = matrix.determinant();
    if determinant < 0.0 {
        return Err(node.refuse(format!("is not a rotation: its determinant is {determinant:.6}, it is a reflection")));
    }
    if !(off <= ROTATION_TOLERANCE && (determinant - 1.0).abs() <= ROTATION_TOLERANCE) {
        let reason = format!(
            "is not a rotation: R R^T differs from the identity by {off:.2e} ({ROTATION_TOLERANCE:.0e} allowed), the determinant is {determinant:.6}"
        );
        return Err(node.refuse(reason));
    }
    Ok(*matrix)
}

/// A rig from its cameras and `cam_right_from_cam_left`; `node` is the position of the translation.
pub(super) fn rig(
    node: &Node<'_>,
    [left, right]: [Camera; 2],
    rotation: &Matrix3<f64>,
    translation_m: Vector3<f64>,
) -> Result<StereoRig, CalibrationFileError> {
    let (l, r) = (left.size(), right.size());
    if l != r {
        let reason = format!(
            "the left images have {}x{} pixels and the right images {}x{}; the sizes must be equal",
            l.width, l.height, r.width, r.height
        );
        return Err(node.refuse(reason));
    }
    let baseline_m = translation_m.norm();
    if !BASELINE_RANGE_M.contains(&baseline_m) {
        let reason =
            format!("the baseline is {baseline_m} m, it must be between 0.001 and 10 m; check the unit of length");
        return Err(node.refuse(reason));
    }
    let cam_right_from_cam_left = Pose::from_rotation_matrix(rotation, translation_m);
    StereoRig::new(left, right, cam_right_from_cam_left).map_err(|error: StereoRigError| node.refuse(error))
}
