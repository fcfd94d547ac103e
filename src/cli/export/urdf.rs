//! `dbbd export --urdf-in`.

use std::path::Path;

use serde::Serialize;

use super::super::{CommandOutcome, CommandOutput, robots};
use super::ExportArgs;
use dbbd_job::file_set::EarlierFiles;
use dbbd_job::files;
use dbbd_job::report::ReportFinding::{CoupledInUrdf, NotInUrdf};
use dbbd_job::report::export::urdf::{CoupledJoint, coupled};
use dbbd_job::report::export::urdf_patch::{LeftOut, PatchedUrdf, patch};
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::Workspace;

/// The number of poses over which the error of a URDF without the joint errors is taken.
const WORKSPACE_POSES: usize = 2000;
/// The seed of these poses.
const URDF_POSES_SEED: u64 = 1;

#[derive(Serialize)]
struct UrdfDocument<'a> {
    file: String,
    #[serde(flatten)]
    patched: &'a PatchedUrdf,
    left_out: Option<LeftOut>,
}

pub(super) fn run(args: &ExportArgs, urdf: &Path, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let robot = robots::named(&args.run.to_string_lossy(), out)?;
    let to = args.out.join(urdf.file_name().unwrap_or_default());
    if files::same_place(&to, urdf) {
        return Err(Diagnostic::file(to.display(), FileFinding::IsRead));
    }
    EarlierFiles::refused_unless(args.replace).check(&to)?;
    let patched = patch(&urdf.display().to_string(), &files::read_text(urdf)?, &robot, &args.joints)?;
    files::write_file(&to, &patched.text)?;
    for joint in &patched.joints {
        out.result(format!(
            "{}: origin moved by {:.3} mm, turned by {:.4} deg (its axis was {:.3} mm and {:.4} deg from the nominal robot's)",
            joint.name, joint.moved_mm, joint.turned_deg, joint.from_nominal_mm, joint.from_nominal_deg
        ));
    }
    out.result(format!("{}: written", to.display()));
    out.findings(coupled(&robot).map(|CoupledJoint { number: joint, sum }| CoupledInUrdf { joint, sum }));
    let workspace = Workspace::uniform(robot.controller(), WORKSPACE_POSES, URDF_POSES_SEED);
    let left_out = LeftOut::of(&robot.geometry, &workspace);
    out.findings(left_out.as_ref().map(|&LeftOut { mean_mm, max_mm }| NotInUrdf { mean_mm, max_mm }));
    out.document(&UrdfDocument { file: to.display().to_string(), patched: &patched, left_out })?;
    Ok(CommandOutcome::Done)
}
