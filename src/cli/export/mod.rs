//! `dbbd export`.

mod tables;
mod urdf;

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use serde_json::{Map, json};

use super::{CommandOutcome, CommandOutput};
use dbbd_job::file_set::EarlierFiles;
use dbbd_job::files::{self, UnfinishedFile};
use dbbd_job::recording::capture::CaptureSummary;
use dbbd_job::recording::run;
use dbbd_job::report::ReportFinding;
use dbbd_job::report::export::mcap::{CHANNELS, McapFile};
use dbbd_job::robot_files::named_robot;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;
use tables::{CaptureTables, WrittenTable};

/// Export a capture as CSV or MCAP, or an identified robot into a URDF.
///
/// Writes the samples, raw bytes, events, gaps and faults of a capture as CSV for scripts, or as MCAP for Foxglove, Python
/// and ROS (examples/python, examples/foxglove). More: docs/reference/capture.md. With --urdf-in, replaces the origins of the
/// joints in a URDF by those of an identified robot, and changes nothing else of it.
#[derive(clap::Args)]
pub(crate) struct ExportArgs {
    /// The capture; with --urdf-in the robot: a built-in name or a TOML file, such as robot-identified.toml.
    #[arg(value_name = "RUN|ROBOT")]
    run: PathBuf,
    /// Directory for samples.csv, raw.csv, events.csv, gaps.csv and faults.csv (times in ns of the host's clock, readings in
    /// mm), or for the URDF.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write one MCAP file (RUN's name with the extension .mcap) instead: the channels raw, samples, faults, events and gaps
    /// as JSON, and the capture's attachments.
    #[arg(long)]
    mcap: bool,
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
    if let Some(urdf) = &args.urdf_in {
        return urdf::run(args, urdf, out);
    }
    let mut counts = Map::new();
    let pass = if args.mcap {
        let name = Path::new(args.run.file_name().unwrap_or_default()).with_extension("mcap");
        let path = args.out.join(name);
        EarlierFiles::refused_unless(args.replace).check(&path)?;
        files::is_earlier(&path, MCAP_MAGIC)?;
        let (unfinished, file) = UnfinishedFile::create(&path)?;
        let wrong = |error: Diagnostic| error.in_file(path.display());
        let mut mcap = McapFile::new(BufWriter::new(file)).map_err(wrong)?;
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

/// Refuses a capture with --urdf-in, and a robot without it.
fn check_kind(args: &ExportArgs) -> Result<(), Diagnostic> {
    let name = args.run.to_string_lossy();
    let is_capture = args.run.is_file() && run::is_capture(&args.run)?;
    let is_named = Robot::built_in_file(&name).is_some() || args.run.is_file();
    let is_robot = || is_named && named_robot(&name).is_ok();
    let finding = match &args.urdf_in {
        Some(_) if is_capture => ReportFinding::CaptureIntoUrdf,
        None if !is_capture && is_robot() => ReportFinding::RobotWithoutUrdf,
        _ => return Ok(()),
    };
    Err(Diagnostic::file(&name, finding))
}
