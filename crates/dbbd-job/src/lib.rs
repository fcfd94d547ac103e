//! What a calibration job needs: the plan, the programs of the robot, the recorded run, the report, the simulated cell, and
//! the files in which all of it is kept.
//!
//! This crate must not know an option of the command line, and listens on no socket but those of the simulated cell.
//! The rooms are listed in the order of the data flow; a room uses only rooms above it.
// A test names what it looks for.
#![cfg_attr(test, allow(clippy::wildcard_enum_match_arm))]

// The blank lines keep rustfmt from sorting the rooms.
pub mod files;

pub mod file_set;

pub mod child_process;

pub mod artefact;

pub mod page;

pub mod robot_files;

pub mod robot_description;

pub mod plan;

pub mod program;

pub mod recording;

pub mod report;

pub mod request;

pub mod sim;

// Tests name this crate as its users do.
#[cfg(test)]
extern crate self as dbbd_job;
#[cfg(test)]
#[allow(dead_code, reason = "the suite uses the rest")]
mod test_support;
