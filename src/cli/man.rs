//! `dbbd man`: the manual page, on stdout.

use std::io;

use clap::{Command, CommandFactory};

use super::{Cli, Outcome, Output, Verdict};
use crate::catalogue::CliFinding;

/// Print the manual page, with every verb.
///
/// To read it: `dbbd man | man -l -`.
#[derive(clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args, _out: &Output) -> Verdict {
    let mut command = Cli::command();
    command.build();
    let mut page = Vec::new();
    let written = render(&command, &mut page).and_then(|()| io::Write::write_all(&mut io::stdout(), &page));
    match written {
        // A pager that was left early is no failure.
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(CliFinding::NoOutput { why: error.to_string() }.into())
        }
        _ => Ok(Outcome::Done),
    }
}

/// A command's page, and after it those of the commands below it.
fn render(command: &Command, page: &mut Vec<u8>) -> io::Result<()> {
    clap_mangen::Man::new(command.clone()).render(page)?;
    command
        .get_subcommands()
        .filter(|below| below.get_name() != "help")
        .try_for_each(|below| render(below, page))
}
