//! `dbbd robots`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::catalogue::CliFinding;
use super::{CommandOutcome, CommandOutput, value};
use dbbd_job::file_set::EarlierFiles;
use dbbd_job::files;
use dbbd_job::request;
use dbbd_job::robot_description::{
    self, CHECKED_POSES, Coupled, DescriptionFinding, DescriptionKind, FactoryTable, ImportedRobot,
    KnownOfRobot, PendantPose,
};
use dbbd_job::robot_files::RobotName;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Tolerance;
use dbbd_model::robot::{CouplingTable, JointTable};
use dbbd_model::robot::{LoadedRobot, Maker, Robot};

/// List, show or check robots.
///
/// A robot is a TOML file with its modified-DH table, axis limits, speeds and tolerance. The built-in ones are in `robots/` of
/// the source.
#[derive(clap::Args)]
pub(crate) struct RobotsArgs {
    #[command(subcommand)]
    what: Option<RobotsVerb>,
}

#[derive(clap::Subcommand)]
enum RobotsVerb {
    /// List the built-in robots (the default).
    List,
    /// Show a robot's table, limits and speeds: mm, degrees, degrees/s.
    Show {
        /// Built-in name, robot file, or directory of a result.
        #[arg(value_name = "NAME|FILE|DIR")]
        name: RobotName,
    },
    /// Make a robot file from a built-in robot, a URDF, KUKA's `$machine.dat`, or the factory calibration of a controller.
    ///
    /// The file of a built-in robot is written as it is, for example to state the tool ball of your own robot in it.
    /// A URDF is read as a chain of six rotary joints. The factory calibration of a Universal Robots controller is its file
    /// calibration.conf, the YAML that the ROS driver extracts, or what the controller itself sends; the robot file then has
    /// `[controller] model = "calibrated"`, and plans and corrections are computed with this table. Limits, speeds and
    /// masses are from --robot for a factory calibration, else from the URDF; tool ball, tolerance and repeatability are to be added by hand.
    Import {
        /// A built-in name, the file, or ur://HOST[:30001].
        #[arg(value_name = "NAME|FILE|URL")]
        from: String,
        /// The type of a calibrated robot: a built-in name or a robot file.
        #[arg(long, value_name = "NAME|FILE|DIR")]
        robot: Option<RobotName>,
        /// The six joints of a URDF that has several chains, base to flange, with commas.
        #[arg(long, value_name = "NAMES", value_delimiter = ',')]
        joints: Vec<String>,
        /// The maker of the arm of a URDF: in what its controller differs from a description [default: by the name of the robot or its
        /// files].
        #[arg(long, value_name = "MAKER", value_parser = value::one_of(&Maker::ALL, Maker::name))]
        maker: Option<Maker>,
        /// Whether the controller shows axis 3 against the horizontal, as FANUC does and arms with a parallelogram may [default: by the
        /// maker].
        #[arg(long, value_name = "yes|no", value_parser = value::one_of(&Coupled::ALL, Coupled::name))]
        coupled: Option<Coupled>,
        /// One pose of the flange as the pendant shows it with a null tool and a null base: degrees and mm, with or without KUKA's A, B, C.
        /// It decides how axis 3 is shown, and proves the rest.
        #[arg(long, value_name = "A1,..,A6=X,Y,Z[,A,B,C]", value_parser = value::pendant_pose, allow_hyphen_values = true)]
        at: Option<PendantPose>,
        /// The robot file to write.
        #[arg(long, value_name = "ROBOT.toml")]
        out: PathBuf,
        /// Replace the file if it exists [default: refuse].
        #[arg(long)]
        replace: bool,
    },
    /// Check a robot file, and report a mistake with its line.
    Check {
        /// Built-in name, robot file, or directory of a result.
        #[arg(value_name = "NAME|FILE|DIR")]
        name: RobotName,
    },
}

/// Reads a robot, and reports the warnings of its identification.
pub(crate) fn read_named_robot(name: &RobotName, out: &CommandOutput) -> Result<LoadedRobot, Diagnostic> {
    let mut read = name.read()?;
    out.findings(std::mem::take(&mut read.findings));
    out.findings_in(&**name, read.robot.calibration_warnings());
    Ok(read)
}

/// As [`read_named_robot`], without the provenance.
pub(crate) fn named(name: &RobotName, out: &CommandOutput) -> Result<Robot, Diagnostic> {
    read_named_robot(name, out).map(|read| read.robot)
}

