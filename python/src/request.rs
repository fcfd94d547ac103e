//! `request`: one request, one answer, as every other caller asks it.

use dbbd_job::request::Request;
use pyo3::prelude::*;
use pyo3::types::PyString;

use crate::error::{Failure, Outcome};

/// Where the request is, as a message names it.
const ARGUMENT: &str = "request";

/// Answers a request of any kind, given as a dictionary or as JSON: `identify`, `plan`, `check`, `compensate`, `circle` or
/// `certificate`. Reads its files, computes, and writes the files of the result to its directory `out`. Relative paths start at
/// the directory of the process.
///
/// The answer has `findings`, and either `result` (outcome, names of the files, document) or `refusal`.
#[pyfunction]
pub(crate) fn request<'py>(py: Python<'py>, request: &Bound<'py, PyAny>) -> Outcome<Bound<'py, PyAny>> {
    let answer = request_json(py, request)?;
    Ok(py.import("json")?.call_method1("loads", (answer,))?)
}

/// As `request`, with the answer as the text that `dbbd request` prints.
#[pyfunction]
pub(crate) fn request_json<'py>(py: Python<'py>, request: &Bound<'py, PyAny>) -> Outcome<String> {
    let text = match request.cast::<PyString>() {
        Ok(text) => text.to_string(),
        Err(_) => py.import("json")?.call_method1("dumps", (request,))?.extract()?,
    };
    let request = Request::from_json(ARGUMENT, &text)?;
    py.detach(|| request.answer(&()).to_json()).map_err(Failure::from)
}
