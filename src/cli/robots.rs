//! `dbbd robots`.

use serde::Serialize;

use super::{CommandOutcome, CommandOutput};
use dbbd_job::request;
use dbbd_job::robot_files::named_robot;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Tolerance;
use dbbd_model::robot::{CouplingTable, JointTable};
use dbbd_model::robot::{LoadedRobot, Robot};

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
        /// Built-in name or robot file.
        #[arg(value_name = "NAME|FILE")]
        name: String,
    },
    /// Check a robot file, and report a mistake with its line.
    Check {
        /// Built-in name or robot file.
        #[arg(value_name = "NAME|FILE")]
        name: String,
    },
}

/// Reads a robot by built-in name or file, and reports a doubtful identification.
pub(crate) fn read_named_robot(name: &str, out: &CommandOutput) -> Result<LoadedRobot, Diagnostic> {
    let mut read = named_robot(name)?;
    out.findings(std::mem::take(&mut read.findings));
    out.findings_in(name, read.robot.doubtful());
    Ok(read)
}

/// As [`read_named_robot`], without the provenance.
pub(crate) fn named(name: &str, out: &CommandOutput) -> Result<Robot, Diagnostic> {
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
    tool_ball_mm: [f64; 3],
    tolerance: Tolerance,
    repeatability_mm: Option<f64>,
    identified: bool,
    source: Option<&'a str>,
}

pub(crate) fn run(args: &RobotsArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    match &args.what {
        None | Some(RobotsVerb::List) => list_robots(out),
        Some(RobotsVerb::Show { name }) => show_robot(name, out),
        Some(RobotsVerb::Check { name }) => {
            let robot = named(name, out)?;
            out.findings_in(name, request::edited(&robot));
            out.document(&RobotEntry { id: name, name: &robot.name, reach_mm: robot.reach_mm() })?;
            out.result(format!("{name}: {}, reach {:.1} mm: no mistake found", robot.name, robot.reach_mm()));
            Ok(CommandOutcome::Done)
        }
    }
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

fn show_robot(name: &str, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let robot = named(name, out)?;
    let shown = RobotDocument {
        entry: RobotEntry { id: name, name: &robot.name, reach_mm: robot.reach_mm() },
        joints: robot.joint_tables(),
        tool_ball_mm: robot.geometry.tool.into(),
        tolerance: robot.tolerance,
        repeatability_mm: robot.repeatability_mm,
        identified: robot.nominal.is_some(),
        source: robot.source.as_deref(),
    };
    out.document(&shown)?;
    out.result(format!("{} ({name}), reach {:.1} mm", shown.entry.name, shown.entry.reach_mm));
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
    let [x, y, z] = shown.tool_ball_mm;
    out.result(format!("tool ball in the flange: {x}, {y}, {z} mm"));
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
