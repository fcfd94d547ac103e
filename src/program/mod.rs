//! Programs for robot controllers: emitted from a plan, parsed, rewritten.
//!
//! What a program does is here; how a controller's language writes it is in the language's module.

pub mod compensate;
mod emission;
mod header;
pub mod krl;
mod language;
pub mod listing;
pub mod rapid;
mod rewrite;
mod script;
pub mod sequence;
mod target;
mod text;
pub mod urscript;

pub use crate::plan::Motion;
pub use emission::{Sync, Written};
pub use header::{provenance, stamped};
pub use language::Language;
pub use listing::{Equipped, Listing, Program, Setup};
pub use rewrite::Moved;
pub use target::{Frames, Target};
pub use text::{Span, Text};
