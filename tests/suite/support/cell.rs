//! The binary, run in a directory of a cell.

use std::ffi::OsStr;
use std::path::Path;
use std::process::{Command, Output};

pub(crate) use super::simulated_cell::*;

/// The file of the KUKA KR 60 HA with the tool ball of the paper.
pub(crate) const KR60HA: &str =
    concat!("tool.ball_mm = [30.0, 20.0, 10.0]\n", include_str!("../../../robots/kr60ha.toml"));

/// Runs the binary in a directory.
pub(crate) fn dbbd(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dbbd")).args(args).current_dir(dir).output().unwrap()
}

/// Standard error of a run as text.
pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// What a script of tests/clients prints. It fails where something that it needs is not installed.
pub(crate) fn client<'a>(script: &str, args: impl Iterator<Item = &'a OsStr>) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients").join(script);
    let run = Command::new("python3").arg(path).args(args).output().expect("python3 is installed");
    let said = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(run.status.success(), "{script}: {:?}\n{said}\n{}", run.status.code(), stderr(&run));
    said
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
