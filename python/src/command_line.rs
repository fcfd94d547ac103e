//! `python -m dbbd`: the command line of the program.

use std::ffi::OsString;
use std::process::ExitCode;

use pyo3::prelude::*;

/// Runs the command line; children are started by `launcher`.
#[pyfunction]
pub(crate) fn _main(py: Python<'_>, arguments: Vec<OsString>, launcher: Vec<OsString>) -> u8 {
    dbbd_job::child_process::launch_by(launcher);
    let code = py.detach(|| dbbd::cli::main_with(arguments));
    // An exit code does not give its number; the program has these.
    (0..=u8::MAX).find(|number| ExitCode::from(*number) == code).unwrap_or(1)
}
