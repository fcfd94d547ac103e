//! `plan.html` from a plan.

use crate::diagnostic::Diagnostic;
use crate::estimation::result::MapPoint;
use crate::plan::Plan;
use crate::report::{self, Provenance, Source};
use crate::robot::Robot;

/// The page of a plan made for `robot` from the job file `job`.
pub(super) fn html(plan: &Plan, robot: &Robot, job: &str, map: &[MapPoint]) -> Result<String, Diagnostic> {
    let provenance = Provenance {
        robot: Some(robot.name.clone()),
        plan_hash: Some(plan.header.hash.clone()),
        sources: vec![Source { role: "job", name: job.into() }],
    };
    report::plan::html(plan, robot, map, &provenance)
}
