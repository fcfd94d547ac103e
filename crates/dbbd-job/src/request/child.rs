//! Computes a request in a child process, so that a failure or a lack of memory there does not end this process.

use std::io::{self, Write as _};
use std::process::{Child, ChildStdin, Command, Stdio};

use super::{AnswerRecord, Request};
use crate::child_process;

/// The command with which this program computes a request of another process.
const VERB: &str = "request";

/// A child process that computes a request. It ends when `stdin` is dropped.
pub struct RequestChild {
    pub child: Child,
    pub stdin: Option<ChildStdin>,
}

impl RequestChild {
    /// Starts the child. `set_up` sets the directory at which the paths of the request start, and the targets of
    /// stdout, which gets the answer, and of stderr, which gets the text of the command and its progress.
    pub fn start(request: &Request, set_up: impl FnOnce(&mut Command)) -> io::Result<Self> {
        let mut command = child_process::own()?;
        command.arg(VERB).stdout(Stdio::piped()).stderr(Stdio::piped());
        set_up(&mut command);
        let mut child = command.spawn()?;
        let mut stdin = child.stdin.take();
        if let Some(stdin) = &mut stdin {
            let line = serde_json::to_string(request)?;
            stdin.write_all(format!("{line}\n").as_bytes())?;
        }
        Ok(Self { child, stdin })
    }
}

/// The answer of a child process; `None` if the child ended before it answered.
pub fn read_answer(stdout: &str) -> Option<AnswerRecord> {
    serde_json::from_str(stdout).ok()
}
