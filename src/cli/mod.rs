//! The command line: one file per verb. The only place that prints.

mod acquire;
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
mod output;
mod plan;
mod ports;
mod predict;
mod program;
mod protocols;
mod recover;
mod robots;
mod serve;
mod simulate;
mod sync;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use crate::base;
use crate::catalogue::{CliFinding, ServiceFinding};
use crate::diagnostic::Diagnostic;
pub(crate) use output::Output;

/// Heading of the options that every verb takes.
const EVERYWHERE: &str = "Options of every command";

/// Shown below the list of commands.
const EXITS: &str = "Exit codes: 0 done; 1 failed or refused, with the reason on stderr; 2 wrong usage; 3 done, with a \
loss or a doubt that you must see; 4 of `check`: failed or changed. Results go to stdout, all else to stderr; NO_COLOR is honoured. `dbbd explain \
CODE` explains the code of a message.";

/// Calibrates an industrial robot with a telescoping double ball-bar.
#[derive(Parser)]
#[command(name = "dbbd", version = crate::provenance::VERSION, max_term_width = 100, propagate_version = true, after_help = EXITS)]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(subcommand)]
    verb: Verb,
}

/// Options of every verb.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct Common {
    /// Say more on stderr.
    #[arg(short, long, global = true, help_heading = EVERYWHERE)]
    verbose: bool,
    /// Say nothing but errors on stderr.
    #[arg(long, global = true, conflicts_with = "verbose", help_heading = EVERYWHERE)]
    quiet: bool,
    /// Print the result as one JSON document on stdout, and nothing else there.
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    json: bool,
    /// Exit with 1 instead of 3 when there is a loss or a doubt.
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    strict: bool,
    /// End when the standard input does: whoever started this command is gone.
    #[arg(long, global = true, hide = true)]
    until_stdin_closes: bool,
}

/// The verbs; the text of each is that of its `Args`, and the README's section "Commands" too.
#[derive(Subcommand)]
enum Verb {
    Plan(plan::Args),
    Krl(krl::Args),
    Program(program::Args),
    Simulate(simulate::Args),
    Bar(bar::Args),
    Acquire(acquire::Args),
    Sync(sync::Args),
    Identify(identify::Args),
    Predict(predict::Args),
    Circle(circle::Args),
    Check(check::Args),
    Compare(compare::Args),
    Certificate(certificate::Args),
    Compensate(compensate::Args),
    Serve(serve::Args),
    Archive(archive::Args),
    Demo(demo::Args),
    Import(import::Args),
    Info(info::Args),
    Recover(recover::Args),
    Export(export::Args),
    Explain(explain::Args),
    Robots(robots::Args),
    Protocols(protocols::Args),
    Ports(ports::Args),
    Completions(completions::Args),
    Man(man::Args),
}

/// How a verb that did not fail ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done: exit code 0.
    Done,
    /// Done, with a loss or a doubt that the user must see: exit code 3.
    Doubt,
    /// Done, and what was checked fails: exit code 4.
    Failed,
}

/// A positive number of the command line.
fn positive(text: &str) -> Result<f64, CliFinding> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err(CliFinding::NotPositive),
    }
}

/// A number of the command line between two others.
fn within(text: &str, [least, most]: [f64; 2], unit: &'static str) -> Result<f64, CliFinding> {
    let inside = positive(text).ok().filter(|value| (least..=most).contains(value));
    inside.ok_or(CliFinding::Outside { least, most, unit })
}

/// A length of the command line that is small by its nature, mm.
fn fine(text: &str, most_mm: f64) -> Result<f64, CliFinding> {
    positive(text).ok().filter(|mm| *mm <= most_mm).ok_or(CliFinding::NotFine { most_mm })
}

/// The standard uncertainty of a bar's length, mm.
fn bar_u(text: &str) -> Result<f64, CliFinding> {
    // No length of a bar is known better: 2e-6 is one in metres.
    within(text, [5e-5, 0.5], "mm")
}

/// A tolerance of a position or of a circular deviation, mm.
fn tolerance(text: &str) -> Result<f64, CliFinding> {
    fine(text, 20.0)
}

/// The standard deviation of a length, mm.
fn length_sd(text: &str) -> Result<f64, CliFinding> {
    fine(text, 1.0)
}

/// The command line; a negative number is the value of its option, which says what it takes.
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

/// Runs the program; the first of the arguments is its name.
pub fn main_with(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    crate::daemon::abort_on_panic();
    let parsed =
        command().try_get_matches_from(arguments).and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(usage) => return output::wrong_usage(&usage),
    };
    let out = Output::new(cli.common);
    if cli.common.until_stdin_closes
        && let Err(error) = base::program::end_with_stdin()
    {
        let finding = ServiceFinding::NoSystem { why: error.to_string() };
        return output::finish(&out, Err(Diagnostic::new(finding)));
    }
    let ended = match &cli.verb {
        Verb::Plan(args) => plan::run(args, &out),
        Verb::Krl(args) => krl::run(args, &out),
        Verb::Program(args) => program::run(args, &out),
        Verb::Simulate(args) => simulate::run(args, &out),
        Verb::Bar(args) => bar::run(args, &out),
        Verb::Acquire(args) => acquire::run(args, &out),
        Verb::Sync(args) => sync::run(args, &out),
        Verb::Identify(args) => identify::run(args, &out),
        Verb::Predict(args) => predict::run(args, &out),
        Verb::Circle(args) => circle::run(args, &out),
        Verb::Check(args) => check::run(args, &out),
        Verb::Compare(args) => compare::run(args, &out),
        Verb::Certificate(args) => certificate::run(args, &out),
        Verb::Compensate(args) => compensate::run(args, &out),
        Verb::Serve(args) => serve::run(args, &out),
        Verb::Archive(args) => archive::run(args, &out),
        Verb::Demo(args) => demo::run(args, &out),
        Verb::Import(args) => import::run(args, &out),
        Verb::Info(args) => info::run(args, &out),
        Verb::Recover(args) => recover::run(args, &out),
        Verb::Explain(args) => explain::run(args, &out),
        Verb::Export(args) => export::run(args, &out),
        Verb::Robots(args) => robots::run(args, &out),
        Verb::Protocols(args) => protocols::run(args, &out),
        Verb::Ports(args) => ports::run(args, &out),
        Verb::Completions(args) => completions::run(args, &out),
        Verb::Man(args) => man::run(args, &out),
    };
    output::finish(&out, ended)
}
