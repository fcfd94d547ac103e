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

/// The calls of the system that a process of [`delayed`] makes take the time that the variables state: a sync, which does nothing
/// else, and a rename.
#[cfg(target_os = "linux")]
const DELAYS: &str = "
#include <fcntl.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
static void wait_for(const char *name) {
    const char *text = getenv(name);
    double s = text ? atof(text) : 0;
    struct timespec time = { (time_t)s, (long)(1e9 * (s - (time_t)s)) };
    nanosleep(&time, 0);
}
int fdatasync(int file) { (void)file; wait_for(\"DBBD_TEST_SYNC_S\"); return 0; }
int fsync(int file) { return fdatasync(file); }
int rename(const char *from, const char *to) {
    int done = (int)syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
    wait_for(\"DBBD_TEST_RENAME_S\");
    return done;
}
";

/// Compiles the library of [`delayed`] in a directory, and returns its path. Where Rust links, there is a C compiler.
#[cfg(target_os = "linux")]
pub(crate) fn delays(directory: &Path) -> String {
    let [source, library] = ["delays.c", "delays.so"].map(|name| directory.join(name));
    std::fs::write(&source, DELAYS).unwrap();
    let cc = Command::new("cc").args(["-shared", "-fPIC", "-o"]).args([&library, &source]).status().unwrap();
    assert!(cc.success());
    library.display().to_string()
}

/// The command with slow calls of the system: `DBBD_TEST_SYNC_S` or `DBBD_TEST_RENAME_S` is the time, s.
#[cfg(target_os = "linux")]
pub(crate) fn delayed(command: &mut Command, library: &str, variable: &str, s: f64) {
    command.env("LD_PRELOAD", library).env(variable, s.to_string());
}
