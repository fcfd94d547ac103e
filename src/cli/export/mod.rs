//! `dbbd export`.

mod tables;
mod urdf;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use serde_json::{Map, json};

use super::{Outcome, Output};
use crate::base::files;
use crate::catalogue::{FileFinding, ReportFinding};
use crate::diagnostic::Diagnostic;
use crate::recording::capture::Pass;
use crate::recording::run;
use crate::report::export::mcap::{CHANNELS, McapFile};
use crate::robot::Robot;
use tables::{Tables, Written};

/// Write a capture's samples, raw bytes, events, gaps and faults as CSV, or as MCAP; or a robot into your URDF.
///
/// CSV for scripts, MCAP for Foxglove, Python and ROS (examples/python, examples/foxglove). More: docs/reference/capture.md.
/// With --urdf-in the joints' origins in a URDF become those of an identified robot, and nothing else of it changes.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The capture; with --urdf-in the robot: a built-in name or a TOML file, such as robot-identified.toml.
    #[arg(value_name = "RUN|ROBOT")]
    run: PathBuf,
    /// Directory for samples.csv, raw.csv, events.csv, gaps.csv and faults.csv: times in ns of the host's
    /// clock, readings in mm; or for the URDF.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write one MCAP file (RUN's name with the ending .mcap) instead: the channels raw, samples, faults, events
    /// and gaps as JSON, and the capture's attachments.
    #[arg(long)]
    mcap: bool,
    /// Your URDF: it is written to DIR under its name with the robot's identified joints.
    #[arg(long, value_name = "FILE", conflicts_with = "mcap")]
    urdf_in: Option<PathBuf>,
    /// The six joints of the arm, base to flange, where the URDF has several chains.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "urdf_in")]
    joints: Vec<String>,
}

/// What a file of MCAP begins with.
const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    of_its_kind(args)?;
    files::directory(&args.out)?;
    if let Some(users) = &args.urdf_in {
        return urdf::run(args, users, out);
    }
    let mut counts = Map::new();
    let pass = if args.mcap {
        let name = Path::new(args.run.file_name().unwrap_or_default()).with_extension("mcap");
        let path = args.out.join(name);
        files::is_earlier(&path, MCAP_MAGIC)?;
        let unfinished = Unfinished::of(&path);
        let file = File::create(&unfinished.beside).map_err(|error| unwritten(&path, &error))?;
        let wrong = |error: Diagnostic| Diagnostic { file: path.display().to_string(), ..error };
        let mut mcap = McapFile::new(BufWriter::new(file)).map_err(wrong)?;
        let pass = Pass::over(&args.run, |stamped| mcap.add(&stamped).map_err(wrong))?;
        let messages = mcap.finish().map_err(wrong)?;
        unfinished.finish()?;
        for (name, messages) in CHANNELS.iter().zip(messages) {
            out.result(format!("{}: {name}: {messages} messages", path.display()));
            counts.insert((*name).to_owned(), json!(messages));
        }
        pass
    } else {
        let mut tables = Tables::create(&args.out)?;
        let pass = Pass::over(&args.run, |stamped| tables.add(&stamped))?;
        for Written { name, path, rows } in tables.finish()? {
            out.result(format!("{}: {rows} rows", path.display()));
            counts.insert(name.to_owned(), json!(rows));
        }
        pass
    };
    let name = args.run.display().to_string();
    pass.findings().into_iter().for_each(|damage| out.finding(Diagnostic::file(&name, damage)));
    out.document(&counts)?;
    Ok(Outcome::Done)
}

/// That a robot goes into a URDF, and a capture does not.
fn of_its_kind(args: &Args) -> Result<(), Diagnostic> {
    let name = args.run.to_string_lossy();
    let is_capture = args.run.is_file() && run::is_capture(&args.run)?;
    let finding = match &args.urdf_in {
        Some(_) if is_capture => ReportFinding::CaptureIntoUrdf,
        None if !is_capture && Robot::named(&name, files::read_if_file).is_ok() => {
            ReportFinding::RobotWithoutUrdf
        }
        _ => return Ok(()),
    };
    Err(Diagnostic::file(&name, finding))
}

/// A file that is written beside its name until it is whole, and goes if it never is.
struct Unfinished {
    path: PathBuf,
    beside: PathBuf,
}

impl Unfinished {
    fn of(path: &Path) -> Self {
        let mut beside = path.as_os_str().to_owned();
        beside.push(format!(".{}.part", std::process::id()));
        Self { path: path.into(), beside: beside.into() }
    }

    fn finish(&self) -> Result<(), Diagnostic> {
        std::fs::rename(&self.beside, &self.path).map_err(|error| unwritten(&self.path, &error))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // Gone already when it was finished.
        let _ = std::fs::remove_file(&self.beside);
    }
}

fn unwritten(path: &Path, error: &dyn std::error::Error) -> Diagnostic {
    Diagnostic::file(&path.display().to_string(), FileFinding::Unwritable { why: error.to_string() })
}
