//! `dbbd krl`.

use std::net::SocketAddrV4;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Outcome, Output, protocols};
use crate::base::files;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::plan::Plan;
use crate::program::krl::{self, Controller, Options};
use crate::recording::run;
use crate::robot::Robot;

/// Write the KRL programs of a plan.
///
/// One module for each circle under DBB_MAIN, for KR C2, KR C4 or KR C5, as .src and .dat. The program moves,
/// waits, and marks each dwell; it never runs by itself. More: docs/reference/krl.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The plan; its .json is read beside it.
    #[arg(value_name = "PLAN.csv")]
    plan: PathBuf,
    /// Directory for the modules: DBB_MAIN, which calls DBB_C001 and so on, one for each circle.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How dwells are marked. `output`: a strobe and an index on digital outputs; `marker`: by the
    /// plan's sync markers in the length alone, no output is set.
    /// `ekrl`: by telegrams over EthernetKRL (KR C4 and later) to `dbbd acquire --ekrl`
    /// [default: output where the bar's protocol carries the strobe, else marker].
    #[arg(long, value_enum)]
    sync: Option<Sync>,
    /// For `ekrl`: where dbbd listens, as the controller's network sees it (IPv4).
    #[arg(long, value_name = "ADDR:PORT", required_if_eq("sync", "ekrl"))]
    server: Option<SocketAddrV4>,
    /// The controller that the program is for; `simulated` is that of `dbbd simulate`, which moves robots of any make.
    #[arg(long, value_enum, default_value_t = Controller::Krc4)]
    controller: Controller,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Sync {
    Marker,
    Output,
    Ekrl,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let plan = run::read_plan(&args.plan)?;
    check_language(&plan, args.controller, out)?;
    let sync = match chosen(args.sync, &plan, out)? {
        Sync::Marker => krl::Sync::Marker,
        Sync::Output => krl::Sync::Output,
        Sync::Ekrl => krl::Sync::Ekrl { server: args.server.ok_or(ProgramFinding::NoServer)? },
    };
    check_server(args, matches!(sync, krl::Sync::Ekrl { .. }), out)?;
    let options = Options { sync, controller: args.controller };
    let modules = krl::emit(&plan, options)?;
    let _writing = files::exclusive(&args.out)?;
    let mut written = Vec::new();
    for (name, text) in &modules {
        let path = args.out.join(name);
        files::write(&path, text)?;
        out.detail(format!("wrote {}", path.display()));
        written.push(path.display().to_string());
    }
    let others = stale(&args.out, &modules);
    if !others.is_empty() {
        let directory = args.out.display().to_string();
        out.finding(Diagnostic::file(
            &directory,
            ProgramFinding::StaleModules { modules: others.join(", ") },
        ));
    }
    out.document(&json!({ "plan": plan.header.hash, "files": written }))?;
    out.result(format!("{} files in {}; start DBB_MAIN", written.len(), args.out.display()));
    out.progress("not proven on a real controller: run it first in T1, slowly, without the bar");
    Ok(Outcome::Done)
}

/// The address must be used, and one that a controller can connect to.
fn check_server(args: &Args, used: bool, out: &Output) -> Result<(), ProgramFinding> {
    let Some(server) = args.server else { return Ok(()) };
    if !used {
        return Err(ProgramFinding::ServerUnused);
    }
    if server.port() == 0 {
        return Err(ProgramFinding::ServerPort);
    }
    if server.ip().is_loopback() && args.controller != Controller::Simulated {
        out.finding(ProgramFinding::ServerLoopback { server: server.to_string() });
    }
    Ok(())
}

/// Modules of another plan in the directory, which would be loaded with these.
fn stale(directory: &Path, modules: &[(String, String)]) -> Vec<String> {
    let is_module = |name: &String| {
        let upper = name.to_ascii_uppercase();
        upper.starts_with("DBB_C") && (upper.ends_with(".SRC") || upper.ends_with(".DAT"))
    };
    let is_written = |name: &String| modules.iter().any(|(module, _)| module.eq_ignore_ascii_case(name));
    let found = directory.read_dir().into_iter().flatten().flatten();
    let names = found.filter_map(|entry| entry.file_name().into_string().ok());
    let mut stale: Vec<String> = names.filter(|name| is_module(name) && !is_written(name)).collect();
    stale.sort();
    stale
}

/// The plan's robot must be one that is programmed in KRL.
fn check_language(plan: &Plan, controller: Controller, out: &Output) -> Result<(), Diagnostic> {
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    match robot.controller_language() {
        _ if controller == Controller::Simulated => {}
        Some("krl") => {}
        Some(language) => {
            let language = language.to_owned();
            return Err(ProgramFinding::OtherLanguage { robot: robot.name, language }.into());
        }
        None => out.finding(ProgramFinding::LanguageNotKnown { robot: robot.name }),
    }
    Ok(())
}

/// The way that the plan's bar can read.
fn chosen(asked: Option<Sync>, plan: &Plan, out: &Output) -> Result<Sync, Diagnostic> {
    let (protocol, passes) = (plan.header.job.bar.protocol.clone(), !plan.header.passes.is_empty());
    // A definition in a file may be there only where the run is.
    let strobe = protocols::load_with(&protocol, &[]).ok().map(|definition| definition.has_strobe());
    match (asked, strobe) {
        (None, None) => Err(ProgramFinding::ProtocolNotHere { protocol }.into()),
        (None, Some(true)) => Ok(Sync::Output),
        (None, Some(false)) if passes => Err(ProgramFinding::PassWithoutStrobe { protocol }.into()),
        (None, Some(false)) => {
            out.finding(ProgramFinding::MarkerChosen { protocol });
            Ok(Sync::Marker)
        }
        (Some(Sync::Output), Some(false)) => Err(ProgramFinding::NoStrobe { protocol }.into()),
        (Some(asked), _) => {
            if passes && asked == Sync::Marker {
                out.finding(ProgramFinding::PassWithMarker);
            }
            Ok(asked)
        }
    }
}
