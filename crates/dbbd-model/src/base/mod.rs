//! What every room may use: units, dates, hashes, and texts with their tables. Nothing about robots or bars, and no file.

mod catalogue;
mod cells;
pub mod date;
mod exact;
pub mod hash;
pub mod parse;
pub mod serialised;
pub mod table;
pub mod text;
pub mod units;

pub use catalogue::{FileFinding, InternalFinding};
