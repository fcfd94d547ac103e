//! This program as a child process.

use std::ffi::OsString;
use std::io;
use std::process::{Command, Stdio, exit};
use std::sync::OnceLock;
use std::thread;

/// What a child process is to know of the environment; the rest is no business of a command of ours.
const INHERITED: [&str; 11] = [
    "PATH",
    "HOME",
    "LANG",
    "LC_ALL",
    "TZ",
    "TMPDIR",
    "NO_COLOR",
    "RUST_BACKTRACE",
    "SystemRoot",
    "TEMP",
    "TMP",
];

/// The variable that makes a command of ours report how much of it is done, a line each: this word and the per cent.
pub const PROGRESS_VARIABLE: &str = "DBBD_PROGRESS";
pub const PROGRESS: &str = "done, per cent:";

/// The option that ends a command of ours with its standard input.
pub const UNTIL_STDIN_CLOSES: &str = "--until-stdin-closes";

/// How this program is started where it is no file of its own.
static LAUNCHER: OnceLock<Vec<OsString>> = OnceLock::new();

/// Children are started with this command line (program and first arguments) from now on; the first call counts.
pub fn launch_by(command: Vec<OsString>) {
    LAUNCHER.get_or_init(|| command);
}

/// A command that runs this very program, also where its file was replaced since this process began. It ends with its
/// standard input, whose other end closes with this process, however that ends; keep it until the child has ended. Of
/// the environment it has only what it needs.
pub fn own() -> io::Result<Command> {
    // The child still runs this program when it follows the link.
    #[cfg(target_os = "linux")]
    let program = "/proc/self/exe";
    #[cfg(not(target_os = "linux"))]
    let program = std::env::current_exe()?;
    let mut command = match LAUNCHER.get().and_then(|launcher| launcher.split_first()) {
        Some((program, first)) => {
            let mut command = Command::new(program);
            command.args(first);
            command
        }
        None => Command::new(program),
    };
    let kept = INHERITED.iter().filter_map(|name| Some((name, std::env::var_os(name)?)));
    command.arg(UNTIL_STDIN_CLOSES).env_clear().envs(kept).stdin(Stdio::piped());
    Ok(command)
}

/// Ends this process when its standard input ends: whoever started it is gone.
pub fn end_with_stdin() -> io::Result<()> {
    let watch = || {
        let _ = io::copy(&mut io::stdin(), &mut io::sink());
        exit(1);
    };
    thread::Builder::new().name("stdin".into()).spawn(watch).map(drop)
}
