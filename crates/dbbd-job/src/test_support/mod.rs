//! What the tests of this crate share. The suite includes these files, so that there is one of each.

#[path = "../../../dbbd-model/src/test_support/cell.rs"]
pub(crate) mod cell;
pub(crate) mod circle_plan;
pub(crate) mod drawn_robots;
pub(crate) mod krl;
pub(crate) mod makes;
pub(crate) mod production;
pub(crate) mod short_capture;
pub(crate) mod sync_runs;
