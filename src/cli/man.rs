//! `dbbd man`: the manual page, on stdout.

use std::io;

use clap::{Command, CommandFactory};

use super::{Cli, Outcome, Output};
use crate::catalogue::CliFinding;
use crate::diagnostic::Diagnostic;

/// Print the manual page, with every verb.
///
/// To read it: `dbbd man | man -l -`.
#[derive(clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    let mut command = Cli::command();
    command.build();
    let mut page = Vec::new();
    render(&command, &mut page).map_err(|error| CliFinding::NoOutput { why: error.to_string() })?;
    out.text(&page);
    Ok(Outcome::Done)
}

/// A command's page, and after it those of the commands below it.
fn render(command: &Command, page: &mut Vec<u8>) -> io::Result<()> {
    clap_mangen::Man::new(command.clone()).render(page)?;
    command
        .get_subcommands()
        .filter(|below| below.get_name() != "help")
        .try_for_each(|below| render(below, page))
}
