//! The program `dbbd`. The command line is in `dbbd::cli`.

use std::process::ExitCode;

fn main() -> ExitCode {
    dbbd::cli::main()
}
