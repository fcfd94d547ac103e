//! `dbbd serve`: the service with its page and its API.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::json;

use super::acquire::simulated;
use super::{Outcome, Output};
use crate::catalogue::FileFinding;
use crate::daemon::{self, Bench, Config, Level, Log, Program};
use crate::device::port::PortAddress;
use crate::diagnostic::Diagnostic;

/// Shown below the options.
const MORE: &str = "Without a configuration it listens on 127.0.0.1:8230, keeps runs in ./dbbd-runs and looks for \
plans in ./NAME/plan.csv; the port is then chosen on the page. docs/reference/service.md explains every key, docs/reference/security.md who \
may ask what. SIGINT and SIGTERM end a run as it should. dbbd never starts or moves the robot, and its alarm is not a \
safety function.";

/// Serve the live page and the HTTP API for one bar.
///
/// Length against stroke, polar plot, start, stop, evaluation and report in a browser. dbbd never starts or moves
/// the robot, and its alarm is not a safety function. More: docs/reference/service.md, docs/reference/security.md.
#[derive(clap::Args)]
#[command(after_help = MORE)]
pub(crate) struct Args {
    /// Configuration: a TOML file; relative paths in it count from its directory.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Only check the configuration.
    #[arg(long)]
    check: bool,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let config = args.config.as_deref().map(Config::read).transpose()?.unwrap_or_default();
    let (address, data) = (config.door.address, config.data.display().to_string());
    can_be_made(&config.data)?;
    if args.check {
        out.document(&json!({
            "address": address.to_string(), "data": data, "plans": config.plans.display().to_string(),
            "port": config.port.map(|port| port.to_string()), "protocol": config.protocol.as_ref().map(|one| &one.id),
            "token": config.door.token.is_some(),
        }))?;
        out.result(format!("the configuration is sound: http://{address}/, runs in {data}"));
        return Ok(Outcome::Done);
    }
    daemon::serve(config, Arc::new(Lines { out: out.clone() }), bench(out.clone()))?;
    Ok(Outcome::Done)
}

/// That files can be written in a directory, or in the one in which it would be made.
fn can_be_made(directory: &Path) -> Result<(), Diagnostic> {
    let named = |path: &&Path| !path.as_os_str().is_empty();
    let there = directory.ancestors().filter(named).find(|path| path.exists()).unwrap_or(Path::new("."));
    let unwritable = |error: std::io::Error| {
        let why = FileFinding::Unwritable { why: error.to_string() };
        Diagnostic::file(&directory.display().to_string(), why)
    };
    tempfile::tempfile_in(there).map(drop).map_err(unwritable)
}

/// What the port `sim` reads: a simulated cell at the speed of life.
fn bench(out: Output) -> Option<Bench> {
    let make = move |plan: Option<&Path>, program: Program| -> Result<Box<dyn daemon::Cell>, Diagnostic> {
        Ok(Box::new(simulated::Cell::start_at(plan, "1", halt(program), None, &out)?))
    };
    Some(Box::new(make))
}

/// How long the program waits at its HALT, s.
fn halt(program: Program) -> &'static str {
    match program {
        Program::Runs => "2",
        Program::Waits => "86400",
    }
}

impl daemon::Cell for simulated::Cell {
    fn port(&self) -> &PortAddress {
        self.port()
    }

    fn plan(&self) -> &Path {
        self.plan()
    }
}

/// Characters of a value in the log; what a client sends may be longer.
const LONGEST_VALUE: usize = 300;

/// The log: a line an event on stderr, `level=.. event=.. key=value`.
pub(super) struct Lines {
    pub(super) out: Output,
}

impl Log for Lines {
    fn say(&self, level: Level, event: &str, fields: &[(&str, &dyn Display)]) {
        let word = match level {
            Level::Info => "info",
            Level::Warning => "warning",
            Level::Error => "error",
        };
        let mut line = format!("level={word} event={event}");
        for (name, value) in fields {
            let mut value = value.to_string();
            if let Some((end, _)) = value.char_indices().nth(LONGEST_VALUE) {
                value.replace_range(end.., "...");
            }
            let bare =
                !value.is_empty() && value.chars().all(|c| c.is_ascii_graphic() && !"\"=\\".contains(c));
            // Quoted as a string literal: no value can break the line.
            line.push_str(&if bare { format!(" {name}={value}") } else { format!(" {name}={value:?}") });
        }
        match level {
            Level::Info => self.out.progress(line),
            Level::Warning | Level::Error => self.out.always(line),
        }
    }
}
