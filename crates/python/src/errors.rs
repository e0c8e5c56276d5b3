//! Errors of the library as exceptions of Python.

use pb3dp_wiring::message_codes::{code_of, error_text};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

use crate::wording::in_python;

pyo3::create_exception!(
    pb3dp,
    Error,
    PyException,
    "An input that cannot be used, or a failure.\n\nThe text is that of the program, with the arguments of this package in the place of options: the thing, its value, the remedy. `code` is the\ncode of the message, such as `PB3DP-EST-002`, or None; `pb3dp explain CODE` prints cause and remedy."
);

/// Errors become exceptions with the code that the program prints and with its text, in which arguments of Python replace options.
pub trait OrRaise<T> {
    /// The value, or the exception.
    ///
    /// # Errors
    /// [`Error`].
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T, E: Into<anyhow::Error>> OrRaise<T> for Result<T, E> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|error| exception(py, &error.into()))
    }
}

fn exception(py: Python<'_>, error: &anyhow::Error) -> PyErr {
    let raised = Error::new_err(in_python(&error_text(error)));
    let code = code_of(error).map(|known| known.code);
    match raised.value(py).setattr("code", code) {
        Ok(()) => raised,
        Err(other) => other,
    }
}

/// The type of a value, for messages: `a tuple`, `an int`, `None`.
pub fn of_type(given: &Bound<'_, PyAny>) -> String {
    if given.is_none() {
        return "None".to_owned();
    }
    let name = given.get_type().name().map_or_else(|_| "thing".to_owned(), |name| name.to_string());
    let article = if name.starts_with(|c: char| "aeiouAEIOU".contains(c)) { "an" } else { "a" };
    format!("{article} {name}")
}
