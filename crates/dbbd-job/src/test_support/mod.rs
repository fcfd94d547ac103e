//! Code shared by the tests of this crate. The suite includes these files, so that each exists only once.

#[path = "../../../dbbd-model/src/test_support/cell.rs"]
pub(crate) mod cell;
pub(crate) mod circle_plan;
pub(crate) mod drawn_robots;
pub(crate) mod krl;
pub(crate) mod makes;
pub(crate) mod production;
pub(crate) mod short_capture;
pub(crate) mod sync_runs;
