//! `dbbd program`, of which `dbbd krl` is the short form for KRL.

use std::net::SocketAddrV4;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Outcome, Output, protocols};
use crate::base::FileSet;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::plan::Plan;
use crate::program::krl::{self, Controller, Options};
use crate::program::{self, Language, Written, rapid, urscript};
use crate::recording::run;
use crate::robot::Robot;

/// Write the programs of a plan in the language of a robot's controller.
///
/// KRL (KUKA) as `dbbd krl` writes it, RAPID (ABB) as .mod with a .pgf, or URScript (Universal Robots) as .script. The
/// program moves, waits, and marks each dwell; it never runs by itself. None has run on a real controller. More:
/// docs/reference/krl.md, docs/reference/rapid.md and docs/reference/urscript.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The plan; its .json is read beside it.
    #[arg(value_name = "PLAN.csv")]
    plan: PathBuf,
    /// The language [default: that of the plan's robot].
    #[arg(long, value_enum)]
    language: Option<Language>,
    /// Directory for the program: DBB_MAIN, and with it DBB_C001 and so on, one for each circle.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How dwells are marked. `output`: a strobe and an index on digital outputs; `marker`: by the
    /// plan's sync markers in the length alone, no output is set; `ekrl`: of KRL only, see `dbbd krl --help`
    /// [default: output where the bar's protocol carries the strobe, else marker].
    #[arg(long, value_enum)]
    sync: Option<Sync>,
    /// For `ekrl`: where dbbd listens, as the controller's network sees it (IPv4).
    #[arg(long, value_name = "ADDR:PORT", required_if_eq("sync", "ekrl"))]
    server: Option<SocketAddrV4>,
    /// The KUKA controller that a KRL program is for [default: krc4].
    #[arg(long, value_enum)]
    controller: Option<Controller>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Sync {
    Marker,
    Output,
    Ekrl,
}

/// What is to be written.
pub(super) struct Request<'a> {
    pub(super) plan: &'a Path,
    pub(super) out: &'a Path,
    pub(super) sync: Option<Sync>,
    pub(super) server: Option<SocketAddrV4>,
    pub(super) language: Option<Language>,
    pub(super) controller: Option<Controller>,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let Args { plan, language, out: directory, sync, server, controller } = args;
    let (language, sync, server, controller) = (*language, *sync, *server, *controller);
    write(&Request { plan, out: directory, sync, server, language, controller }, out)
}

pub(super) fn write(request: &Request<'_>, out: &Output) -> Result<Outcome, Diagnostic> {
    let plan = run::read_plan(request.plan)?;
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let language = request.language.unwrap_or_else(|| Language::of_robot(&robot));
    check_language(&robot, language, request.controller, out)?;
    let sync = match chosen(request.sync, &plan, out)? {
        Sync::Marker => program::Sync::Marker,
        Sync::Output => program::Sync::Output,
        Sync::Ekrl => program::Sync::Ekrl { server: request.server.ok_or(ProgramFinding::NoServer)? },
    };
    check_server(request, matches!(sync, program::Sync::Ekrl { .. }), out)?;
    let files = emit(&plan, language, sync, request.controller)?;
    let mut set = FileSet::begin(request.out)?;
    let mut written = Vec::new();
    for (name, text) in &files {
        let path = request.out.join(name);
        set.write(name, text)?;
        out.detail(format!("wrote {}", path.display()));
        written.push(path.display().to_string());
    }
    set.finish()?;
    let others = stale(request.out, &files);
    if !others.is_empty() {
        let directory = request.out.display().to_string();
        out.finding(Diagnostic::file(
            &directory,
            ProgramFinding::StaleModules { modules: others.join(", ") },
        ));
    }
    out.document(&json!({ "plan": plan.header.hash, "files": written }))?;
    out.result(format!("{} files in {}; start DBB_MAIN", written.len(), request.out.display()));
    out.progress("not proven on a real controller: run it first in T1, slowly, without the bar");
    Ok(Outcome::Done)
}

fn emit(
    plan: &Plan,
    language: Language,
    sync: program::Sync,
    controller: Option<Controller>,
) -> Result<Written, Diagnostic> {
    if let (Language::Rapid | Language::Urscript, Some(_)) = (language, controller) {
        return Err(ProgramFinding::NoController { language: language.name() }.into());
    }
    match language {
        Language::Krl => {
            krl::emit(plan, Options { sync, controller: controller.unwrap_or(Controller::Krc4) })
        }
        Language::Rapid => rapid::emit(plan, sync),
        Language::Urscript => urscript::emit(plan, sync),
    }
}

/// The address must be used, and one that a controller can connect to.
fn check_server(request: &Request<'_>, used: bool, out: &Output) -> Result<(), ProgramFinding> {
    let Some(server) = request.server else { return Ok(()) };
    if !used {
        return Err(ProgramFinding::ServerUnused);
    }
    if server.port() == 0 {
        return Err(ProgramFinding::ServerPort);
    }
    let ip = server.ip();
    if ip.is_unspecified() || ip.is_multicast() || ip.is_broadcast() {
        return Err(ProgramFinding::ServerAddress { server: server.to_string() });
    }
    if server.ip().is_loopback() && request.controller != Some(Controller::Simulated) {
        out.finding(ProgramFinding::ServerLoopback { server: server.to_string() });
    }
    Ok(())
}

/// Modules of another plan in the directory, which would be loaded with these.
fn stale(directory: &Path, written: &Written) -> Vec<String> {
    let is_module = |name: &String| {
        let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
        stem.to_ascii_uppercase().starts_with("DBB_C") && Language::of_extension(extension).is_some()
    };
    let is_written = |name: &String| written.iter().any(|(module, _)| module.eq_ignore_ascii_case(name));
    let found = directory.read_dir().into_iter().flatten().flatten();
    let names = found.filter_map(|entry| entry.file_name().into_string().ok());
    let mut stale: Vec<String> = names.filter(|name| is_module(name) && !is_written(name)).collect();
    stale.sort();
    stale
}

/// The plan's robot must be one that is programmed in the language.
fn check_language(
    robot: &Robot,
    language: Language,
    controller: Option<Controller>,
    out: &Output,
) -> Result<(), Diagnostic> {
    let (name, wanted) = (robot.name.clone(), language.name());
    match robot.controller_language() {
        _ if controller == Some(Controller::Simulated) => {}
        Some(known) if known == wanted => {}
        Some(known) => {
            let language = known.to_owned();
            return Err(ProgramFinding::OtherLanguage { robot: name, language, wanted }.into());
        }
        None => out.finding(ProgramFinding::LanguageNotKnown { robot: name, wanted }),
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
