//! Findings of the library as Python's exception and as Python's values.

use dbbd_model::diagnostic::{Diagnostic, Finding};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;
use serde::Serialize;

/// What failed; it becomes `dbbd.DbbdError`, or the error of an argument's type or shape.
pub(crate) enum Failure {
    Finding(Box<Diagnostic>),
    Python(PyErr),
}

pub(crate) type Outcome<T> = Result<T, Failure>;

impl From<Diagnostic> for Failure {
    fn from(finding: Diagnostic) -> Self {
        Self::Finding(Box::new(finding))
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

/// A finding about no file.
pub(crate) fn failed(finding: impl Finding) -> Failure {
    Diagnostic::new(finding).into()
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        static CLASS: PyOnceLock<Py<PyType>> = PyOnceLock::new();
        let finding = match failure {
            Failure::Finding(finding) => finding,
            Failure::Python(error) => return error,
        };
        Python::attach(|py| match CLASS.import(py, "dbbd._error", "DbbdError") {
            Ok(class) => PyErr::from_type(class.clone(), (finding.code().as_str(), finding.to_string())),
            Err(error) => error,
        })
    }
}

/// A warning as a `dbbd.DbbdWarning`.
///
/// # Errors
/// Warnings are errors to the caller.
pub(crate) fn warn(py: Python<'_>, finding: &Diagnostic) -> PyResult<()> {
    let class = py.import("dbbd._error")?.getattr("DbbdWarning")?;
    let warning = class.call1((finding.code().as_str(), finding.to_string()))?;
    py.import("warnings")?.call_method1("warn", (warning,))?;
    Ok(())
}

/// A value as Python's dictionaries, lists and numbers, which are the bits of ours.
pub(crate) fn to_python(py: Python<'_>, value: &impl Serialize) -> PyResult<Py<PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
    Ok(py.import("json")?.call_method1("loads", (text,))?.unbind())
}
