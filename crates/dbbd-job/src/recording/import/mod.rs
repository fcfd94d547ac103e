//! Traces recorded by other software, imported as samples: text with one reading per line.

mod catalogue;
pub use catalogue::ImportFinding;

mod date;
mod mapping;
mod trace;

pub use mapping::TraceMapping;
pub use trace::{TraceBar, TraceCounts, TraceReader, TraceRow};
