//! The binary as a child process, and the simulated cell in which another one measures.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use dbbd_device::clock;
use dbbd_job::recording::capture::{Capture, read_capture};

/// The binary with arguments; what it prints is kept.
pub(crate) fn dbbd(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    command.args(args).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(crate) fn run(args: &[&str]) -> Output {
    dbbd(args).output().unwrap()
}

pub(crate) fn spawn(dir: &Path, args: &[&str]) -> Child {
    dbbd(args).current_dir(dir).spawn().unwrap()
}

/// Sends a signal by the system's own tool.
pub(crate) fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([format!("-{name}"), child.id().to_string()]).status().unwrap();
    assert!(status.success());
}

/// Ends a recording when its capture is as it should be, whatever time that takes on a busy machine; after half a minute in any
/// case.
pub(crate) fn end_when(child: Child, capture: &Path, done: impl Fn(&Capture) -> bool) -> Output {
    let begun = clock::now();
    let read = || read_capture(&std::fs::read(capture).unwrap_or_default());
    while !done(&read()) && clock::now().seconds_since(begun) < 30.0 {
        clock::sleep(0.05);
    }
    signal(&child, "INT");
    child.wait_with_output().unwrap()
}

/// `dbbd simulate`, which is ended with the test.
pub(crate) struct Simulator {
    child: Child,
    /// Where its bar is, by its first line.
    pub(crate) port: String,
}

impl Simulator {
    pub(crate) fn start(dir: &Path, args: &[&str]) -> Self {
        let mut child = spawn(dir, &[&["simulate"], args].concat());
        let mut port = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut port).unwrap();
        Self { child, port: port.trim().to_owned() }
    }

    /// Waits until it ends by itself: its status, and what it said on stderr.
    pub(crate) fn finished(mut self) -> Output {
        let mut stderr = Vec::new();
        self.child.stderr.as_mut().unwrap().read_to_end(&mut stderr).unwrap();
        Output { status: self.child.wait().unwrap(), stdout: Vec::new(), stderr }
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
