//! `dbbd export --urdf-in`: a user's URDF with the identified joints.

use std::path::Path;

use serde::Serialize;

use super::super::{Outcome, Output, robots};
use super::Args;
use crate::base::files;
use crate::catalogue::FileFinding;
use crate::catalogue::ReportFinding::{CoupledInUrdf, NotInUrdf};
use crate::diagnostic::Diagnostic;
use crate::estimation::Workspace;
use crate::report::export::urdf::{CoupledJoint, coupled};
use crate::report::export::urdf_patch::{LeftOut, PatchedUrdf, patch};
use crate::robot::Robot;

/// Poses of the workspace over which the left-out part is stated, and their seed.
const WORKSPACE_POSES: usize = 2000;
const SEED: u64 = 1;

#[derive(Serialize)]
struct Document<'a> {
    file: String,
    #[serde(flatten)]
    patched: &'a PatchedUrdf,
    left_out: Option<LeftOut>,
}

pub(super) fn run(args: &Args, users: &Path, out: &Output) -> Result<Outcome, Diagnostic> {
    let robot = robots::named(&args.run.to_string_lossy(), out)?;
    let to = args.out.join(users.file_name().unwrap_or_default());
    if files::same_place(&to, users) {
        return Err(Diagnostic::file(&to.display().to_string(), FileFinding::IsRead));
    }
    let patched = patch(&users.display().to_string(), &files::read(users)?, &robot, &args.joints)?;
    files::write(&to, &patched.text)?;
    for joint in &patched.joints {
        out.result(format!(
            "{}: origin moved by {:.3} mm, turned by {:.4} deg (its axis was {:.3} mm and {:.4} deg from the nominal robot's)",
            joint.name, joint.moved_mm, joint.turned_deg, joint.from_nominal_mm, joint.from_nominal_deg
        ));
    }
    out.result(format!("{}: written", to.display()));
    said_of_coupled(&robot, out);
    let left_out =
        LeftOut::of(&robot.geometry, &Workspace::uniform(robot.controller(), WORKSPACE_POSES, SEED));
    if let Some(LeftOut { mean_mm, max_mm }) = left_out {
        out.finding(NotInUrdf { mean_mm, max_mm });
    }
    out.document(&Document { file: to.display().to_string(), patched: &patched, left_out })?;
    Ok(Outcome::Done)
}

/// Says which variables of a URDF are sums of axis angles.
fn said_of_coupled(robot: &Robot, out: &Output) {
    for CoupledJoint { number: joint, sum } in coupled(robot) {
        out.finding(CoupledInUrdf { joint, sum });
    }
}
