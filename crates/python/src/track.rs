//! The pose of a tracked target in one frame.

use nalgebra::Vector2;
use numpy::{PyArray1, PyArray2};
use pb3dp_cell::result_lines::TrackLine;
use pb3dp_estimation_core::estimate::TrackEstimate as Inner;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::wording::in_python;

/// The pose of a tracked target in one frame, with its status and the reason for it.
///
/// Frames: `cam_left` is the left camera (x to the right, y down, z forward). `model` is fixed to the target: in the first frame its origin is on
/// the ray of the centroid of the region, z along the normal away from the camera, x along the rows of the image.
#[pyclass(frozen, module = "pb3dp")]
pub struct TrackEstimate {
    estimate: Inner,
    cpu_millis: f64,
    input_warnings: Vec<String>,
}

impl TrackEstimate {
    /// The result of one frame.
    pub fn new(estimate: Inner, cpu_millis: f64) -> Self {
        Self { estimate, cpu_millis, input_warnings: Vec::new() }
    }

    /// With warnings about pair and calibration.
    pub fn with(self, input_warnings: Vec<String>) -> Self {
        Self { input_warnings, ..self }
    }

    fn warning_texts(&self) -> Vec<String> {
        self.estimate.warnings.iter().map(ToString::to_string).chain(self.input_warnings.iter().cloned()).collect()
    }
}

#[pymethods]
impl TrackEstimate {
    /// `ok`, `weak-tilt`, `partly-observed`, `weak-depth`, `ambiguous`, `miscalibrated`, `not-observable` or `lost`; treat a word
    /// that you do not know as not `ok`.
    #[getter]
    fn status(&self) -> &'static str {
        self.estimate.status.as_str()
    }

    /// What led to the status.
    #[getter]
    fn reason(&self) -> String {
        in_python(&self.estimate.reason)
    }

    /// What may make the pose worse than its status; reported once, with the first frame.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warning_texts().iter().map(|warning| in_python(warning)).collect()
    }

    /// Pose of the target: 4x4, maps coordinates in `model` to `cam_left`, translation in metres; or None.
    #[getter]
    fn cam_left_from_model<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::pose_if_any(py, self.estimate.cam_left_from_model.as_ref())
    }

    /// Translation of `cam_left_from_model`, 3 numbers, metres, or None.
    #[getter]
    fn translation_m<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.estimate.cam_left_from_model.map(|pose| arrays::vector(py, pose.translation_m().as_slice()))
    }

    /// Rotation of `cam_left_from_model` as unit quaternion, 4 numbers x, y, z, w, or None.
    #[getter]
    fn quaternion_xyzw<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.estimate.cam_left_from_model.map(|pose| arrays::vector(py, &arrays::quaternion_xyzw(&pose)))
    }

    /// Covariance of the pose since the first one, 6x6, or None: of xi = (x, y, z in metres, then a rotation vector in radians), both along the
    /// axes of `model`, with true pose = cam_left_from_model * exp(xi). In the first frame it is that of the first pose.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.estimate.covariance.as_ref())
    }

    /// Covariance of the first pose against the visible surface of the target, 6x6 as `covariance`, or None: choice of the surface, relief, noise,
    /// motion between the exposures, and the share of the calibration.
    #[getter]
    fn first_pose_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.estimate.first_pose_covariance.as_ref())
    }

    /// Covariance of the pose against the visible surface, 6x6 as `covariance`, or None: the sum of `covariance` and `first_pose_covariance`.
    #[getter]
    fn pose_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.estimate.pose_covariance.as_ref())
    }

    /// Pose of the visible surface in `model`, as the frames so far show it: 4x4, metres, or None. `model` itself never moves.
    #[getter]
    fn surface_from_model<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::pose_if_any(py, self.estimate.surface.as_ref().map(|surface| &surface.surface_from_model))
    }

    /// Covariance of `surface_from_model` against the visible surface, 6x6 as `covariance`, or None.
    #[getter]
    fn surface_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.estimate.surface.as_ref().map(|surface| &surface.covariance))
    }

    /// Number of frames that have improved `surface_from_model`, or None; 0: it is the identity.
    #[getter]
    fn surface_version(&self) -> Option<u32> {
        self.estimate.surface.map(|surface| surface.version)
    }

    /// The share of the calibration in `pose_covariance`, 6x6; None without a pose, or if the calibration file states no covariance
    /// (`StereoRig.calibration_covariance`).
    #[getter]
    fn calibration_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.estimate.calibration.as_ref().map(|share| &share.pose))
    }

    /// The share of the calibration in the motion since the first pose of the target, 6x6, not contained in `covariance`, or None: zero at the
    /// first pose, and small while the target is near it.
    #[getter]
    fn calibration_covariance_of_motion<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::covariance(py, self.estimate.calibration.as_ref().map(|share| &share.motion))
    }

    /// Whether the images determine x, y, z and the turns about them (axes of `model`), 6 values, or None if the method does not tell.
    #[getter]
    fn observed(&self) -> Option<[bool; 6]> {
        self.estimate.observed
    }

    /// Agreement of model and images, at most 1, or None.
    #[getter]
    fn fitness(&self) -> Option<f64> {
        self.estimate.fitness
    }

    /// Outline of the target in the left image: N x 2, pixels.
    #[getter]
    fn outline_px<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let numbers = self.estimate.outline_px.iter().flat_map(|corner: &Vector2<f64>| [corner.x, corner.y]);
        arrays::matrix(py, 2, numbers.collect())
    }

    /// CPU time from the images in memory to the pose, seconds.
    #[getter]
    fn cpu_s(&self) -> f64 {
        self.cpu_millis * 1e-3
    }

    /// The line that `pb3dp track --json` prints, in millimetres and milliseconds; `frame` is the number in it, and `t_s` the time, seconds.
    #[pyo3(signature = (frame=0, t_s=0.0))]
    fn to_json(&self, py: Python<'_>, frame: usize, t_s: f64) -> PyResult<String> {
        let line = TrackLine::of(frame, t_s, &self.estimate, self.cpu_millis);
        let line = TrackLine { warnings: self.warning_texts(), ..line };
        serde_json::to_string(&line).or_raise(py)
    }

    fn __repr__(&self) -> String {
        match self.estimate.cam_left_from_model {
            Some(pose) => format!("TrackEstimate({}, z {:.4} m)", self.status(), pose.translation_m().z),
            None => format!("TrackEstimate({}: {})", self.status(), self.reason()),
        }
    }
}
