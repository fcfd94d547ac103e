//! Calibrates an industrial robot with a telescoping double ball-bar.
//!
//! The modules are listed in the order of the data flow. A module imports only modules above it: ARCHITECTURE.md has the
//! table, and `tests/suite/floor_plan.rs` checks it.

// The blank lines keep rustfmt from sorting the modules.
pub mod diagnostic;

pub mod catalogue;

pub mod base;

pub mod math;

pub mod provenance;

pub mod robot;

pub mod measurement;

pub mod device;

pub mod estimation;

pub mod design;

pub mod plan;

pub mod program;

pub mod circular;

pub mod conformity;

pub mod recording;

pub mod report;

pub mod live;

#[cfg(feature = "archive")]
pub mod archive;

pub mod sim;

pub mod daemon;

pub mod cli;
