//! `dbbd export` of a robot: `--for` and `--urdf-in`.

use std::path::Path;

use serde::Serialize;

use super::super::{CommandOutcome, CommandOutput, robots};
use super::ExportArgs;
use dbbd_job::artefact;
use dbbd_job::file_set::{EarlierFiles, FileSet};
use dbbd_job::files;
use dbbd_job::program::Language;
use dbbd_job::report::ReportFinding::{CoupledInUrdf, DoesNotHelp, LeftOut};
use dbbd_job::report::export::hand_back::{EnteredFiles, HandBack, HandBackTarget};
use dbbd_job::report::export::urdf::{CoupledJoint, coupled};
use dbbd_job::report::export::urdf_patch::{PatchedUrdf, patch};
use dbbd_job::robot_files::{ResultBeside, RobotName, result_beside, standing_of};
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::SimplifiedModelError;
use dbbd_model::robot::{LoadedRobot, Robot};

/// The programs and controllers by their names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum TargetName {
    /// robot-identified.urdf, and of a Universal Robots arm robot_calibration.yaml (kinematics of ur_description).
    Ros,
    /// robot-identified.urdf: m, rad; a joint variable is the controller's axis angle.
    Urdf,
    /// As urdf.
    Mujoco,
    /// As urdf.
    Drake,
    /// mastering.csv, values for $machine.dat as a proposal, DBB_RESULT.dat (tool ball, base balls and offsets in KRL).
    Kuka,
    /// mastering.csv: the zero error of each axis, degrees.
    Fanuc,
    /// As fanuc.
    Abb,
    /// As fanuc.
    Yaskawa,
    /// As fanuc.
    Staubli,
    /// robodk.csv: the table in modified DH.
    Robodk,
}

impl TargetName {
    fn target(self) -> HandBackTarget {
        match self {
            Self::Ros => HandBackTarget::Ros,
            Self::Urdf | Self::Mujoco | Self::Drake => HandBackTarget::Urdf,
            Self::Kuka => HandBackTarget::Kuka,
            Self::Fanuc => HandBackTarget::ZerosOnly(Some(Language::Fanuc)),
            Self::Abb => HandBackTarget::ZerosOnly(Some(Language::Rapid)),
            Self::Yaskawa | Self::Staubli => HandBackTarget::ZerosOnly(None),
            Self::Robodk => HandBackTarget::RoboDk,
        }
    }
}

#[derive(Serialize)]
struct HandBackDocument<'a> {
    files: Vec<String>,
    steps: &'a [EnteredFiles],
    left_out: Option<SimplifiedModelError>,
}

/// The robot that is named.
pub(super) fn robot_name(args: &ExportArgs) -> RobotName {
    args.run.display().to_string().into()
}

pub(super) fn hand_back(
    args: &ExportArgs,
    target: TargetName,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let name = robot_name(args);
    let file = Path::new(&*name);
    let LoadedRobot { robot, source, .. } = robots::read_named_robot(&name, out)?;
    let standing = standing_of(file, &robot)?;
    out.findings_in(file.display(), standing.and_then(|standing| standing.finding(&robot.name)));
    let result = match result_beside(file, &robot)? {
        (_, ResultBeside::Own(result)) => Some(result),
        (_, ResultBeside::Another | ResultBeside::Nothing) => None,
    };
    let provenance = artefact::made_from([&source]);
    let HandBack { files, steps, left_out } =
        HandBack::of(target.target(), &robot, result.as_deref(), &provenance)
            .map_err(|refused| refused.in_file(file.display()))?;
    let mut set = FileSet::begin(&args.out, EarlierFiles::refused_unless(args.replace))?;
    for (name, content) in files {
        set.write(name, content)?;
    }
    let files = set.finish()?;
    for name in &files {
        out.result(format!("{}: written", args.out.join(name).display()));
    }
    match target.target() {
        HandBackTarget::Urdf | HandBackTarget::Ros => report_coupled(&robot, out),
        HandBackTarget::Kuka | HandBackTarget::ZerosOnly(_) | HandBackTarget::RoboDk => {}
    }
    for step in &steps {
        let EnteredFiles { before_mm, after_mm, .. } = *step;
        let files = step.files.join(" and ");
        if step.helps() {
            out.result(format!(
                "{files} entered: mean error of the tool ball over the workspace {before_mm:.3} -> {after_mm:.3} mm"
            ));
        } else {
            out.finding(DoesNotHelp { files, before_mm, after_mm });
        }
    }
    report_left_out(left_out, out);
    out.document(&HandBackDocument { files, steps: &steps, left_out })?;
    Ok(CommandOutcome::Done)
}

#[derive(Serialize)]
struct UrdfDocument<'a> {
    file: String,
    #[serde(flatten)]
    patched: &'a PatchedUrdf,
    left_out: Option<SimplifiedModelError>,
}

pub(super) fn patch_urdf(
    args: &ExportArgs,
    urdf: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let robot = robots::named(&robot_name(args), out)?;
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
fn report_coupled(robot: &Robot, out: &CommandOutput) {
    out.findings(coupled(robot).map(|CoupledJoint { number: joint, sum }| CoupledInUrdf { joint, sum }));
}

/// Reports what the written files leave out of a robot.
fn report_left_out(left_out: Option<SimplifiedModelError>, out: &CommandOutput) {
    out.findings(left_out.map(|SimplifiedModelError { mean_mm, max_mm }| LeftOut { mean_mm, max_mm }));
}
