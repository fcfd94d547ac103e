//! `dbbd serve`.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::json;

use super::acquire::simulated;
use super::{CommandOutcome, CommandOutput, demo};
use crate::catalogue;
use crate::daemon::{
    self, CellRequest, HaltBehaviour, LogLevel, MakeCell, ServiceConfig, ServiceLog, ServiceParts,
};
use dbbd_device::port::PortAddress;
use dbbd_job::files;
use dbbd_model::diagnostic::Diagnostic;

/// Printed below the options.
const MORE: &str = "Without a configuration the service listens on 127.0.0.1:8230, stores runs in ./dbbd-runs and looks for \
plans in ./NAME/plan.csv; the port of the bar is then chosen on the page. docs/reference/service.md explains every key, \
docs/reference/security.md the access rights. SIGINT and SIGTERM end a run properly. dbbd never starts or moves the robot, \
and its alarm is not a safety function.";

/// Serve the live page and the HTTP API for one bar.
///
/// The page shows the length against the stroke and a polar plot, starts and stops runs, evaluates them and shows their
/// reports. dbbd never starts or moves the robot, and its alarm is not a safety function. More: docs/reference/service.md,
/// docs/reference/security.md.
#[derive(clap::Args)]
#[command(after_help = MORE)]
pub(crate) struct ServeArgs {
    /// Configuration: a TOML file. Relative paths in it start from its directory.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Only check the configuration.
    #[arg(long)]
    check: bool,
}

pub(crate) fn run(args: &ServeArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let config = args.config.as_deref().map(ServiceConfig::read).transpose()?.unwrap_or_default();
    let (address, data) = (config.endpoint.address, config.data.display().to_string());
    check_writable(&config.data)?;
    if args.check {
        out.document(&json!({
            "address": address.to_string(), "data": data, "plans": config.plans.display().to_string(),
            "port": config.port.map(|port| port.to_string()), "protocol": config.protocol.as_ref().map(|one| &one.id),
            "token": config.endpoint.token.is_some(), "users": config.endpoint.users.len(),
        }))?;
        out.result(format!("the configuration is sound: http://{address}/, runs in {data}"));
        return Ok(CommandOutcome::Done);
    }
    let parts = ServiceParts {
        make_cell: make_cell(out.clone()),
        make_demo: Box::new(demo::write_cell),
        explain: |code| {
            let entry = catalogue::entries().find(|entry| entry.code.as_str() == code)?;
            Some((entry.cause, entry.cure))
        },
    };
    daemon::serve(config, Arc::new(LogLines { out: out.clone() }), parts)?;
    Ok(CommandOutcome::Done)
}

/// Checks that files can be written in a directory, or in its nearest ancestor that exists.
fn check_writable(directory: &Path) -> Result<(), Diagnostic> {
    let is_named = |path: &&Path| !path.as_os_str().is_empty();
    let existing = directory.ancestors().filter(is_named).find(|path| path.exists());
    let file = tempfile::tempfile_in(existing.unwrap_or(Path::new(".")));
    file.map(drop).map_err(files::unwritable(directory))
}

/// Creates the simulated cell of the port `sim`.
fn make_cell(out: CommandOutput) -> Option<MakeCell> {
    let make = move |wanted: &CellRequest<'_>| -> Result<Box<dyn daemon::SimulatedCell>, Diagnostic> {
        let halt_s = match wanted.halt {
            HaltBehaviour::Continue => simulated::HALT_S,
            HaltBehaviour::Wait => "86400",
        };
        let speed = wanted.speed.to_string();
        let options = simulated::CellOptions { speed: &speed, ..simulated::CellOptions::real_time(halt_s) };
        Ok(Box::new(simulated::PlanSimulator::start(wanted.plan, options, &out)?))
    };
    Some(Box::new(make))
}

impl daemon::SimulatedCell for simulated::PlanSimulator {
    fn port(&self) -> &PortAddress {
        self.port()
    }

    fn plan(&self) -> &Path {
        self.plan()
    }
}

/// The longest value in the log, in characters. A client may send a longer one.
const LONGEST_VALUE: usize = 300;

/// The log: each event is a line `level=.. event=.. key=value` on stderr.
pub(super) struct LogLines {
    pub(super) out: CommandOutput,
}

impl ServiceLog for LogLines {
    fn event(&self, level: LogLevel, event: &str, fields: &[(&str, &dyn Display)]) {
        let word = match level {
            LogLevel::Info => "info",
            LogLevel::Warning => "warning",
            LogLevel::Error => "error",
        };
        let mut line = format!("level={word} event={event}");
        for (name, value) in fields {
            let mut value = value.to_string();
            if let Some((end, _)) = value.char_indices().nth(LONGEST_VALUE) {
                value.replace_range(end.., "...");
            }
            let bare =
                !value.is_empty() && value.chars().all(|c| c.is_ascii_graphic() && !"\"=\\".contains(c));
            // Quoted as a string literal, so that no value can break the line.
            line.push_str(&if bare { format!(" {name}={value}") } else { format!(" {name}={value:?}") });
        }
        match level {
            LogLevel::Info => self.out.progress(line),
            LogLevel::Warning | LogLevel::Error => self.out.always(line),
        }
    }
}
