//! Simulated runs, step by step.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::{Result, bail};
use nalgebra::Vector3;
use numpy::PyReadonlyArray2;
use pb3dp_cell::operator::MotionRequest;
use pb3dp_cell::stepped::{SteppedRun, check_simulated};
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::setup::read_layers;
use pb3dp_wiring::wire_stepped;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::run_step::RunStep;

/// A run of the simulated cell, step by step: cameras, estimation, control and both arms in simulated time.
///
/// `config`: a TOML file or a built-in setup, such as `sim`; or several, of which later ones override. `settings`: single keys, such as
/// `{"scene.target": "card", "experiment.target": "pushed"}`. `seed`: of all random numbers. `stop_after_s`: the end, seconds. Raises `Error`
/// if the setup cannot be used.
///
/// The run is that of `pb3dp run` with the same setup and seed, to the bit, as long as nothing is changed from outside. Only simulated arms
/// and cameras can be used: a setup with others is refused. A `for` loop gives all steps; leaving a `with` block ends the run.
#[pyclass(frozen, module = "pb3dp")]
pub struct Run {
    run: Mutex<SteppedRun>,
    method: &'static str,
    control_period_s: f64,
}

impl Run {
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut SteppedRun) -> Result<T> + Send) -> PyResult<T> {
        py.detach(|| work(&mut self.run.lock().unwrap_or_else(PoisonError::into_inner))).or_raise(py)
    }
}

#[pymethods]
impl Run {
    #[new]
    #[pyo3(signature = (config=Configs::One("sim".into()), *, settings=None, seed=None, stop_after_s=None))]
    fn new(
        py: Python<'_>,
        config: Configs,
        settings: Option<BTreeMap<String, Bound<'_, PyAny>>>,
        seed: Option<u64>,
        stop_after_s: Option<f64>,
    ) -> PyResult<Self> {
        let settings =
            settings.unwrap_or_default().into_iter().map(|(key, value)| Ok(format!("{key}={}", in_toml(&value)?)));
        let settings = settings.collect::<PyResult<_>>()?;
        let started = py.detach(|| start(config, settings, seed, stop_after_s));
        started.or_raise(py)
    }

    /// The next control step, or None after the last one. Raises `Error` if the run fails.
    fn step(&self, py: Python<'_>) -> PyResult<Option<RunStep>> {
        self.with(py, SteppedRun::step)?.map(|step| RunStep::new(py, step)).transpose()
    }

    /// Moves the desired pose of the hand by `hand_from_hand_shifted`: 4x4, in axes of the hand as the setup states it, translation in metres.
    /// It holds from the next step on, until it is moved again. Raises `Error` if the matrix is no pose.
    fn shift_hand(&self, py: Python<'_>, hand_from_hand_shifted: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let shifted = arrays::pose_of("hand_from_hand_shifted", &hand_from_hand_shifted).or_raise(py)?;
        self.with(py, |run| {
            run.set_motion(MotionRequest { hand_from_hand_shifted: shifted, ..run.motion() });
            Ok(())
        })
    }

    /// Sets the share of the commanded velocity that the arm with the cameras gets from the next step on: `speed_share`, 0 to 1. Raises `Error`
    /// for another number.
    fn set_speed_share(&self, py: Python<'_>, speed_share: f64) -> PyResult<()> {
        self.with(py, |run| {
            if !(0.0..=1.0).contains(&speed_share) {
                bail!("speed_share is {speed_share}: must be between 0 and 1");
            }
            run.set_motion(MotionRequest { speed_share, ..run.motion() });
            Ok(())
        })
    }

    /// Pushes the target to an offset from its start, along its axes there: `x_m`, `y_m`, `z_m` in metres (at most 0.12), and `turn_rad` about
    /// its z axis in radians (at most 0.35). It moves there within half a second; a larger offset is reduced to these limits. Raises
    /// `Error` for numbers that are not finite, and without the setting `experiment.target = "pushed"`.
    #[pyo3(signature = (x_m=0.0, y_m=0.0, z_m=0.0, turn_rad=0.0))]
    fn push_target(&self, py: Python<'_>, x_m: f64, y_m: f64, z_m: f64, turn_rad: f64) -> PyResult<()> {
        self.with(py, |run| {
            if ![x_m, y_m, z_m, turn_rad].iter().all(|value| value.is_finite()) {
                bail!("the offset ({x_m}, {y_m}, {z_m}) m, {turn_rad} rad is not finite: give numbers");
            }
            run.push_target(Vector3::new(x_m, y_m, z_m), turn_rad)
        })
    }

    /// Ends the run; further steps are None.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |run| run.end().map(|_| ()))
    }

    /// The method that estimates the pose and leads the hand, such as `direct`.
    #[getter]
    fn method(&self) -> &'static str {
        self.method
    }

    /// Simulated time between two steps, seconds.
    #[getter]
    fn control_period_s(&self) -> f64 {
        self.control_period_s
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<RunStep>> {
        self.step(py)
    }

    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) -> PyResult<()> {
        self.close(py)
    }
}

/// One setup or several.
#[derive(FromPyObject)]
enum Configs {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

/// A value as a text of TOML.
fn in_toml(value: &Bound<'_, PyAny>) -> PyResult<String> {
    match value.extract::<bool>() {
        Ok(value) => Ok(value.to_string()),
        Err(_) => Ok(value.str()?.to_string()),
    }
}

fn start(configs: Configs, set: Vec<String>, seed: Option<u64>, stop_after_s: Option<f64>) -> Result<Run> {
    if let Some(s) = stop_after_s.filter(|s| !(s.is_finite() && *s > 0.0)) {
        bail!("stop_after_s is {s}: must be a positive number of seconds");
    }
    let configs = match configs {
        Configs::One(config) => vec![config],
        Configs::Several(configs) if configs.is_empty() => bail!("config is empty: name a setup, such as \"sim\""),
        Configs::Several(configs) => configs,
    };
    let asked = SetupArgs { configs, set, ..SetupArgs::default() };
    // Before the pace is set, which real arms would refuse for a reason of its own.
    check_simulated(&read_layers(&asked)?)?;
    let asked = asked.with("Run", "run.pace", Some("fast".to_owned())).with(
        "seed",
        "run.seed",
        seed.map(|seed| seed.to_string()),
    );
    let setup = read_layers(&asked)?;
    let (method, control_period_s) = (setup.leader.name(), setup.control_period.as_secs_f64());
    let run = wire_stepped(setup, stop_after_s)?;
    Ok(Run { run: Mutex::new(run), method, control_period_s })
}
