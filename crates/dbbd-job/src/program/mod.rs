//! Programs for robot controllers: emitted from a plan, parsed, corrected.
//!
//! The meaning of a program is defined here, independent of the language; the module of a language defines how it is
//! written.

mod compensation_catalogue;
pub use compensation_catalogue::CompensationFinding;

mod catalogue;
pub use catalogue::ProgramFinding;

pub mod compensate;
mod emission;
pub mod fanuc;
mod flow;
mod header;
pub mod krl;
mod language;
mod left_motions;
mod lexer;
pub mod listing;
mod mounted;
pub mod rapid;
mod script;
pub mod sequence;
mod target;
mod text;
mod tokens;
pub mod urscript;

pub use crate::plan::MotionKind;
pub use compensate::{Correction, Moved};
pub use emission::{Sync, Written};
pub use header::{check_one_plan, provenance, stamped};
pub use language::Language;
pub use listing::{Listing, Program};
pub use mounted::MountedBalls;
pub use target::{Frames, Setup, Target};
pub use text::{Span, Text};

#[cfg(test)]
mod tests;
