//! `dbbd man`.

use dbbd_model::base::InternalFinding;
use std::io;

use clap::{Command, CommandFactory};

use super::{Cli, CommandOutcome, CommandOutput};
use dbbd_model::diagnostic::Diagnostic;

/// Print the manual page of all commands on stdout.
///
/// To read it: `dbbd man | man -l -`.
#[derive(clap::Args)]
pub(crate) struct ManArgs {}

pub(crate) fn run(_args: &ManArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let mut command = Cli::command();
    command.build();
    let mut page = Vec::new();
    render(&command, &mut page).map_err(|error| InternalFinding::NoOutput { why: error.to_string() })?;
    out.text(&page);
    Ok(CommandOutcome::Done)
}

/// Writes the page of a command, and then those of its subcommands.
fn render(command: &Command, page: &mut Vec<u8>) -> io::Result<()> {
    clap_mangen::Man::new(command.clone()).render(page)?;
    let mut subcommands =
        command.get_subcommands().filter(|command| command.get_name() != "help" && !command.is_hide_set());
    subcommands.try_for_each(|command| render(command, page))
}
