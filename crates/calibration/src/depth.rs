//! Effect of calibration errors on depth.

use nalgebra::{DMatrix, DVector, Point3, Vector2, Vector3};
use pb3dp_geometry::StereoRig;

use crate::adjust::State;
use crate::fitted_rig::{FitError, rig_of};

/// Step of the numerical derivatives, in standard deviations of a parameter.
const STEP_SIGMAS: f64 = 0.1;

/// Standard deviation of the triangulated depth of a point on the axis of the left camera, metres.
pub(crate) fn sigma_m(state: &State, covariance: &DMatrix<f64>, depth_m: f64) -> Result<f64, FitError> {
    let rig = rig_of(state)?;
    let in_left = Point3::new(0.0, 0.0, depth_m);
    let in_right = rig.cam_right_from_cam_left().transform_point(&in_left);
    let (Some(left), Some(right)) = (rig.left().project(&in_left), rig.right().project(&in_right)) else {
        return Ok(f64::INFINITY);
    };
    let count = covariance.nrows();
    let depth = |step: &DVector<f64>| -> Option<f64> {
        Some(triangulated(&rig_of(&state.moved(step, &[]).ok()?).ok()?, &left, &right)?.z)
    };
    let mut gradient = DVector::zeros(count);
    for index in 0..count {
        let size = STEP_SIGMAS * covariance[(index, index)].max(0.0).sqrt();
        let at = |sign: f64| depth(&DVector::from_fn(count, |n, _| if n == index { sign * size } else { 0.0 }));
        let (Some(above), Some(below)) = (at(1.0), at(-1.0)) else { return Ok(f64::INFINITY) };
        gradient[index] = if size > 0.0 { (above - below) / (2.0 * size) } else { 0.0 };
    }
    Ok(gradient.dot(&(covariance * &gradient)).max(0.0).sqrt())
}

/// The point in `cam_left` triangulated from a pair of pixels, metres.
pub(crate) fn triangulated(rig: &StereoRig, left: &Vector2<f64>, right: &Vector2<f64>) -> Option<Vector3<f64>> {
    let (a, b) = (rig.left().unproject(left).ok()?, rig.right().unproject(right).ok()?);
    let cam_left_from_cam_right = rig.cam_right_from_cam_left().inverse();
    Some(meeting(&a, &cam_left_from_cam_right.transform_vector(&b), &cam_left_from_cam_right.translation_m()))
}

/// The midpoint between two rays: one from the origin, one from `second_origin`.
fn meeting(first: &Vector3<f64>, second: &Vector3<f64>, second_origin: &Vector3<f64>) -> Vector3<f64> {
    let (aa, ab, bb) = (first.dot(first), first.dot(second), second.dot(second));
    let (ao, bo) = (first.dot(second_origin), second.dot(second_origin));
    let determinant = aa * bb - ab * ab;
    let (s, t) = ((bb * ao - ab * bo) / determinant, (ab * ao - aa * bo) / determinant);
    0.5 * (first * s + second_origin + second * t)
}
