//! This program as a child process.

use std::io;
use std::process::{Command, Stdio};

/// What a child process is to know of the environment; the rest is no business of a command of ours.
const INHERITED: [&str; 9] =
    ["PATH", "HOME", "LANG", "LC_ALL", "TZ", "TMPDIR", "NO_COLOR", "RUST_BACKTRACE", "SystemRoot"];

/// A command that runs this very program, also where its file was replaced since this process began. Its standard
/// input is empty, and of the environment it has only what it needs.
///
/// # Errors
/// When the system does not name the program.
pub fn own() -> io::Result<Command> {
    // The child still runs this program when it follows the link.
    #[cfg(target_os = "linux")]
    let program = "/proc/self/exe";
    #[cfg(not(target_os = "linux"))]
    let program = std::env::current_exe()?;
    let mut command = Command::new(program);
    let kept = INHERITED.iter().filter_map(|name| Some((name, std::env::var_os(name)?)));
    command.env_clear().envs(kept).stdin(Stdio::null());
    Ok(command)
}
