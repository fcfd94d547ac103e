//! `dbbd program`.

use crate::cli::value;
use std::net::SocketAddrV4;
use std::path::PathBuf;

use serde_json::json;

use super::{CommandOutcome, CommandOutput};
use dbbd_job::file_set::{EarlierFiles, FileSet};
use dbbd_job::plan::Plan;
use dbbd_job::program::ProgramFinding;
use dbbd_job::program::krl::{self, Controller, Options};
use dbbd_job::program::{self, Language, Written, fanuc, rapid, urscript};
use dbbd_job::recording::run::PlanFiles;
use dbbd_job::request;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Robot;

/// Write the programs of a plan in the language of the robot's controller.
///
/// Writes KRL (KUKA) as `dbbd krl` does, RAPID (ABB) as .mod with a .pgf, URScript (Universal Robots) as .script, or listings
/// of TP programs (FANUC) as .ls. The program moves, waits and marks each dwell. It never starts by itself. None of these
/// programs has run on a real controller. More: docs/reference/krl.md, rapid.md, urscript.md and fanuc.md.
#[derive(clap::Args)]
pub(crate) struct ProgramArgs {
    /// The plan; its .json is read beside it.
    #[arg(value_name = "PLAN.csv")]
    pub(super) plan: PathBuf,
    /// The language [default: that of the plan's robot].
    #[arg(long, value_parser = value::one_of(&Language::ALL, Language::name))]
    pub(super) language: Option<Language>,
    /// Directory for the program: DBB_MAIN, and DBB_C001 and so on, one for each circle.
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// How the program marks dwells. `output`: by a strobe and an index on digital outputs. `marker`: by the plan's sync
    /// markers in the length alone; no output is set. `ekrl`: in KRL only, see `dbbd krl --help` [default: output if the
    /// bar's protocol carries the strobe, else marker].
    #[arg(long, value_enum)]
    pub(super) sync: Option<SyncChoice>,
    /// For `ekrl`: the address where dbbd listens, as seen from the controller's network (IPv4).
    #[arg(long, value_name = "ADDR:PORT", required_if_eq("sync", "ekrl"))]
    pub(super) server: Option<SocketAddrV4>,
    /// The KUKA controller that runs a KRL program [default: krc4].
    #[arg(long, value_parser = value::one_of(&Controller::ALL, Controller::name))]
    pub(super) controller: Option<Controller>,
    /// Replace files that exist in DIR [default: refuse].
    #[arg(long)]
    pub(super) replace: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum SyncChoice {
    Marker,
    Output,
    Ekrl,
}

pub(crate) fn run(args: &ProgramArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let PlanFiles { path, plan, .. } = PlanFiles::read(&args.plan)?;
    out.findings(request::plan::changed_sources(&plan, &path));
    let robot = Robot::from_toml("the plan's robot", &plan.header.robot)?;
    let language = args.language.unwrap_or_else(|| Language::of_robot(&robot));
    check_language(args, &robot, language, out)?;
    let sync = match sync(args.sync, &plan, out)? {
        SyncChoice::Marker => program::Sync::Marker,
        SyncChoice::Output => program::Sync::Output,
        SyncChoice::Ekrl => program::Sync::Ekrl { server: args.server.ok_or(ProgramFinding::NoServer)? },
    };
    if let Some(server) = args.server {
        let is_used = matches!(sync, program::Sync::Ekrl { .. });
        check_server(server, is_used, args.controller == Some(Controller::Simulated), out)?;
    }
    let files = match language {
        Language::Krl => {
            let controller = args.controller.unwrap_or(Controller::Krc4);
            krl::emit(&plan, Options { sync, controller })?
        }
        Language::Rapid => rapid::emit(&plan, sync)?,
        Language::Urscript => urscript::emit(&plan, sync)?,
        Language::Fanuc => fanuc::emit(&plan, sync)?,
    };
    let mut set = FileSet::begin(&args.out, EarlierFiles::refused_unless(args.replace))?;
    let mut written = Vec::new();
    for (name, text) in &files {
        let path = args.out.join(name);
        set.write(name, text)?;
        out.detail(format!("wrote {}", path.display()));
        written.push(path.display().to_string());
    }
    set.finish()?;
    let others = stale(args, &files);
    if !others.is_empty() {
        let stale = ProgramFinding::StaleModules { modules: others.join(", ") };
        out.finding(Diagnostic::file(args.out.display(), stale));
    }
    out.document(&json!({ "plan": plan.header.hash, "files": written }))?;
    out.result(format!("{} files in {}; start DBB_MAIN", written.len(), args.out.display()));
    out.progress("not proven on a real controller: run it first in T1, slowly, without the bar");
    Ok(CommandOutcome::Done)
}

/// Refuses an address that is not used, or to which a controller cannot connect.
fn check_server(
    server: SocketAddrV4,
    is_used: bool,
    is_simulated: bool,
    out: &CommandOutput,
) -> Result<(), ProgramFinding> {
    if !is_used {
        return Err(ProgramFinding::ServerUnused);
    }
    if server.port() == 0 {
        return Err(ProgramFinding::ServerPort);
    }
    let ip = server.ip();
    if ip.is_unspecified() || ip.is_multicast() || ip.is_broadcast() {
        return Err(ProgramFinding::ServerAddress { server: server.to_string() });
    }
    if ip.is_loopback() && !is_simulated {
        out.finding(ProgramFinding::ServerLoopback { server: server.to_string() });
    }
    Ok(())
}

/// The modules of another plan in the directory. The controller would load them with the new ones.
fn stale(args: &ProgramArgs, written: &Written) -> Vec<String> {
    let is_module = |name: &String| {
        let (stem, extension) = name.rsplit_once('.').unwrap_or((name, ""));
        stem.to_ascii_uppercase().starts_with("DBB_C") && Language::of_extension(extension).is_some()
    };
    let is_written = |name: &String| written.iter().any(|(module, _)| module.eq_ignore_ascii_case(name));
    let entries = args.out.read_dir().into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut stale: Vec<String> = names.filter(|name| is_module(name) && !is_written(name)).collect();
    stale.sort();
    stale
}

/// Refuses a language that the plan's robot is not programmed in, and --controller where it has no effect.
fn check_language(
    args: &ProgramArgs,
    robot: &Robot,
    language: Language,
    out: &CommandOutput,
) -> Result<(), Diagnostic> {
    let (name, wanted) = (robot.name.clone(), language.name());
    match robot.controller_language() {
        _ if args.controller == Some(Controller::Simulated) => {}
        Some(known) if known == wanted => {}
        Some(known) => {
            let language = known.to_owned();
            return Err(ProgramFinding::OtherLanguage { robot: name, language, wanted }.into());
        }
        None => out.finding(ProgramFinding::LanguageNotKnown { robot: name, wanted }),
    }
    if language != Language::Krl && args.controller.is_some() {
        return Err(ProgramFinding::NoController { language: wanted }.into());
    }
    Ok(())
}

/// How the program marks dwells: as asked for, else as the plan's bar can read it.
fn sync(asked: Option<SyncChoice>, plan: &Plan, out: &CommandOutput) -> Result<SyncChoice, Diagnostic> {
    let (protocol, passes) = (plan.header.job.bar.protocol.clone(), !plan.header.passes.is_empty());
    // The file of a definition may exist only on the computer that records.
    let strobe = request::read_protocol(&protocol, &[]).ok().map(|definition| definition.has_strobe());
    match (asked, strobe) {
        (None, None) => Err(ProgramFinding::ProtocolNotHere { protocol }.into()),
        (None, Some(true)) => Ok(SyncChoice::Output),
        (None, Some(false)) if passes => Err(ProgramFinding::PassWithoutStrobe { protocol }.into()),
        (None, Some(false)) => {
            out.finding(ProgramFinding::MarkerChosen { protocol });
            Ok(SyncChoice::Marker)
        }
        (Some(SyncChoice::Output), Some(false)) => Err(ProgramFinding::NoStrobe { protocol }.into()),
        (Some(asked), _) => {
            if passes && asked == SyncChoice::Marker {
                out.finding(ProgramFinding::PassWithMarker);
            }
            Ok(asked)
        }
    }
}
