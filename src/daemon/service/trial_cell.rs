//! A cell to try things out, which this module cannot make itself.

use std::path::Path;

use crate::diagnostic::Diagnostic;

/// The name of its port.
pub(super) const PORT: &str = "sim";

/// Makes a cell that runs a plan, or one of its own.
pub type Bench = Box<dyn Fn(Option<&Path>) -> Result<Box<dyn Cell>, Diagnostic> + Send + Sync>;

/// A cell whose program begins when its bar is read; it ends when it is dropped.
pub trait Cell: Send {
    /// The port of its bar.
    fn port(&self) -> &str;
    /// The plan that it runs.
    fn plan(&self) -> &Path;
}
