//! The pose of a region in one stereo pair.

use nalgebra::{Matrix6, Vector2, Vector3};
use numpy::{PyArray1, PyArray2};
use pb3dp_cell::result_lines::EstimateLine;
use pb3dp_estimation::estimator::Method;
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::wording::in_python;

/// The pose of a region in one stereo pair, with its status and the reason for it.
///
/// Frames: `cam_left` is the left camera (x to the right, y down, z forward). `model` is on the plane of the region: its origin on the ray of
/// `centroid_px`, z along the normal away from the camera, x along the rows of the image.
#[pyclass(frozen, module = "pb3dp")]
pub struct Estimate {
    method: Method,
    estimate: PlaneEstimate,
    centroid_px: Vector2<f64>,
    z_m: Option<f64>,
    cam_left_from_model: Option<Pose<CamLeft, Model>>,
    covariance: Option<Matrix6<f64>>,
    calibration_covariance: Option<Matrix6<f64>>,
    cpu_millis: f64,
    input_warnings: Vec<String>,
}

impl Estimate {
    /// An estimate, with its depth on the ray of a pixel; the share of the calibration in its covariance, and warnings about pair and
    /// calibration.
    pub fn new(
        method: Method,
        (estimate, cpu_millis): (PlaneEstimate, f64),
        (centroid_px, z_m): (Vector2<f64>, Option<f64>),
        (calibration_covariance, input_warnings): (Option<Matrix6<f64>>, Vec<String>),
    ) -> Self {
        let frame = estimate.model_frame(&centroid_px);
        Self {
            method,
            centroid_px,
            z_m,
            cam_left_from_model: frame.map(|frame| frame.cam_left_from_model),
            covariance: frame.and_then(|frame| frame.covariance),
            calibration_covariance,
            cpu_millis,
            input_warnings,
            estimate,
        }
    }

    fn warning_texts(&self) -> Vec<String> {
        self.estimate.warnings.iter().map(ToString::to_string).chain(self.input_warnings.iter().cloned()).collect()
    }
}

#[pymethods]
impl Estimate {
    /// `ok`, `weak-tilt`, `weak-depth`, `ambiguous`, `miscalibrated` or `not-observable`; treat a word that you do not know as not `ok`.
    #[getter]
    fn status(&self) -> &'static str {
        self.estimate.status.as_str()
    }

    /// What led to the status.
    #[getter]
    fn reason(&self) -> String {
        in_python(&self.estimate.reason)
    }

    /// What may make the pose worse than its status.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warning_texts().iter().map(|warning| in_python(warning)).collect()
    }

    /// The method: `direct` or `published`.
    #[getter]
    fn method(&self) -> &'static str {
        self.method.name()
    }

    /// Depth of the plane on the ray of `centroid_px`, metres, or None.
    #[getter]
    fn z_m(&self) -> Option<f64> {
        self.z_m
    }

    /// Unit normal of the plane in `cam_left`, 3 numbers, towards the camera, or None.
    #[getter]
    fn normal<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.estimate.normal_in_cam_left().map(|normal: Vector3<f64>| arrays::vector(py, normal.as_slice()))
    }

    /// Pose of the plane: 4x4, maps coordinates in `model` to `cam_left`, translation in metres; or None.
    #[getter]
    fn cam_left_from_model<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::pose_if_any(py, self.cam_left_from_model.as_ref())
    }

    /// Translation of `cam_left_from_model`, 3 numbers, metres, or None.
    #[getter]
    fn translation_m<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.cam_left_from_model.map(|pose| arrays::vector(py, pose.translation_m().as_slice()))
    }

    /// Rotation of `cam_left_from_model` as unit quaternion, 4 numbers x, y, z, w, or None.
    #[getter]
    fn quaternion_xyzw<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.cam_left_from_model.map(|pose| arrays::vector(py, &arrays::quaternion_xyzw(&pose)))
    }

    /// Covariance of the pose, 6x6, or None: of xi = (x, y, z in metres, then a rotation vector in radians), both along the axes of `model`,
    /// with true pose = cam_left_from_model * exp(xi).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.covariance.as_ref())
    }

    /// The sum of `covariance` and `calibration_covariance`, 6x6, or None.
    #[getter]
    fn pose_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let share = self.calibration_covariance.unwrap_or_else(Matrix6::zeros);
        arrays::covariance(py, self.covariance.map(|own| own + share).as_ref())
    }

    /// The share of the calibration in the covariance of the pose, 6x6 as `covariance`, in which it is not contained; None without a pose, or if
    /// the calibration file states no covariance (`StereoRig.calibration_covariance`).
    #[getter]
    fn calibration_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.calibration_covariance.as_ref())
    }

    /// Whether the images determine x, y, z and the turns about them (axes of `model`), 6 values, or None if the method does not tell.
    #[getter]
    fn observed(&self) -> Option<[bool; 6]> {
        self.estimate.observed
    }

    /// How well the images agree, at most 1, or None.
    #[getter]
    fn fitness(&self) -> Option<f64> {
        self.estimate.fitness
    }

    /// Standard deviation of the depth, metres, or None.
    #[getter]
    fn z_sigma_m(&self) -> Option<f64> {
        self.estimate.z_sigma_m
    }

    /// Standard deviation of the normal, radians, or None.
    #[getter]
    fn normal_sigma_rad(&self) -> Option<f64> {
        self.estimate.normal_sigma_rad
    }

    /// The point of the left image on whose ray the depth is given: column and row, pixels.
    #[getter]
    fn centroid_px(&self) -> (f64, f64) {
        (self.centroid_px.x, self.centroid_px.y)
    }

    /// Row of the right image minus row of the left one in the rectified pair, pixels, or None.
    #[getter]
    fn row_offset_px(&self) -> Option<f64> {
        self.estimate.row_offset_px
    }

    /// CPU time from the images in memory to the pose, seconds.
    #[getter]
    fn cpu_s(&self) -> f64 {
        self.cpu_millis * 1e-3
    }

    /// The line that `pb3dp estimate --json` prints, in millimetres and milliseconds; `case` is the name in it.
    #[pyo3(signature = (case=""))]
    fn to_json(&self, py: Python<'_>, case: &str) -> PyResult<String> {
        let place = (self.centroid_px, self.z_m);
        let share = self.calibration_covariance.as_ref();
        let line = EstimateLine::of(case, self.method.name(), &self.estimate, place, share, self.cpu_millis);
        let line = EstimateLine { warnings: self.warning_texts(), ..line };
        serde_json::to_string(&line).or_raise(py)
    }

    fn __repr__(&self) -> String {
        match self.z_m {
            Some(z_m) => format!("Estimate({}, z {:.4} m)", self.status(), z_m),
            None => format!("Estimate({}: {})", self.status(), self.reason()),
        }
    }
}
