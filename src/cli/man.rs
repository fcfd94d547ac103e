//! `dbbd man`: the manual page, on stdout.

use std::io;

use clap::CommandFactory;

use super::{Cli, Outcome, Output, Verdict};

/// Prints the manual page, with every verb, on stdout: `dbbd man | man -l -`.
#[derive(clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args, _out: &Output) -> Verdict {
    let mut command = Cli::command();
    command.build();
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    for verb in command.get_subcommands() {
        clap_mangen::Man::new(verb.clone()).render(&mut page)?;
    }
    match io::Write::write_all(&mut io::stdout(), &page) {
        // A pager that was left early is no failure.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(Outcome::Done),
        written => Ok(written.map(|()| Outcome::Done)?),
    }
}
