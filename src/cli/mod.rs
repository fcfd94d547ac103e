//! The command line: one file per verb. The only place that prints.

mod acquire;
#[cfg(unix)]
mod child;
mod circle;
mod compensate;
mod completions;
#[cfg(unix)]
mod demo;
mod export;
mod files;
mod identify;
mod import;
mod info;
mod krl;
mod man;
mod output;
mod pass;
mod plan;
mod ports;
mod protocols;
mod recover;
mod robots;
mod run;
mod serve;
#[cfg(unix)]
mod simulate;
mod sync;
mod temperature;

use std::error::Error;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

pub(crate) use output::Output;

/// Calibrates an industrial robot with a telescoping double ball-bar.
#[derive(Parser)]
#[command(name = "dbbd", version, max_term_width = 100, propagate_version = true)]
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
    #[arg(short, long, global = true)]
    verbose: bool,
    /// Say nothing but errors on stderr.
    #[arg(long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Print the result as one JSON document on stdout, and nothing else there.
    #[arg(long, global = true)]
    json: bool,
    /// Exit with 1 instead of 3 when there is a loss or a doubt.
    #[arg(long, global = true)]
    strict: bool,
}

#[derive(Subcommand)]
enum Verb {
    /// Plan circles from a job: poses, checks, time code.
    Plan(plan::Args),
    /// Write the KRL programs of a plan.
    Krl(krl::Args),
    /// Execute a KRL program on a simulated robot with a virtual ball-bar on a pty.
    #[cfg(unix)]
    Simulate(simulate::Args),
    /// Read the bar over its serial line into a capture.
    Acquire(acquire::Args),
    /// Match the lengths of a capture to the commanded poses.
    Sync(sync::Args),
    /// Identify the robot's parameters from lengths.
    Identify(identify::Args),
    /// Evaluate circular tests by the quantities of ISO 230-4.
    Circle(circle::Args),
    /// Correct the points of a program for an identified robot.
    Compensate(compensate::Args),
    /// Serve the live page and the HTTP API for one bar.
    Serve(serve::Args),
    /// Run the whole job with no hardware.
    #[cfg(unix)]
    Demo(demo::Args),
    /// Make a capture of a trace that other software recorded.
    Import(import::Args),
    /// Show a capture on one screen.
    Info(info::Args),
    /// Restore every whole record of a damaged capture.
    Recover(recover::Args),
    /// Write a capture's samples, raw bytes, events and gaps as CSV, or as MCAP.
    Export(export::Args),
    /// List, show or check robots.
    Robots(robots::Args),
    /// List, show or check protocol definitions.
    Protocols(protocols::Args),
    /// List the serial ports.
    Ports(ports::Args),
    /// Print shell completions.
    Completions(completions::Args),
    /// Print the manual page.
    Man(man::Args),
}

/// How a verb that did not fail ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done: exit code 0.
    Done,
    /// Done, with a loss or a doubt that the user must see: exit code 3.
    Doubt,
}

/// A verb's result; the error is what the user reads on stderr before exit code 1.
pub(crate) type Verdict = Result<Outcome, Box<dyn Error>>;

/// Runs the program.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let out = Output::new(cli.common);
    let verdict = match &cli.verb {
        Verb::Plan(args) => plan::run(args, &out),
        Verb::Krl(args) => krl::run(args, &out),
        #[cfg(unix)]
        Verb::Simulate(args) => simulate::run(args, &out),
        Verb::Acquire(args) => acquire::run(args, &out),
        Verb::Sync(args) => sync::run(args, &out),
        Verb::Identify(args) => identify::run(args, &out),
        Verb::Circle(args) => circle::run(args, &out),
        Verb::Compensate(args) => compensate::run(args, &out),
        Verb::Serve(args) => serve::run(args, &out),
        #[cfg(unix)]
        Verb::Demo(args) => demo::run(args, &out),
        Verb::Import(args) => import::run(args, &out),
        Verb::Info(args) => info::run(args, &out),
        Verb::Recover(args) => recover::run(args, &out),
        Verb::Export(args) => export::run(args, &out),
        Verb::Robots(args) => robots::run(args, &out),
        Verb::Protocols(args) => protocols::run(args, &out),
        Verb::Ports(args) => ports::run(args, &out),
        Verb::Completions(args) => completions::run(args, &out),
        Verb::Man(args) => man::run(args, &out),
    };
    output::finish(&out, verdict)
}
