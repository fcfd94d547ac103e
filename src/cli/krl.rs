//! `dbbd krl`, the short form of `dbbd program --language krl`.

use crate::cli::value;
use std::net::SocketAddrV4;
use std::path::PathBuf;

use super::program::{self, SyncChoice};
use super::{CommandOutcome, CommandOutput};
use dbbd_job::program::Language;
use dbbd_job::program::krl::Controller;
use dbbd_model::diagnostic::Diagnostic;

/// Write the KRL programs of a plan.
///
/// Writes one module (.src and .dat) for each circle, and DBB_MAIN, which calls them, for KR C2, KR C4 or KR C5. The program
/// moves, waits and marks each dwell. It never starts by itself. More: docs/reference/krl.md.
#[derive(clap::Args)]
pub(crate) struct KrlArgs {
    /// The plan; its .json is read beside it.
    #[arg(value_name = "PLAN.csv")]
    plan: PathBuf,
    /// Directory for the modules: DBB_MAIN, which calls DBB_C001 and so on, one for each circle.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How the program marks dwells. `output`: by a strobe and an index on digital outputs. `marker`: by the plan's sync
    /// markers in the length alone; no output is set. `ekrl`: by telegrams over EthernetKRL (KR C4 and later) to `dbbd
    /// acquire --ekrl` [default: output if the bar's protocol carries the strobe, else marker].
    #[arg(long, value_enum)]
    sync: Option<SyncChoice>,
    /// For `ekrl`: the address where dbbd listens, as seen from the controller's network (IPv4).
    #[arg(long, value_name = "ADDR:PORT", required_if_eq("sync", "ekrl"))]
    server: Option<SocketAddrV4>,
    /// The controller that runs the program; `simulated` is that of `dbbd simulate`, which moves robots of any make.
    #[arg(long, value_parser = value::one_of(&Controller::ALL, Controller::name), default_value = Controller::Krc4.name())]
    controller: Controller,
    /// Replace files that exist in DIR [default: refuse].
    #[arg(long)]
    replace: bool,
}

pub(crate) fn run(args: &KrlArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let KrlArgs { plan, out: directory, sync, server, controller, replace } = args;
    let (language, controller) = (Some(Language::Krl), Some(*controller));
    let (plan, directory) = (plan.clone(), directory.clone());
    program::run(
        &program::ProgramArgs {
            plan,
            language,
            out: directory,
            sync: *sync,
            server: *server,
            controller,
            replace: *replace,
        },
        out,
    )
}
