//! Starts this program as a child process.

use std::ffi::OsString;
use std::io;
use std::process::{Command, Stdio, exit};
use std::sync::OnceLock;
use std::thread;

/// The environment variables that a child process inherits.
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

/// If this variable is set, a command reports its progress in lines that begin with [`PROGRESS`].
pub const PROGRESS_VARIABLE: &str = "DBBD_PROGRESS";
pub const PROGRESS: &str = "done, per cent:";

/// The option that makes a command end when its standard input closes.
pub const UNTIL_STDIN_CLOSES: &str = "--until-stdin-closes";

/// The command line that starts this program if it is not an executable file, as in the Python package.
static LAUNCHER: OnceLock<Vec<OsString>> = OnceLock::new();

/// Sets the command line (program and first arguments) that starts child processes. Only the first call counts.
pub fn launch_by(command: Vec<OsString>) {
    LAUNCHER.get_or_init(|| command);
}

/// A command that runs this program. The child ends when its standard input closes, which happens when this process ends
/// for any reason; keep the pipe until the child has ended.
pub fn own() -> io::Result<Command> {
    // The link still names this program after its file was replaced.
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

/// Ends this process when its standard input closes: its parent has ended.
pub fn end_with_stdin() -> io::Result<()> {
    let watch = || {
        let _ = io::copy(&mut io::stdin(), &mut io::sink());
        exit(1);
    };
    thread::Builder::new().name("stdin".into()).spawn(watch).map(drop)
}
