//! `dbbd krl`.

use std::net::SocketAddrV4;
use std::path::PathBuf;

use super::program::{self, Sync};
use super::{Outcome, Output};
use crate::diagnostic::Diagnostic;
use crate::program::Language;
use crate::program::krl::Controller;

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

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let Args { plan, out: directory, sync, server, controller } = args;
    let (sync, server, controller) = (*sync, *server, Some(*controller));
    let language = Some(Language::Krl);
    program::write(&program::Request { plan, out: directory, sync, server, language, controller }, out)
}
