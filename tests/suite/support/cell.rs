//! The binary, run in a directory of a cell.

use std::ffi::OsStr;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output};

pub(crate) use super::simulated_cell::*;

/// Runs the binary in a directory.
pub(crate) fn dbbd(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dbbd")).args(args).current_dir(dir).output().unwrap()
}

/// Standard error of a run as text.
pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// What a script of tests/clients prints; `None` where something that it needs is not installed, which is said.
pub(crate) fn client<'a>(script: &str, args: impl Iterator<Item = &'a OsStr>) -> Option<String> {
    /// Exit code of a script where something is not installed.
    const SKIPPED: i32 = 77;
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients").join(script);
    let run = Command::new("python3").arg(path).args(args).output();
    // Straight to stderr, past the test harness, which keeps what a test that passes prints.
    let mut loud = std::io::stderr();
    let mut skip = |why: &str| writeln!(loud, "SKIPPED: {script}: {why}").unwrap();
    let Ok(run) = run else {
        skip("there is no python3");
        return None;
    };
    let [said, errors] = [run.stdout, run.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    match run.status.code() {
        Some(0) => Some(said),
        Some(SKIPPED) => {
            skip(&said);
            None
        }
        code => panic!("{script}: {code:?}\n{said}\n{errors}"),
    }
}

/// The codes that a run of dbbd printed on stderr, in order.
pub(crate) fn codes(output: &Output) -> Vec<String> {
    let text = String::from_utf8_lossy(&output.stderr);
    let labelled = |line: &str| {
        let rest = ["error[", "warning[", "note["].into_iter().find_map(|label| line.strip_prefix(label))?;
        Some(rest.split_once(']')?.0.to_owned())
    };
    text.lines().filter_map(labelled).collect()
}
