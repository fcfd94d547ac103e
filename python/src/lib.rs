//! The Python package: a shell over the public functions of the library. It holds no arithmetic of its own.

mod arrays;
mod capture;
mod check;
#[cfg(feature = "command-line")]
mod command_line;
mod error;
mod identify;
mod lengths;
mod plan;
mod request;
mod robot;
mod simulate;

use pyo3::prelude::*;

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
    module.add_function(wrap_pyfunction!(request::request, module)?)?;
    module.add_function(wrap_pyfunction!(request::request_json, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)?;
    #[cfg(feature = "command-line")]
    module.add_function(wrap_pyfunction!(command_line::_main, module)?)?;
    Ok(())
}
