//! A cell to try things out, which this module cannot make itself.

use std::path::Path;

use crate::device::port::PortAddress;
use crate::diagnostic::Diagnostic;

/// Makes a cell that runs a plan, or one of its own.
pub type Bench = Box<dyn Fn(Option<&Path>) -> Result<Box<dyn Cell>, Diagnostic> + Send + Sync>;

/// A cell whose program begins when its bar is read; it ends when it is dropped.
pub trait Cell: Send {
    /// The port of its bar.
    fn port(&self) -> &PortAddress;
    /// The plan that it runs.
    fn plan(&self) -> &Path;
}
