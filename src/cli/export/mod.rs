//! `dbbd export`.

mod robot;
mod tables;

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use serde_json::{Map, json};

use super::{CommandOutcome, CommandOutput};
use dbbd_job::file_set::EarlierFiles;
use dbbd_job::files::{self, UnfinishedFile};
use dbbd_job::recording::capture::CaptureSummary;
use dbbd_job::recording::run;
use dbbd_job::report::ReportFinding;
use dbbd_job::report::export::mcap::{CHANNELS, McapFile, RunScene};
use dbbd_model::diagnostic::Diagnostic;
use robot::{TargetName, robot_name};
use tables::{CaptureTables, WrittenTable};

/// Export a capture as CSV or MCAP, or an identified robot for another program or its controller.
///
/// Writes the samples, raw bytes, events, gaps and faults of a capture as CSV for scripts, or as MCAP for Foxglove, Python
/// and ROS (examples/python, examples/foxglove). More: docs/reference/capture.md. With --for, writes an identified robot in
/// the files of a target, states in mm what these leave out, and adds the errors of the joints as joint-errors.csv where there
/// are any. With --urdf-in, replaces the origins of the joints in your own URDF, and changes nothing else of it.
#[derive(clap::Args)]
pub(crate) struct ExportArgs {
    /// The capture. With --for or --urdf-in the directory of a result, or the robot: a built-in name or a TOML file, such as
    /// robot-identified.toml.
    #[arg(value_name = "RUN|RESULT|ROBOT")]
    run: PathBuf,
    /// Directory for samples.csv, raw.csv, events.csv, gaps.csv and faults.csv (times in ns of the host's clock, readings in
    /// mm), or for the files of the robot.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write one MCAP file (RUN's name with the extension .mcap) instead: the channels raw, samples, faults, events, gaps and axes
    /// as JSON, tf and scene (robot, balls and bar in 3-D) as Foxglove's Protobuf, the capture's attachments and robot.urdf.
    #[arg(long)]
    mcap: bool,
    /// Whom the files of the robot are for.
    #[arg(long = "for", value_name = "TARGET", value_enum, conflicts_with_all = ["mcap", "urdf_in"])]
    target: Option<TargetName>,
    /// Your URDF. It is written to DIR under its name, with the robot's identified joints.
    #[arg(long, value_name = "FILE", conflicts_with = "mcap")]
    urdf_in: Option<PathBuf>,
    /// The six joints of the arm from base to flange, if the URDF has several chains.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "urdf_in")]
    joints: Vec<String>,
    /// Replace files that exist in DIR [default: refuse].
    #[arg(long)]
    replace: bool,
}

/// The first bytes of an MCAP file.
const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";

pub(crate) fn run(args: &ExportArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    check_kind(args)?;
    files::directory(&args.out)?;
    if let Some(target) = args.target {
        return robot::hand_back(args, target, out);
    }
    if let Some(urdf) = &args.urdf_in {
        return robot::patch_urdf(args, urdf, out);
    }
    let mut counts = Map::new();
    let pass = if args.mcap {
        let name = Path::new(args.run.file_name().unwrap_or_default()).with_extension("mcap");
        let path = args.out.join(name);
        EarlierFiles::refused_unless(args.replace).check(&path)?;
        files::is_earlier(&path, MCAP_MAGIC)?;
        let (unfinished, file) = UnfinishedFile::create(&path)?;
        let wrong = |error: Diagnostic| error.in_file(path.display());
        let mut mcap = McapFile::new(BufWriter::new(file), scene(&args.run)).map_err(wrong)?;
        let pass = CaptureSummary::over(&args.run, |stamped| mcap.add(&stamped).map_err(wrong))?;
        let messages = mcap.finish().map_err(wrong)?;
        unfinished.finish()?;
        for (name, messages) in CHANNELS.iter().zip(messages) {
            out.result(format!("{}: {name}: {messages} messages", path.display()));
            counts.insert((*name).to_owned(), json!(messages));
        }
        pass
    } else {
        let mut tables = CaptureTables::create(&args.out, EarlierFiles::refused_unless(args.replace))?;
        let pass = CaptureSummary::over(&args.run, |stamped| tables.add(&stamped))?;
        for WrittenTable { name, path, rows } in tables.finish()? {
            out.result(format!("{}: {rows} rows", path.display()));
            counts.insert(name.to_owned(), json!(rows));
        }
        pass
    };
    out.findings_in(args.run.display(), pass.findings());
    out.document(&counts)?;
    Ok(CommandOutcome::Done)
}

/// The scene of a run whose poses can be matched; a capture without a plan, or of a foreign program, has none.
fn scene(run: &Path) -> Option<RunScene> {
    let run = run::open_run(run, None, &[], &mut |_| {}).ok()?;
    let (robot, matching) = (run.robot().ok()?, run.matching(None).ok()?);
    Some(RunScene::of(&run, &robot, &matching))
}

/// Refuses a capture where a robot is exported, and a robot where nothing says for whom.
fn check_kind(args: &ExportArgs) -> Result<(), Diagnostic> {
    let name = robot_name(args);
    let is_capture = args.run.is_file() && run::is_capture(&args.run)?;
    let is_robot = || name.file().is_none_or(Path::is_file) && name.read().is_ok();
    let wants_robot = args.target.is_some() || args.urdf_in.is_some();
    let finding = match wants_robot {
        true if is_capture => ReportFinding::CaptureAsRobot,
        false if !is_capture && is_robot() => ReportFinding::RobotWithoutTarget,
        true | false => return Ok(()),
    };
    Err(Diagnostic::file(&*name, finding))
}
