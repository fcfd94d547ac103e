//! What every module may use: units, the clock, files, tables. Nothing about robots or bars.

mod cells;
pub mod clock;
pub mod date;
mod exact;
mod file_set;
pub mod files;
pub mod hash;
pub mod parse;
pub mod program;
pub mod serialised;
pub mod sync;
pub mod table;
pub mod text;
pub mod units;

pub use file_set::FileSet;
