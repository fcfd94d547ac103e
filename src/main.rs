//! Parses the command line, runs one verb, turns its outcome into the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    dbbd::cli::main()
}