#[derive(Serialize)]
struct RobotEntry<'a> {
    id: &'a str,
    name: &'a str,
    reach_mm: f64,
}

/// The JSON document of `robots show`.
#[derive(Serialize)]
struct RobotDocument<'a> {
    #[serde(flatten)]
    entry: RobotEntry<'a>,
    joints: Vec<JointTable>,
    /// Null where it is not stated.
    tool_ball_mm: Option<[f64; 3]>,
    tolerance: Tolerance,
    repeatability_mm: Option<f64>,
    identified: bool,
    source: Option<&'a str>,
}

pub(crate) fn run(args: &RobotsArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    match &args.what {
        None | Some(RobotsVerb::List) => list_robots(out),
        Some(RobotsVerb::Show { name }) => show_robot(name, out),
        Some(RobotsVerb::Import { from, robot, joints, maker, coupled, at, out: path, replace }) => {
            EarlierFiles::refused_unless(*replace).check(path)?;
            let known =
                KnownOfRobot { like: None, joints, maker: *maker, coupled: *coupled, shown: at.as_ref() };
            match Robot::built_in_file(from) {
                Some(text) => {
                    refuse_unused(robot.is_some(), &known, None)?;
                    copy_built_in(from, text, path, out)
                }
                None => import_robot(from, robot.as_ref(), known, path, out),
            }
        }
        Some(RobotsVerb::Check { name }) => {
            let robot = named(name, out)?;
            out.findings_in(&**name, request::edited(&robot));
            out.document(&RobotEntry { id: name, name: &robot.name, reach_mm: robot.reach_mm() })?;
            out.result(format!(
                "{}: {}, reach {:.1} mm: no mistake found",
                &**name,
                robot.name,
                robot.reach_mm()
            ));
            Ok(CommandOutcome::Done)
        }
    }
}

/// The JSON document of `robots import`.
#[derive(Serialize)]
struct ImportDocument<'a> {
    name: &'a str,
    out: String,
    /// How far the robot is off the description: absent for a copy.
    #[serde(flatten)]
    difference: Option<ImportDifference>,
}

#[derive(Serialize)]
struct ImportDifference {
    largest_difference_mm: f64,
    poses: usize,
}

/// Refuses options that are given and do not apply to what is imported; `None` for a robot of the catalogue.
fn refuse_unused(
    robot: bool,
    known: &KnownOfRobot<'_>,
    kind: Option<DescriptionKind>,
) -> Result<(), Diagnostic> {
    let is_urdf = kind == Some(DescriptionKind::Urdf);
    let unused = [
        ("--robot", robot && kind != Some(DescriptionKind::FactoryCalibration)),
        ("--joints", !known.joints.is_empty() && !is_urdf),
        ("--maker", known.maker.is_some() && !is_urdf),
        ("--coupled", known.coupled.is_some() && !is_urdf),
        ("--at", known.shown.is_some() && kind.is_none()),
    ];
    let unused = unused.into_iter().find(|(_, is_unused)| *is_unused);
    unused.map_or(Ok(()), |(option, _)| Err(CliFinding::Unused { option }.into()))
}

fn import_robot(
    from: &str,
    like: Option<&RobotName>,
    known: KnownOfRobot<'_>,
    path: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let like = like.map(|name| named(name, out)).transpose()?;
    let known = KnownOfRobot { like: like.as_ref(), ..known };
    let imported = match from.strip_prefix("ur://") {
        Some(host) => {
            refuse_unused(
                false,
                &KnownOfRobot { shown: None, ..known },
                Some(DescriptionKind::FactoryCalibration),
            )?;
            let in_file = |why: DescriptionFinding| Diagnostic::file(from, why);
            let like = known.like.ok_or(DescriptionFinding::TypeNeeded).map_err(in_file)?;
            FactoryTable::ask(host)?.imported(like).map_err(in_file)?
        }
        None => {
            let file = Path::new(from);
            if file.extension().is_none() && !file.exists() {
                return Err(Robot::unknown(from));
            }
            files::keeps(path, [file])?;
            let text = files::read_definition(file)?;
            refuse_unused(like.is_some(), &known, Some(DescriptionKind::of(&text)))?;
            robot_description::import(from, &text, known)?
        }
    };
    let ImportedRobot { robot, findings, largest_mm } = imported;
    out.findings_in(from, findings);
    let text = robot.to_toml()?;
    // What is written must be a robot.
    Robot::from_toml(&path.display().to_string(), &text)?;
    files::write_file(path, text)?;
    let (name, poses) = (robot.name.as_str(), CHECKED_POSES);
    out.document(&ImportDocument {
        name,
        out: path.display().to_string(),
        difference: Some(ImportDifference { largest_difference_mm: largest_mm, poses }),
    })?;
    out.result(format!(
        "{name}: its flange differs by {largest_mm:.1e} mm at most over {poses} poses; written to {}",
        path.display()
    ));
    Ok(CommandOutcome::Done)
}

