//! A cell to try things out, which this module cannot make itself.

use std::path::Path;

use crate::device::port::PortAddress;
use crate::diagnostic::Diagnostic;

/// What the program of a cell does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    /// It goes on from its HALT once the bar is read.
    Runs,
    /// It waits at its HALT, where the bar is mounted.
    Waits,
}

/// Makes a cell that runs a plan, or one of its own.
pub type Bench = Box<dyn Fn(Option<&Path>, Program) -> Result<Box<dyn Cell>, Diagnostic> + Send + Sync>;

/// A cell whose program begins when its bar is read; it ends when it is dropped.
pub trait Cell: Send {
    /// The port of its bar.
    fn port(&self) -> &PortAddress;
    /// The plan that it runs.
    fn plan(&self) -> &Path;
}
