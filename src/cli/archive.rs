//! `dbbd archive`.

use std::path::PathBuf;

use super::{Outcome, Output, tolerance, within};
use crate::catalogue::CliFinding;
use crate::diagnostic::Diagnostic;

#[cfg(feature = "archive")]
mod fleet;
#[cfg(feature = "archive")]
mod serve;
#[cfg(feature = "archive")]
mod verbs;
#[cfg(feature = "archive")]
mod work;

/// Keep the runs of many cells in one archive.
///
/// A database (SQLite or PostgreSQL) has who measured what and when, a store (a directory or S3) the files, each under its
/// SHA-256. Passwords are in files or in the environment, never in an address. More: docs/how-to/archive.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The database: `sqlite:FILE` or `postgres://USER@HOST/DATABASE[?sslmode=verify-full&sslrootcert=FILE]`
    /// [default: DBBD_ARCHIVE].
    #[arg(long, value_name = "URL", global = true)]
    archive: Option<String>,
    /// The store: `file:DIRECTORY` or `s3://BUCKET[/PREFIX]` [default: DBBD_STORE].
    #[arg(long, value_name = "URL", global = true)]
    store: Option<String>,
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Make a new archive, or bring an older one to the form of this version.
    Init,
    /// Store runs: captures, directories of runs, or a directory of these. A run that is held already is stored once.
    Push {
        /// What to store; with --spool it may be missing.
        #[arg(value_name = "RUN", required_unless_present = "spool")]
        runs: Vec<PathBuf>,
        /// Where runs wait while the archive cannot be reached; what waits there is sent first.
        #[arg(long, value_name = "DIR")]
        spool: Option<PathBuf>,
    },
    /// List runs, the newest first.
    List(#[command(flatten)] Choice),
    /// Show a run: what it is, its files and results.
    Show {
        /// The first digits of the SHA-256 of its capture.
        #[arg(value_name = "SHA256")]
        run: String,
    },
    /// Write the files of a run into a directory, each as it was stored.
    Get {
        /// The first digits of the SHA-256 of its capture.
        #[arg(value_name = "SHA256")]
        run: String,
        /// The directory.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Identify runs that wait for it; any number of workers share the work.
    Worker {
        /// End when no job is left.
        #[arg(long)]
        until_empty: bool,
        /// How long this worker may be silent before its job is another's, s [default: 30].
        #[arg(long, value_name = "S", value_parser = lease)]
        lease: Option<f64>,
    },
    /// Identify a selection anew with this version and these settings, and compare the results with those before.
    Reprocess {
        #[command(flatten)]
        choice: Choice,
        /// As for `dbbd identify`.
        #[arg(long, value_name = "LIST")]
        estimate: Option<String>,
        /// As for `dbbd identify`.
        #[arg(long, value_name = "LIST")]
        hold: Option<String>,
        /// As for `dbbd identify`: none, datasheet or posterior.
        #[arg(long, value_name = "PRIOR")]
        prior: Option<String>,
        /// As for `dbbd identify`: joints or geometric.
        #[arg(long, value_name = "MODEL")]
        model: Option<String>,
        /// Leave the work to the workers that run, and compare nothing.
        #[arg(long)]
        ask_only: bool,
    },
    /// Estimate robots, bars and types of robots from all results together: fleet.json with each bar's offset, drift and
    /// jumps, and for each type a robot file that is the prior of a new robot (`dbbd identify --robot FILE`).
    Fleet {
        #[command(flatten)]
        choice: Choice,
        /// The directory.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Serve the page of the plant: robots with check, decision, due date and drift, bars, runs with their reports.
    Serve {
        /// Where to listen; other computers may ask only with --token-file.
        #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:8231")]
        listen: String,
        /// A file with the token that whoever asks must know.
        #[arg(long, value_name = "FILE")]
        token_file: Option<PathBuf>,
        /// A name under which the page is reached, beside its address; may be given several times.
        #[arg(long, value_name = "NAME")]
        host: Vec<String>,
        /// A robot is checked again after so many days.
        #[arg(long, value_name = "DAYS", default_value = "180", value_parser = interval)]
        interval: f64,
        /// Mean position error that a robot must not reach; its drift is led on to it.
        #[arg(long, value_name = "MM", value_parser = tolerance)]
        limit: Option<f64>,
    },
    /// Write the tables runs and results of a selection.
    Export {
        #[command(flatten)]
        choice: Choice,
        /// The form of the tables: runs.csv and results.csv, or runs.parquet and results.parquet.
        #[arg(long, value_enum, default_value = "csv")]
        format: TableFormat,
        /// The directory.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

/// The form of an exported table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum TableFormat {
    Csv,
    Parquet,
}

/// Which runs; all that is given must hold.
#[derive(clap::Args)]
struct Choice {
    /// Serial number of the robot.
    #[arg(long, value_name = "SERIAL")]
    robot: Option<String>,
    /// Name of its type.
    #[arg(long = "type", value_name = "NAME")]
    kind: Option<String>,
    /// Serial number of the bar.
    #[arg(long, value_name = "SERIAL")]
    bar: Option<String>,
    /// Name of the cell.
    #[arg(long, value_name = "NAME")]
    cell: Option<String>,
    /// Measured on or after this date (YYYY-MM-DD), UTC.
    #[arg(long, value_name = "DATE")]
    since: Option<String>,
    /// Measured before this date.
    #[arg(long, value_name = "DATE")]
    until: Option<String>,
    /// A text that robot, type, bar, cell or operator contain.
    #[arg(long, value_name = "TEXT")]
    search: Option<String>,
    /// At most so many, the newest.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
}

/// How long a worker may be silent, s.
fn lease(text: &str) -> Result<f64, CliFinding> {
    within(text, [1.0, 86_400.0], "s")
}

/// How often a robot is checked.
fn interval(text: &str) -> Result<f64, CliFinding> {
    within(text, [1.0, 3650.0], "days")
}

#[cfg(feature = "archive")]
pub(crate) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    verbs::run(args, out)
}

#[cfg(not(feature = "archive"))]
pub(crate) fn run(_: &Args, _: &Output) -> Result<Outcome, Diagnostic> {
    Err(crate::catalogue::ArchiveFinding::NotBuilt.into())
}
