//! `dbbd completions`.

use clap::CommandFactory;
use clap_complete::Shell;

use super::{Cli, CommandOutcome, CommandOutput};
use dbbd_model::diagnostic::Diagnostic;

/// Print the completion script of a shell on stdout.
///
/// To install it for bash: `sudo sh -c "dbbd completions bash > /etc/bash_completion.d/dbbd"`.
#[derive(clap::Args)]
pub(crate) struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

pub(crate) fn run(args: &CompletionsArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "dbbd", &mut text);
    out.text(&text);
    Ok(CommandOutcome::Done)
}
