//! Recorded runs as arrays.

use std::path::PathBuf;

use nalgebra::Matrix6;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pb3dp_geometry::{Frame, Pose};
use pb3dp_recording::series::{EstimateEntry, RunSeries, StepEntry};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::run_step::numbered;

/// Estimates and control steps of a run that `pb3dp run --record FILE.mcap` has recorded, as arrays.
///
/// `path`: the file, which may have been broken off. Times are seconds since the first control step. Unknown numbers are NaN. Images are in
/// `Recording`. Raises `Error` if the file is no recorded run.
#[pyclass(frozen, module = "pb3dp")]
pub struct RecordedRun {
    series: RunSeries,
}

type Matrices<'py> = PyResult<Bound<'py, PyArray3<f64>>>;

impl RecordedRun {
    fn of_estimates<'py, A: Frame, B: Frame>(
        &self,
        py: Python<'py>,
        of: impl Fn(&EstimateEntry) -> Option<&Pose<A, B>>,
    ) -> Matrices<'py> {
        stacked(py, 4, self.series.estimates.iter().flat_map(|estimate| sixteen(of(estimate))).collect())
    }

    fn covariances_of<'py>(
        &self,
        py: Python<'py>,
        of: impl Fn(&EstimateEntry) -> Option<&Matrix6<f64>>,
    ) -> Matrices<'py> {
        let numbers = |known: Option<&Matrix6<f64>>| {
            known.map_or([f64::NAN; 36], |known| std::array::from_fn(|k| known[(k / 6, k % 6)]))
        };
        stacked(py, 6, self.series.estimates.iter().flat_map(|estimate| numbers(of(estimate))).collect())
    }

    fn of_steps<'py, A: Frame, B: Frame>(
        &self,
        py: Python<'py>,
        of: impl Fn(&StepEntry) -> Option<&Pose<A, B>>,
    ) -> Matrices<'py> {
        stacked(py, 4, self.series.steps.iter().flat_map(|step| sixteen(of(step))).collect())
    }
}

fn sixteen<A: Frame, B: Frame>(pose: Option<&Pose<A, B>>) -> [f64; 16] {
    pose.map_or([f64::NAN; 16], arrays::homogeneous)
}

fn stacked(py: Python<'_>, side: usize, numbers: Vec<f64>) -> Matrices<'_> {
    let count = numbers.len() / (side * side);
    PyArray1::from_vec(py, numbers).reshape([count, side, side])
}

fn seconds(py: Python<'_>, nanos: impl Iterator<Item = i64>) -> Bound<'_, PyArray1<f64>> {
    PyArray1::from_iter(py, nanos.map(|nanos| nanos as f64 * 1e-9))
}

#[pymethods]
impl RecordedRun {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self { series: py.detach(|| RunSeries::read(&path)).or_raise(py)? })
    }

    /// Middle of the exposure of each of the N estimates, seconds.
    #[getter]
    fn estimate_times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        seconds(py, self.series.estimates.iter().map(|estimate| estimate.at_nanos))
    }

    /// Status of each of the N estimates, as in `TrackEstimate.status`.
    #[getter]
    fn statuses(&self) -> Vec<&str> {
        self.series.estimates.iter().map(|estimate| estimate.status.as_str()).collect()
    }

    /// What led to each of the N statuses.
    #[getter]
    fn reasons(&self) -> Vec<&str> {
        self.series.estimates.iter().map(|estimate| estimate.reason.as_str()).collect()
    }

    /// Estimated poses: N x 4 x 4, each maps coordinates in `model` to `cam_left`, translation in metres.
    #[getter]
    fn cam_left_from_model<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.of_estimates(py, |estimate| estimate.cam_left_from_model.as_ref())
    }

    /// Covariances of the estimated poses: N x 6 x 6, as in `TrackEstimate.covariance`.
    #[getter]
    fn covariances<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.covariances_of(py, |estimate| estimate.covariance.as_ref())
    }

    /// Covariances against the visible surface: N x 6 x 6, as in `TrackEstimate.pose_covariance`.
    #[getter]
    fn pose_covariances<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.covariances_of(py, |estimate| estimate.pose_covariance.as_ref())
    }

    /// True poses of the target in simulation: N x 4 x 4, each maps coordinates in `target` to `cam_left`, translation in metres.
    #[getter]
    fn cam_left_from_target<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.of_estimates(py, |estimate| estimate.cam_left_from_target.as_ref())
    }

    /// Begin of each of the M control steps, seconds.
    #[getter]
    fn step_times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        seconds(py, self.series.steps.iter().map(|step| step.at_nanos))
    }

    /// State of the supervisor in each of the M steps.
    #[getter]
    fn states(&self) -> Vec<&str> {
        self.series.steps.iter().map(|step| step.state.as_str()).collect()
    }

    /// Mode of the controller in each of the M steps.
    #[getter]
    fn modes(&self) -> Vec<&str> {
        self.series.steps.iter().map(|step| step.mode.as_str()).collect()
    }

    /// Pose of the target by the filter of the controller, in the base of the arm with the cameras: M x 4 x 4, metres.
    #[getter]
    fn base_from_model<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.of_steps(py, |step| step.base_from_model.as_ref())
    }

    /// Pose of the hand: M x 4 x 4, metres; in simulation the true one, otherwise that from the measured joints.
    #[getter]
    fn world_from_hand<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.of_steps(py, |step| step.world_from_hand.as_ref())
    }

    /// Pose of the target: M x 4 x 4, metres, as `world_from_hand`.
    #[getter]
    fn world_from_target<'py>(&self, py: Python<'py>) -> Matrices<'py> {
        self.of_steps(py, |step| step.world_from_target.as_ref())
    }

    /// Measured joint angles of an arm: M x joints, radians. `arm`: 0 carries the cameras, 1 the target. Raises `IndexError` for another number.
    fn joints_rad<'py>(&self, py: Python<'py>, arm: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let arm = numbered(arm)?;
        let measured = || self.series.steps.iter().map(|step| &step.joints_rad[arm]);
        let joints = measured().map(Vec::len).max().unwrap_or(0);
        let padded =
            measured().flat_map(|angles| (0..joints).map(|joint| angles.get(joint).copied().unwrap_or(f64::NAN)));
        PyArray1::from_vec(py, padded.collect()).reshape([self.series.steps.len(), joints])
    }

    fn __repr__(&self) -> String {
        format!("RecordedRun({} estimates, {} control steps)", self.series.estimates.len(), self.series.steps.len())
    }
}
