//! Traces recorded by other software, imported as samples: text with one reading per line.

mod catalogue;
pub use catalogue::ImportFinding;

mod date;
mod format;
mod mapping;
mod trace;

pub use format::TraceFormat;
pub use mapping::TraceMapping;
pub use trace::{TraceBar, TraceCounts, TraceReader, TraceRow};
