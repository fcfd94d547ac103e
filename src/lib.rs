//! Calibrates an industrial robot with a telescoping double ball-bar.
//!
//! This crate is the program: the command line, the service and the recorder's threads, on the crates `dbbd-model` (mathematics),
//! `dbbd-device` (the bar), `dbbd-job` (plan, programs, runs, reports) and `dbbd-plant` (archive). ARCHITECTURE.md has the
//! rooms of all crates, and `tests/suite/floor_plan.rs` checks what the compiler does not.
// A test names what it looks for.
#![cfg_attr(test, allow(clippy::wildcard_enum_match_arm))]

// The blank lines keep rustfmt from sorting the rooms.
pub mod catalogue;

pub mod live;

pub mod daemon;

pub mod cli;
