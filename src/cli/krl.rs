//! `dbbd krl`.

use std::net::SocketAddrV4;
use std::path::PathBuf;

use serde_json::json;

use super::{Outcome, Output};
use crate::base::files;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::krl::{self, Controller, Options};
use crate::recording::run;

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
    /// plan's knocks in the length alone, no output is set.
    /// `ekrl`: by telegrams over EthernetKRL (KR C4 and later) to `dbbd acquire --ekrl`.
    #[arg(long, value_enum, default_value_t = Sync::Output)]
    sync: Sync,
    /// For `ekrl`: where dbbd listens, as the controller's network sees it (IPv4).
    #[arg(long, value_name = "ADDR:PORT", required_if_eq("sync", "ekrl"))]
    server: Option<SocketAddrV4>,
    /// The controller that the program is for.
    #[arg(long, value_enum, default_value_t = Controller::Krc4)]
    controller: Controller,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Sync {
    Marker,
    Output,
    Ekrl,
}

pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let plan = run::read_plan(&args.plan)?;
    let sync = match args.sync {
        Sync::Marker => krl::Sync::Marker,
        Sync::Output => krl::Sync::Output,
        Sync::Ekrl => krl::Sync::Ekrl { server: args.server.ok_or(ProgramFinding::NoServer)? },
    };
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
    out.document(&json!({ "plan": plan.header.hash, "files": written }))?;
    out.result(format!("{} files in {}; start DBB_MAIN", written.len(), args.out.display()));
    out.progress("not proven on a real controller: run it first in T1, slowly, without the bar");
    Ok(Outcome::Done)
}
