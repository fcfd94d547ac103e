//! The mathematics of a ball-bar calibration: from lengths of a bar at poses of a robot to the robot's kinematic parameters,
//! their uncertainty, the poses to measure next, and the decision whether a robot is still what it was.
//!
//! This crate must not know a path, a clock, a port, a page or an option of the command line: it takes values and texts, and
//! returns values and texts. The rooms are listed in the order of the data flow; a room uses only rooms above it.
// A test names what it looks for.
#![cfg_attr(test, allow(clippy::wildcard_enum_match_arm))]

// The blank lines keep rustfmt from sorting the rooms.
pub mod diagnostic;

pub mod base;

pub mod plausibility;

pub mod math;

pub mod provenance;

pub mod robot;

pub mod measurement;

pub mod estimation;

pub mod design;

pub mod circular;

pub mod conformity;

// Tests name this crate as its users do.
#[cfg(test)]
extern crate self as dbbd_model;
#[cfg(test)]
#[allow(dead_code, reason = "crates above use the rest")]
mod test_support;
