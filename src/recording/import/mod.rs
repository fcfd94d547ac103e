//! Traces recorded by other software, imported as samples: text with one reading per line.

mod date;
mod mapping;
mod trace;

pub use mapping::Mapping;
pub use trace::{Bar, Counts, Read, Trace};
