//! Results with several arrays: the named tuples of `pb3dp/_named_tuples.py`.

use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// A named tuple with these fields.
///
/// # Errors
/// If the package has no such type.
pub fn named_tuple<'py>(
    py: Python<'py>,
    name: &str,
    fields: impl IntoPyObject<'py, Target = PyTuple, Output = Bound<'py, PyTuple>, Error = PyErr>,
) -> PyResult<Bound<'py, PyAny>> {
    py.import("pb3dp._named_tuples")?.getattr(name)?.call1(fields.into_pyobject(py)?)
}
