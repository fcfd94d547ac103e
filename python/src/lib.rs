//! The Python package: a shell over the public functions of the library. It holds no arithmetic of its own.

mod arrays;
mod capture;
mod check;
mod error;
mod identify;
mod lengths;
mod plan;
mod robot;
mod simulate;

use std::ffi::OsString;
use std::process::ExitCode;

use pyo3::prelude::*;

/// Runs the command line; children are started by `launcher`.
#[pyfunction]
fn _main(py: Python<'_>, arguments: Vec<OsString>, launcher: Vec<OsString>) -> u8 {
    dbbd_job::child_process::launch_by(launcher);
    let code = py.detach(|| dbbd::cli::main_with(arguments));
    // An exit code does not give its number; the program has these.
    (0..=u8::MAX).find(|number| ExitCode::from(*number) == code).unwrap_or(1)
}

#[pymodule]
fn _dbbd(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<robot::PyRobot>()?;
    module.add_class::<capture::PyCapture>()?;
    module.add_class::<identify::PyResult_>()?;
    module.add_class::<plan::PyPlan>()?;
    module.add_class::<check::PyCheck>()?;
    module.add_function(wrap_pyfunction!(identify::identify, module)?)?;
    module.add_function(wrap_pyfunction!(plan::plan, module)?)?;
    module.add_function(wrap_pyfunction!(check::check, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(_main, module)?)
}
