//! Tools for every room: units, dates, hashes, and texts with their tables. Nothing about robots or bars, and no file.

mod catalogue;
pub mod date;
pub mod expansion;
pub mod fixed_array;
pub mod hash;
pub mod number;
pub mod parse;
pub mod serialised;
pub mod table;
pub mod text;
pub mod units;

pub use catalogue::{FileFinding, InternalFinding};
