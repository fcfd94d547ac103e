//! `dbbd explain`.

use serde::Serialize;

use super::{CommandOutcome, CommandOutput};
use crate::catalogue;
use crate::cli::CliFinding;
use dbbd_model::diagnostic::{Diagnostic, Entry, Input};

/// Explain a code that dbbd printed, such as E0101: its cause and its cure.
///
/// Every error, warning and note has a stable code. Without a code, lists all of them.
#[derive(clap::Args)]
pub(crate) struct ExplainArgs {
    /// The code.
    code: Option<String>,
    /// Print all codes as the page docs/troubleshooting.md.
    #[arg(long, conflicts_with = "code", hide = true)]
    page: bool,
}

#[derive(Serialize)]
struct ExplainedCode {
    code: &'static str,
    title: &'static str,
    cause: &'static str,
    cure: &'static str,
    sentences: &'static [&'static str],
    asks: &'static [Input],
}

impl From<&Entry> for ExplainedCode {
    fn from(entry: &Entry) -> Self {
        let &Entry { code, title, cause, cure, sentences, asks } = entry;
        Self { code: code.as_str(), title, cause, cure, sentences, asks }
    }
}

pub(super) fn run(args: &ExplainArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    if args.page {
        out.result(catalogue::page());
        return Ok(CommandOutcome::Done);
    }
    let Some(code) = &args.code else {
        for entry in catalogue::entries() {
            out.result(format!("{}  {}", entry.code, entry.title));
        }
        out.list(&catalogue::entries().map(ExplainedCode::from).collect::<Vec<_>>())?;
        return Ok(CommandOutcome::Done);
    };
    let wanted = code.to_uppercase();
    let Some(entry) = catalogue::entry(&wanted) else {
        let known = catalogue::entries().map(|entry| entry.code.as_str());
        return Err(Diagnostic::new(CliFinding::UnknownCode { code: wanted.clone() }).nearest(&wanted, known));
    };
    out.result(catalogue::explanation(entry).trim_end());
    out.document(&ExplainedCode::from(entry))?;
    Ok(CommandOutcome::Done)
}