fn copy_built_in(
    name: &str,
    text: &str,
    path: &Path,
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    files::write_file(path, text)?;
    let (name, path) = (&Robot::from_toml(name, text)?.name, path.display().to_string());
    out.result(format!("{name}: written to {path}"));
    out.document(&ImportDocument { name, out: path, difference: None })?;
    Ok(CommandOutcome::Done)
}

fn list_robots(out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let mut robots = Vec::new();
    for (id, text) in Robot::built_in() {
        robots.push((*id, Robot::from_toml(id, text)?));
    }
    let entries: Vec<RobotEntry<'_>> = robots
        .iter()
        .map(|(id, robot)| RobotEntry { id, name: &robot.name, reach_mm: robot.reach_mm() })
        .collect();
    out.list(&entries)?;
    for entry in &entries {
        out.result(format!("{:<12} {}, reach {:.1} mm", entry.id, entry.name, entry.reach_mm));
    }
    Ok(CommandOutcome::Done)
}

fn show_robot(name: &RobotName, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let robot = named(name, out)?;
    let shown = RobotDocument {
        entry: RobotEntry { id: name, name: &robot.name, reach_mm: robot.reach_mm() },
        joints: robot.joint_tables(),
        tool_ball_mm: robot.has_tool.then(|| robot.geometry.tool.into()),
        tolerance: robot.tolerance,
        repeatability_mm: robot.repeatability_mm,
        identified: robot.nominal.is_some(),
        source: robot.source.as_deref(),
    };
    out.document(&shown)?;
    out.result(format!("{} ({}), reach {:.1} mm", shown.entry.name, &**name, shown.entry.reach_mm));
    out.result("row i: Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d), theta = sign * A + offset (modified DH)");
    out.result(format!(
        "{:>5} {:>10} {:>10} {:>10} {:>10} {:>5} {:>9} {:>16} {:>9}",
        "joint", "alpha deg", "a mm", "offset deg", "d mm", "sign", "beta deg", "limits deg", "deg/s"
    ));
    for (joint, row) in (1..).zip(&shown.joints) {
        let [low, high] = row.limits_deg;
        out.result(format!(
            "{joint:>5} {:>10.4} {:>10.3} {:>10.4} {:>10.3} {:>5} {:>9.4} {:>16} {:>9.1}",
            row.alpha_deg,
            row.a_mm,
            row.theta_offset_deg,
            row.d_mm,
            row.sign,
            row.beta_deg,
            format!("{low}..{high}"),
            row.max_speed_deg_s
        ));
    }
    for (joint, row) in (1..).zip(&shown.joints) {
        let Some(CouplingTable { axis, factor, limits_deg }) = row.coupling else { continue };
        let within = limits_deg.map_or_else(String::new, |[low, high]| format!(", from {low} to {high} deg"));
        let sign = if factor < 0 { '-' } else { '+' };
        out.result(format!("joint {joint} turns by A{joint} {sign} A{axis}{within}"));
    }
    let ball = shown.tool_ball_mm.map_or("not stated".into(), |[x, y, z]| format!("{x}, {y}, {z} mm"));
    out.result(format!("tool ball in the flange: {ball}"));
    let tolerance = shown.tolerance;
    out.result(format!("tolerance (1 sd): {} mm, {} deg", tolerance.length_mm, tolerance.angle_deg));
    if let Some(repeatability) = shown.repeatability_mm {
        out.result(format!("repeatability: {repeatability} mm"));
    }
    if shown.identified {
        out.result("identified: the file holds the nominal robot as well");
    }
    if let Some(source) = shown.source {
        out.result(source);
    }
    Ok(CommandOutcome::Done)
}
