//! The Python package `pb3dp`: stereo rigs, regions, estimators, trackers, recordings and simulated runs as objects of Python, with arrays of
//! numpy.
//!
//! This crate only translates: all work is done by the crates that the program uses, so both give the same bits. Lengths are metres, angles
//! radians, times seconds, frames those of docs/frames.md. Calls that compute release the lock of the interpreter. No real arm and no real
//! camera can be reached.

pub(crate) mod arrays;
pub(crate) mod errors;
pub(crate) mod estimate;
pub(crate) mod estimator;
pub(crate) mod images;
pub(crate) mod named_tuples;
pub(crate) mod recorded_run;
pub(crate) mod recording;
pub(crate) mod region;
pub(crate) mod rig;
pub(crate) mod run;
pub(crate) mod run_step;
pub(crate) mod settings;
pub(crate) mod track;
pub(crate) mod tracker;
pub(crate) mod wording;

/// The compiled part of the package; `pb3dp/__init__.py` exports it.
#[pyo3::pymodule]
mod _pb3dp {
    use pb3dp_wiring::message_codes::{option_of, spell_arguments};
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::errors::Error;
    #[pymodule_export]
    use super::estimate::Estimate;
    #[pymodule_export]
    use super::estimator::Estimator;
    #[pymodule_export]
    use super::images::read_image;
    #[pymodule_export]
    use super::recorded_run::RecordedRun;
    #[pymodule_export]
    use super::recording::{Pair, Recording};
    #[pymodule_export]
    use super::region::Region;
    #[pymodule_export]
    use super::rig::StereoRig;
    #[pymodule_export]
    use super::run::Run;
    #[pymodule_export]
    use super::run_step::{RunPair, RunStep};
    #[pymodule_export]
    use super::track::TrackEstimate;
    #[pymodule_export]
    use super::tracker::Tracker;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        spell_arguments(option_of);
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        // An error without a code has `None`.
        module.getattr("Error")?.setattr("code", module.py().None())
    }
}
