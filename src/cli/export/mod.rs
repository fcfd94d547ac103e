//! `dbbd export`.

mod tables;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use serde_json::{Map, json};

use super::{Outcome, Output, Verdict};
use crate::capture::Pass;
use crate::diag::Diagnostic;
use crate::export::mcap::{CHANNELS, McapFile};
use crate::files;
use tables::Tables;

/// Write a capture's samples, raw bytes, events, gaps and faults as CSV, or as MCAP.
///
/// CSV for scripts, MCAP for Foxglove, Python and ROS (examples/python, examples/foxglove). More: docs/capture.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The capture.
    run: PathBuf,
    /// Directory for samples.csv, raw.csv, events.csv, gaps.csv and faults.csv: times in ns of the host's
    /// clock, readings in mm.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write one MCAP file (RUN's name with the ending .mcap) instead: the channels raw, samples, faults, events
    /// and gaps as JSON, and the capture's attachments.
    #[arg(long)]
    mcap: bool,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    files::directory(&args.out)?;
    let mut counts = Map::new();
    let pass = if args.mcap {
        let name = Path::new(args.run.file_name().unwrap_or_default()).with_extension("mcap");
        let path = args.out.join(name);
        let unfinished = Unfinished::of(&path);
        let file = File::create(&unfinished.beside).map_err(|error| unwritten(&path, &error))?;
        let mut mcap = McapFile::new(BufWriter::new(file))?;
        let pass = Pass::over(&args.run, |stamped| Ok(mcap.add(&stamped)?))?;
        let messages = mcap.finish()?;
        unfinished.finish()?;
        for (name, messages) in CHANNELS.iter().zip(messages) {
            out.result(format!("{}: {name}: {messages} messages", path.display()));
            counts.insert((*name).to_owned(), json!(messages));
        }
        pass
    } else {
        let mut tables = Tables::create(&args.out)?;
        let pass = Pass::over(&args.run, |stamped| tables.add(&stamped))?;
        for (name, path, rows) in tables.finish()? {
            out.result(format!("{}: {rows} rows", path.display()));
            counts.insert(name.to_owned(), json!(rows));
        }
        pass
    };
    out.document(&counts)?;
    pass.remarks().iter().for_each(|remark| out.warning(remark));
    Ok(if pass.damages.is_empty() { Outcome::Done } else { Outcome::Doubt })
}

/// A file that is written beside its name until it is whole, and goes if it never is.
struct Unfinished {
    path: PathBuf,
    beside: PathBuf,
}

impl Unfinished {
    fn of(path: &Path) -> Self {
        let mut beside = path.as_os_str().to_owned();
        beside.push(".part");
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
    Diagnostic::file(&path.display().to_string(), format!("cannot be written: {error}"))
}
