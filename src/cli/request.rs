//! `dbbd request`.

use std::io;

use super::{CommandOutcome, CommandOutput, answers};
use dbbd_job::request::{Request, RequestFinding};
use dbbd_model::diagnostic::Diagnostic;

/// Where the request is, as a message names it.
const STDIN: &str = "stdin";

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
    io::stdin()
        .read_line(&mut line)
        .map_err(|error| Diagnostic::file(STDIN, RequestFinding::NotARequest { why: error.to_string() }))?;
    Request::from_json(STDIN, &line)
}
