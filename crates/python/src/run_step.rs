//! Control steps of a simulated run, and the pairs that were estimated in it.

use numpy::{PyArray1, PyArray2};
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::perception::View;
use pb3dp_cell::stepped::SteppedStep;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::FramePair;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::arrays;
use crate::images::array_of;
use crate::track::TrackEstimate;

/// Both arms in the order of their numbers.
const ARMS: [ArmChoice; 2] = [ArmChoice::Vs, ArmChoice::Tc];

/// One control step of a simulated run. Arm 0 carries the cameras, arm 1 the target.
#[pyclass(frozen, module = "pb3dp")]
pub struct RunStep {
    step: SteppedStep,
    pairs: Vec<Py<RunPair>>,
}

impl RunStep {
    /// A finished step.
    pub fn new(py: Python<'_>, mut step: SteppedStep) -> PyResult<Self> {
        let begin = step.begin;
        let estimates = std::mem::take(&mut step.estimates);
        let pairs = estimates
            .into_iter()
            .map(|estimates| Py::new(py, RunPair::new(begin, estimates)))
            .collect::<PyResult<_>>()?;
        Ok(Self { step, pairs })
    }
}

#[pymethods]
impl RunStep {
    /// Number of the step, from 0.
    #[getter]
    fn number(&self) -> u64 {
        self.step.moved.number
    }

    /// Time since the first step, seconds.
    #[getter]
    fn t_s(&self) -> f64 {
        self.step.moved.at.seconds_since(self.step.begin)
    }

    /// State of the supervisor, such as `following`.
    #[getter]
    fn state(&self) -> String {
        self.step.moved.decision.state.to_string()
    }

    /// Why the arm does not move, and the remedy, in one line.
    #[getter]
    fn why(&self) -> String {
        self.step.moved.decision.why.to_string()
    }

    /// Mode of the controller, with the reason if the arm holds.
    #[getter]
    fn mode(&self) -> String {
        self.step.moved.mode.to_string()
    }

    /// Measured joint angles of an arm, one number for each joint, radians. `arm`: 0 carries the cameras, 1 the target. Raises `IndexError` for
    /// another number.
    fn joints_rad<'py>(&self, py: Python<'py>, arm: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(arrays::vector(py, self.step.moved.arms[numbered(arm)?].position_rad.as_slice()))
    }

    /// Joint velocities that the controller requests of an arm, one number for each joint, radians per second, or None if the arm shall hold.
    /// `arm` as for `joints_rad`.
    fn requested_rad_per_s<'py>(&self, py: Python<'py>, arm: usize) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        let requested = self.step.moved.arms[numbered(arm)?].requested_rad_per_s;
        Ok(requested.map(|velocity| arrays::vector(py, velocity.as_slice())))
    }

    /// True pose of the hand: 4x4, maps coordinates in `hand` to `world`, translation in metres, or None.
    #[getter]
    fn world_from_hand<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::pose_if_any(py, self.step.poses.map(|poses| poses.world_from_hand).as_ref())
    }

    /// True pose of the target: 4x4, maps coordinates in `target` to `world`, translation in metres, or None.
    #[getter]
    fn world_from_target<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::pose_if_any(py, self.step.poses.map(|poses| poses.world_from_target).as_ref())
    }

    /// Pose of the target by the filter of the controller, in the base of arm 0: 4x4, metres, or None.
    #[getter]
    fn base_from_model<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        arrays::pose_if_any(py, self.step.moved.base_from_model.as_ref())
    }

    /// The pairs that were estimated since the step before: most steps have none.
    #[getter]
    fn pairs(&self, py: Python<'_>) -> Vec<Py<RunPair>> {
        self.pairs.iter().map(|pair| pair.clone_ref(py)).collect()
    }

    fn __repr__(&self) -> String {
        format!("RunStep({:.3} s, {})", self.t_s(), self.state())
    }
}

/// The number of an arm, if there is such an arm.
///
/// # Errors
/// `IndexError`.
pub fn numbered(arm: usize) -> PyResult<usize> {
    match ARMS.get(arm) {
        Some(_) => Ok(arm),
        None => {
            let names = ARMS.map(ArmChoice::name).join(" and ");
            Err(PyIndexError::new_err(format!("arm {arm}: there are arms 0 and 1, {names}")))
        }
    }
}

/// A pair that a simulated run has estimated, with the truth.
#[pyclass(frozen, module = "pb3dp")]
pub struct RunPair {
    t_s: f64,
    estimates: PairEstimate,
}

impl RunPair {
    fn new(begin: MonotonicTime, estimates: PairEstimate) -> Self {
        Self { t_s: estimates.captured.frame.at.seconds_since(begin), estimates }
    }

    fn images(&self) -> Option<&FramePair> {
        match &self.estimates.captured.view {
            View::Images(pair) => Some(pair),
            View::Geometric(_) | View::Nothing => None,
        }
    }
}

#[pymethods]
impl RunPair {
    /// Middle of the exposure since the first control step, seconds.
    #[getter]
    fn t_s(&self) -> f64 {
        self.t_s
    }

    /// Number of the pair; a gap means that pairs were lost.
    #[getter]
    fn sequence(&self) -> u64 {
        self.estimates.captured.frame.sequence
    }

    /// The estimate of the method that leads the hand. Its `cpu_s` is the time on the wall.
    #[getter]
    fn estimate(&self) -> TrackEstimate {
        TrackEstimate::new(self.estimates.estimate.clone(), self.estimates.latency_millis)
    }

    /// True pose of the target at the exposure: 4x4, maps coordinates in `target` to `cam_left`, translation in metres, or None.
    #[getter]
    fn cam_left_from_target<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let truth: Option<&Pose<CamLeft, Target>> = self.estimates.captured.cam_left_from_target.as_ref();
        arrays::pose_if_any(py, truth)
    }

    /// The rendered left image, height x width x 3, uint8, in the order red, green, blue; None in a run without images. A copy.
    #[getter]
    fn left<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.images().map(|pair| array_of(py, pair.left.clone())).transpose()
    }

    /// The rendered right image, as `left`.
    #[getter]
    fn right<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.images().map(|pair| array_of(py, pair.right.clone())).transpose()
    }

    fn __repr__(&self) -> String {
        format!("RunPair({:.3} s, {})", self.t_s, self.estimates.estimate.status)
    }
}
