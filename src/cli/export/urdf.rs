//! `dbbd export --urdf-in`.

use std::path::Path;

use serde::Serialize;

use super::super::{CommandOutcome, CommandOutput, robots};
use super::ExportArgs;
use super::hand_back::robot_file;
use dbbd_job::file_set::EarlierFiles;
use dbbd_job::files;
use dbbd_job::report::ReportFinding::{CoupledInUrdf, LeftOut};
use dbbd_job::report::export::urdf::{CoupledJoint, coupled};
use dbbd_job::report::export::urdf_patch::{PatchedUrdf, patch};
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::SimplifiedModelError;
use dbbd_model::robot::Robot;

#[derive(Serialize)]
struct UrdfDocument<'a> {
    file: String,
    #[serde(flatten)]
    patched: &'a PatchedUrdf,
    left_out: Option<SimplifiedModelError>,
}

pub(super) fn run(args: &ExportArgs, urdf: &Path, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let robot = robots::named(&robot_file(args).to_string_lossy(), out)?;
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
    report_coupled(&robot, out);
    let left_out = SimplifiedModelError::of(&robot);
    report_left_out(left_out, out);
    out.document(&UrdfDocument { file: to.display().to_string(), patched: &patched, left_out })?;
    Ok(CommandOutcome::Done)
}

/// Reports joints of a URDF that turn with two axes.
pub(super) fn report_coupled(robot: &Robot, out: &CommandOutput) {
    out.findings(coupled(robot).map(|CoupledJoint { number: joint, sum }| CoupledInUrdf { joint, sum }));
}

/// Reports what the written files leave out of a robot.
pub(super) fn report_left_out(left_out: Option<SimplifiedModelError>, out: &CommandOutput) {
    out.findings(left_out.map(|SimplifiedModelError { mean_mm, max_mm }| LeftOut { mean_mm, max_mm }));
}
