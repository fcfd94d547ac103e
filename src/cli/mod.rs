//! The command line: one file per command. The only module that prints.

mod catalogue;
pub use catalogue::CliFinding;

mod acquire;
mod answers;
mod archive;
mod artefact;
mod bar;
mod certificate;
mod check;
mod child;
mod circle;
mod compare;
mod compensate;
mod completions;
mod demo;
mod explain;
mod export;
mod identify;
mod import;
mod info;
mod krl;
mod man;
mod options;
mod output;
mod plan;
mod ports;
mod predict;
mod program;
mod protocols;
mod recover;
mod request;
mod robots;
mod serve;
mod simulate;
mod sync;
mod value;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use dbbd_model::diagnostic::Diagnostic;
pub(crate) use options::{long_options, options_of};
pub(crate) use output::CommandOutput;

/// The heading of the options that every command takes.
const EVERYWHERE: &str = "Options of every command";

/// Printed below the list of commands.
const EXITS: &str = "Exit codes: 0 done; 1 failed or refused, with the reason on stderr; 2 wrong usage; 3 done, with a \
loss or a warning that you must see; 4 `check` only: the robot fails or has changed. Results go to stdout, everything else to \
stderr. NO_COLOR is honoured. `dbbd explain CODE` explains the code of a message.";

/// Calibrates an industrial robot with a telescoping double ball-bar.
#[derive(Parser)]
#[command(name = "dbbd", version = dbbd_job::artefact::VERSION, max_term_width = 100, propagate_version = true, after_help = EXITS)]
struct Cli {
    #[command(flatten)]
    common: CommonOptions,
    #[command(subcommand)]
    verb: Verb,
}

/// The options of every command.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct CommonOptions {
    /// Print more on stderr.
    #[arg(short, long, global = true, help_heading = EVERYWHERE)]
    verbose: bool,
    /// Print only warnings and errors on stderr.
    #[arg(long, global = true, conflicts_with = "verbose", help_heading = EVERYWHERE)]
    quiet: bool,
    /// Print the result as one JSON document on stdout, and nothing else there.
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    json: bool,
    /// Exit with 1 instead of 3 if there is a loss or a warning.
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    strict: bool,
    /// End when the standard input closes, because the parent process has ended.
    #[arg(long, global = true, hide = true)]
    until_stdin_closes: bool,
}

/// The commands. The doc comment of each `Args` is the help text, and the text of docs/reference/commands.md.
#[derive(Subcommand)]
enum Verb {
    Plan(plan::PlanArgs),
    Krl(krl::KrlArgs),
    Program(program::ProgramArgs),
    Simulate(simulate::SimulateArgs),
    Bar(bar::BarArgs),
    Acquire(acquire::AcquireArgs),
    Sync(sync::SyncArgs),
    Identify(identify::IdentifyArgs),
    Predict(predict::PredictArgs),
    Circle(circle::CircleArgs),
    Check(check::CheckArgs),
    Compare(compare::CompareArgs),
    Certificate(certificate::CertificateArgs),
    Compensate(compensate::CompensateArgs),
    Serve(serve::ServeArgs),
    Archive(archive::ArchiveArgs),
    Demo(demo::DemoArgs),
    Import(import::ImportArgs),
    Info(info::InfoArgs),
    Recover(recover::RecoverArgs),
    Request(request::RequestArgs),
    Export(export::ExportArgs),
    Explain(explain::ExplainArgs),
    Robots(robots::RobotsArgs),
    Protocols(protocols::ProtocolsArgs),
    Ports(ports::PortsArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
}

/// The outcome of a command that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CommandOutcome {
    /// Exit code 0.
    Done,
    /// A loss or a warning that the user must see: exit code 3.
    Warned,
    /// The robot that was checked fails or has changed: exit code 4.
    Failed,
}

/// The command line. A negative number after an option is its value, so that the value's parser reports its range.
fn command() -> clap::Command {
    let negative = |arg: clap::Arg| {
        let valued = arg.get_action().takes_values() && !arg.is_positional();
        if valued && !arg.is_allow_hyphen_values_set() { arg.allow_negative_numbers(true) } else { arg }
    };
    Cli::command().mut_subcommands(|verb| verb.mut_args(negative))
}

/// Runs the program with the arguments of this process.
pub fn main() -> ExitCode {
    main_with(std::env::args_os())
}

/// Runs the program. The first argument is its name.
pub fn main_with(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    crate::daemon::abort_on_panic();
    let mut command = command();
    let parsed = command.try_get_matches_from_mut(arguments).and_then(|matches| {
        let options = long_options(&command, &matches);
        Ok((Cli::from_arg_matches(&matches)?, options))
    });
    let (cli, options) = match parsed {
        Ok(parsed) => parsed,
        Err(usage) => return output::wrong_usage(&usage),
    };
    let is_request = matches!(cli.verb, Verb::Request(_));
    let out = CommandOutput::new(cli.common, options);
    let out = if is_request { out.of_request() } else { out };
    // `dbbd request` reads its request from stdin first.
    let begun = if is_request { Ok(()) } else { out.end_with_stdin() };
    output::finish(&out, begun.and_then(|()| run(&cli.verb, &out)))
}

/// Runs a command.
fn run(verb: &Verb, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    match verb {
        Verb::Plan(args) => answers::run(&plan::request(args), out),
        Verb::Krl(args) => krl::run(args, out),
        Verb::Program(args) => program::run(args, out),
        Verb::Simulate(args) => simulate::run(args, out),
        Verb::Bar(args) => bar::run(args, out),
        Verb::Acquire(args) => acquire::run(args, out),
        Verb::Sync(args) => sync::run(args, out),
        Verb::Identify(args) => answers::run(&identify::request(args), out),
        Verb::Predict(args) => predict::run(args, out),
        Verb::Circle(args) => answers::run(&circle::request(args), out),
        Verb::Check(args) => answers::run(&check::request(args), out),
        Verb::Compare(args) => compare::run(args, out),
        Verb::Certificate(args) => answers::run(&certificate::request(args), out),
        Verb::Compensate(args) => answers::run(&compensate::request(args), out),
        Verb::Serve(args) => serve::run(args, out),
        Verb::Archive(args) => archive::run(args, out),
        Verb::Demo(args) => demo::run(args, out),
        Verb::Import(args) => import::run(args, out),
        Verb::Info(args) => info::run(args, out),
        Verb::Recover(args) => recover::run(args, out),
        Verb::Request(_) => request::run(out),
        Verb::Explain(args) => explain::run(args, out),
        Verb::Export(args) => export::run(args, out),
        Verb::Robots(args) => robots::run(args, out),
        Verb::Protocols(args) => protocols::run(args, out),
        Verb::Ports(args) => ports::run(args, out),
        Verb::Completions(args) => completions::run(args, out),
        Verb::Man(args) => man::run(args, out),
    }
}
