//! Traces that other software recorded, as samples: text, one reading a line, laid out as a small file describes.

mod date;
mod mapping;
mod trace;

pub use mapping::Mapping;
pub use trace::{Bar, Counts, Read, Trace};
