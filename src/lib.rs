//! Calibrates an industrial robot with a telescoping double ball-bar.
//!
//! The modules stand in the order in which data flows; a room imports only rooms above it
//! (ARCHITECTURE.md has the table, `tests/suite/floor_plan.rs` holds the code to it).

// Words everyone uses.
pub mod clock;
pub mod diag;
pub mod files;
pub mod linalg;
pub mod sample;
pub mod table;
pub mod units;

// Bytes.
pub mod capture;
pub mod port;

// Meaning.
pub mod identifiability;
pub mod model;
pub mod protocol;

// Acting.
pub mod krl;
pub mod plan;

// Joining.
pub mod import;
pub mod sync;

// Judging.
pub mod circular;
pub mod identify;

// Joining a whole capture.
pub mod run;

// Telling.
pub mod export;
pub mod live;
pub mod report;

// Standing in, and wiring.
pub mod cli;
pub mod daemon;
pub mod sim;
