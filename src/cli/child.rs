//! Runs other commands of this program as child processes in a directory.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::CommandOutput;
use dbbd_device::clock;
use dbbd_device::port::PortAddress;
use dbbd_job::child_process;
use dbbd_job::files;
use dbbd_job::sim::SimulationFinding;
use dbbd_model::diagnostic::Diagnostic;

/// The address on which a simulator of our own listens: only on this computer, on a free port.
pub(crate) const LOOPBACK: &str = "tcp://127.0.0.1:0";

/// Runs commands in a directory.
pub(crate) struct ChildCommands<'a> {
    dir: &'a Path,
    out: &'a CommandOutput,
}

/// A running `dbbd simulate`.
pub(crate) struct Simulator {
    child: Child,
    port: PortAddress,
}

impl<'a> ChildCommands<'a> {
    pub(crate) fn new(dir: &'a Path, out: &'a CommandOutput) -> Self {
        Self { dir, out }
    }

    /// Prints a heading.
    pub(crate) fn say(&self, text: &str) {
        self.out.progress(format!("\n{text}"));
    }

    /// Removes a file, if it exists.
    pub(crate) fn remove(&self, name: &str) -> Result<(), Diagnostic> {
        let path = self.dir.join(name);
        if path.exists() {
            std::fs::remove_file(&path).map_err(files::unwritable(&path))?;
        }
        Ok(())
    }

    fn command(&self, args: &[&str]) -> Result<Command, Diagnostic> {
        self.out.progress(format!("$ dbbd {}", args.join(" ")));
        let mut command = child_process::own().map_err(|error| not_started(args, error))?;
        command.args(args).current_dir(self.dir);
        if self.out.is_quiet() {
            command.arg("--quiet");
        }
        Ok(command)
    }

    /// Runs a command to its end. Its stdout is printed on stderr, as progress. Its warnings are ours: see `warned_by_child`.
    pub(crate) fn run(&self, args: &[&str]) -> Result<(), Diagnostic> {
        let failed = |error| not_started(args, error);
        let mut child = self.command(args)?.stdout(Stdio::piped()).spawn().map_err(failed)?;
        let _stdin = child.stdin.take();
        if let Some(stdout) = child.stdout.take() {
            for line in BufReader::new(stdout).lines() {
                self.out.progress(line.map_err(failed)?);
            }
        }
        let status = child.wait().map_err(failed)?;
        match status.code() {
            Some(0) => Ok(()),
            Some(3) => {
                self.out.warned_by_child();
                Ok(())
            }
            _ => {
                Err(SimulationFinding::StepFailed { step: args.join(" "), status: status.to_string() }.into())
            }
        }
    }

    /// Starts a simulator, and waits for its first line on stdout, the address of its bar.
    pub(crate) fn start(&self, args: &[&str]) -> Result<Simulator, Diagnostic> {
        let failed = |error| not_started(args, error);
        let mut command = self.command(args)?;
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().map_err(failed)?;
        let mut port = String::new();
        if let Some(stdout) = child.stdout.take() {
            BufReader::new(stdout).read_line(&mut port).map_err(failed)?;
        }
        let Ok(port) = port.trim().parse() else {
            let status = child.wait().map_err(failed)?.to_string();
            return Err(SimulationFinding::NoPort { status }.into());
        };
        Ok(Simulator { child, port })
    }
}

fn not_started(args: &[&str], error: std::io::Error) -> Diagnostic {
    SimulationFinding::StepNotStarted { step: args.join(" "), why: error.to_string() }.into()
}

impl Simulator {
    /// The address of the virtual bar.
    pub(crate) fn port(&self) -> &PortAddress {
        &self.port
    }

    /// Waits until the simulator ends, which it does when its reader is gone.
    pub(crate) fn finish(mut self) -> Result<(), Diagnostic> {
        for _ in 0..100 {
            let status = self.child.try_wait().map_err(|error| not_started(&["simulate"], error))?;
            match status.and_then(|status| status.code()) {
                Some(0 | 3) => return Ok(()),
                Some(exit_code) => return Err(SimulationFinding::SimulatorFailed { exit_code }.into()),
                None => clock::sleep(0.1),
            }
        }
        Err(SimulationFinding::SimulatorGoesOn.into())
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        // A simulator without a reader would wait for one. After a normal end this does nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
