//! `dbbd archive`.

use std::path::PathBuf;

use super::{CommandOutcome, CommandOutput, value};
use dbbd_model::diagnostic::Diagnostic;

#[cfg(feature = "archive")]
mod fleet;
#[cfg(feature = "archive")]
mod verbs;
#[cfg(feature = "archive")]
mod work;

/// Store the runs of many cells in one archive.
///
/// A database (SQLite or PostgreSQL) records who measured what and when; a store (a directory or S3) contains the files, each
/// under its SHA-256. Passwords are in files or in the environment, never in an address. More: docs/how-to/archive.md.
#[derive(clap::Args)]
pub(crate) struct ArchiveArgs {
    /// The database: `sqlite:FILE` or `postgres://USER@HOST/DATABASE[?sslmode=verify-full&sslrootcert=FILE]`
    /// [default: DBBD_ARCHIVE].
    #[arg(long, value_name = "URL", global = true)]
    archive: Option<String>,
    /// The store: `file:DIRECTORY` or `s3://BUCKET[/PREFIX]` [default: DBBD_STORE].
    #[arg(long, value_name = "URL", global = true)]
    store: Option<String>,
    #[command(subcommand)]
    what: ArchiveVerb,
}

#[derive(clap::Subcommand)]
enum ArchiveVerb {
    /// Create an archive, or migrate an older one to this version.
    Init,
    /// Store runs: captures, directories of runs, or a directory of these. A run that is in the archive is not stored again.
    Push {
        /// The runs; may be missing with --spool.
        #[arg(value_name = "RUN", required_unless_present = "spool")]
        runs: Vec<PathBuf>,
        /// Directory where runs wait while the archive cannot be reached. Those that wait are sent first.
        #[arg(long, value_name = "DIR")]
        spool: Option<PathBuf>,
    },
    /// List runs, the newest first.
    List(#[command(flatten)] RunChoice),
    /// Show a run, its files and its results.
    Show {
        /// The first digits of the SHA-256 of its capture.
        #[arg(value_name = "SHA256")]
        run: String,
    },
    /// Write the files of a run into a directory, as they were stored.
    Get {
        /// The first digits of the SHA-256 of its capture.
        #[arg(value_name = "SHA256")]
        run: String,
        /// The directory.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Identify the runs that wait for it. Any number of workers share the work.
    Worker {
        /// End when no job is left.
        #[arg(long)]
        until_empty: bool,
        /// How long this worker may be silent before another one takes its job, s, 1 to 86400 [default: 30].
        #[arg(long, value_name = "S", value_parser = value::lease)]
        lease: Option<f64>,
    },
    /// Identify a selection of runs again with this version and these settings, and compare the results with the earlier ones.
    Reprocess {
        #[command(flatten)]
        choice: RunChoice,
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
        /// Leave the work to the running workers, and do not compare.
        #[arg(long)]
        ask_only: bool,
    },
    /// Estimate robots, bars and robot types from all results together. Writes fleet.json with the offset, drift and jumps of
    /// each bar, and for each type a robot file that serves as the prior of a new robot (`dbbd identify --robot FILE`).
    Fleet {
        #[command(flatten)]
        choice: RunChoice,
        /// Directory for the files.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Serve the page of the plant: robots with their latest check, decision, due date and drift; bars; runs with reports.
    Serve {
        /// Address to listen on. Requests from other computers need --token-file.
        #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:8231")]
        listen: String,
        /// A file with the token that a client must present.
        #[arg(long, value_name = "FILE")]
        token_file: Option<PathBuf>,
        /// A host name of the page in addition to its address; may be given several times.
        #[arg(long, value_name = "NAME")]
        host: Vec<String>,
        /// The interval between the checks of a robot, days, 1 to 3650.
        #[arg(long, value_name = "DAYS", default_value = "180", value_parser = value::interval)]
        interval: f64,
        /// Limit of a robot's mean position error, mm. Its drift is extrapolated to it.
        #[arg(long, value_name = "MM", value_parser = value::tolerance)]
        limit: Option<f64>,
    },
    /// Write the tables of runs and results of a selection.
    Export {
        #[command(flatten)]
        choice: RunChoice,
        /// The format: runs.csv and results.csv, or runs.parquet and results.parquet.
        #[arg(long, value_enum, default_value = "csv")]
        format: TableFormat,
        /// Directory for the tables.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

/// The format of an exported table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum TableFormat {
    Csv,
    Parquet,
}

/// A selection of runs, which meet all conditions that are given.
#[derive(clap::Args)]
struct RunChoice {
    /// Serial number of the robot.
    #[arg(long, value_name = "SERIAL")]
    robot: Option<String>,
    /// Name of the robot type.
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
    /// Measured before this date (YYYY-MM-DD), UTC.
    #[arg(long, value_name = "DATE")]
    until: Option<String>,
    /// A text in the name of robot, type, bar, cell or operator.
    #[arg(long, value_name = "TEXT")]
    search: Option<String>,
    /// At most this many runs, the newest.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
}

#[cfg(feature = "archive")]
pub(crate) fn run(args: &ArchiveArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    verbs::run(args, out)
}

#[cfg(not(feature = "archive"))]
pub(crate) fn run(_: &ArchiveArgs, _: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    Err(dbbd_plant::ArchiveFinding::NotBuilt.into())
}
