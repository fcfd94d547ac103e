//! The runs of many cells: an archive in a database and an object store, the pages that show it, and what its runs show
//! together.
//!
//! This crate must not know how a run is recorded, nor an option of the command line. Without the feature `archive` it has
//! the sentences of its findings alone, so that a program without databases can explain them.
// A test names what it looks for.
#![cfg_attr(test, allow(clippy::wildcard_enum_match_arm))]

#[cfg(feature = "archive")]
mod archive;
mod catalogue;
#[cfg(all(test, feature = "archive"))]
#[allow(dead_code, clippy::unwrap_used, reason = "the crates below use the rest; a test may fail")]
#[path = "../../dbbd-model/src/test_support/cell.rs"]
mod cell;
#[cfg(feature = "archive")]
pub mod fleet;

#[cfg(feature = "archive")]
pub use archive::*;
pub use catalogue::{ArchiveFinding, FleetFinding};
