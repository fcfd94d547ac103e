//! What the modules of the suite share. What the tests beside the code share too is kept with these; the suite does not use all of it.

pub(crate) mod cell;
pub(crate) mod played_bar;
pub(crate) mod process;
pub(crate) mod recordings;
pub(crate) mod service;
pub(crate) mod spoken;
pub(crate) mod virtual_bar;

#[allow(dead_code)]
#[path = "../../../crates/dbbd-model/src/test_support/cell.rs"]
mod simulated_cell;

#[allow(dead_code)]
#[path = "../../../crates/dbbd-model/src/test_support/checked_robot.rs"]
pub(crate) mod checked_robot;
#[allow(dead_code)]
#[path = "../../../crates/dbbd-model/src/test_support/circular_cases.rs"]
pub(crate) mod circular_cases;

#[allow(dead_code)]
#[path = "../../../crates/dbbd-job/src/test_support/circle_plan.rs"]
pub(crate) mod circle_plan;
#[allow(dead_code)]
#[path = "../../../crates/dbbd-job/src/test_support/drawn_robots.rs"]
pub(crate) mod drawn_robots;
#[allow(dead_code)]
#[path = "../../../crates/dbbd-job/src/test_support/makes.rs"]
pub(crate) mod makes;
#[allow(dead_code)]
#[path = "../../../crates/dbbd-job/src/test_support/production.rs"]
pub(crate) mod production;
#[allow(dead_code)]
#[path = "../../../crates/dbbd-job/src/test_support/short_capture.rs"]
pub(crate) mod short_capture;
#[allow(dead_code)]
#[path = "../../../crates/dbbd-job/src/test_support/sync_runs.rs"]
pub(crate) mod sync_runs;
