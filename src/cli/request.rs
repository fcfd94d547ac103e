//! `dbbd request`.

use std::io;

use super::{CommandOutcome, CommandOutput, answers};
use crate::cli::CliFinding;
use dbbd_job::request::Request;
use dbbd_model::diagnostic::Diagnostic;

/// Compute a request for another process of this program.
///
/// Reads a request as JSON from the first line of stdin, and writes its answer as JSON to stdout. Everything that the command of
/// the request prints goes to stderr.
#[derive(clap::Args)]
#[command(hide = true)]
pub(crate) struct RequestArgs {}

pub(super) fn run(out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let request = read()?;
    // Only what follows the request shows that the parent process has ended.
    out.end_with_stdin()?;
    let answer = request.answer(out);
    out.answer(&answer)?;
    answers::show(&request, answer, out)
}

fn read() -> Result<Request, Diagnostic> {
    let mut line = String::new();
    let read = io::stdin().read_line(&mut line).map_err(|error| error.to_string());
    let request = read.and_then(|_| serde_json::from_str(&line).map_err(|error| error.to_string()));
    request.map_err(|why| Diagnostic::file("stdin", CliFinding::NotARequest { why }))
}
