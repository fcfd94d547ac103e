//! Other verbs as child processes of this same program, in a directory of their own.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::Output;
use crate::base::{clock, files, program};
use crate::catalogue::SimulationFinding;
use crate::device::port::PortAddress;
use crate::diagnostic::Diagnostic;

/// Where a simulator of our own listens: a port number that the system chooses, for this computer alone.
pub(crate) const LOOPBACK: &str = "tcp://127.0.0.1:0";

/// Runs commands in a directory.
pub(crate) struct Steps<'a> {
    dir: &'a Path,
    out: &'a Output,
}

/// A simulator that runs beside the next step.
pub(crate) struct Simulator {
    child: Child,
    port: PortAddress,
}

impl<'a> Steps<'a> {
    pub(crate) fn new(dir: &'a Path, out: &'a Output) -> Self {
        Self { dir, out }
    }

    /// A heading.
    pub(crate) fn say(&self, text: &str) {
        self.out.progress(format!("\n{text}"));
    }

    /// Removes a file of an earlier run, if there is one.
    pub(crate) fn remove(&self, name: &str) -> Result<(), Diagnostic> {
        let path = self.dir.join(name);
        if path.exists() {
            std::fs::remove_file(&path).map_err(files::unwritable(&path))?;
        }
        Ok(())
    }

    fn command(&self, args: &[&str]) -> Result<Command, Diagnostic> {
        self.out.progress(format!("$ dbbd {}", args.join(" ")));
        let mut command = program::own().map_err(|error| failed(args, error))?;
        command.args(args).current_dir(self.dir);
        if self.out.is_quiet() {
            command.arg("--quiet");
        }
        Ok(command)
    }

    /// Runs a command to its end; what it prints on stdout goes to our stderr, which holds the progress.
    pub(crate) fn run(&self, args: &[&str]) -> Result<(), Diagnostic> {
        let failed = |error| failed(args, error);
        let mut child = self.command(args)?.stdout(Stdio::piped()).spawn().map_err(failed)?;
        let _kept = child.stdin.take();
        if let Some(stdout) = child.stdout.take() {
            for line in BufReader::new(stdout).lines() {
                self.out.progress(line.map_err(failed)?);
            }
        }
        let status = child.wait().map_err(failed)?;
        // 3 is done with a doubt, which the command has reported.
        match status.code() {
            Some(0 | 3) => Ok(()),
            _ => {
                let (step, status) = (args.join(" "), status.to_string());
                Err(SimulationFinding::StepFailed { step, status }.into())
            }
        }
    }

    /// Starts the simulator and waits for the address of its bar, the first line on stdout.
    pub(crate) fn start(&self, args: &[&str]) -> Result<Simulator, Diagnostic> {
        let failed = |error| failed(args, error);
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

/// A command that the system does not run.
fn failed(args: &[&str], error: std::io::Error) -> Diagnostic {
    SimulationFinding::StepNotStarted { step: args.join(" "), why: error.to_string() }.into()
}

impl Simulator {
    /// Where the virtual bar is.
    pub(crate) fn port(&self) -> &PortAddress {
        &self.port
    }

    /// Waits for its end, which comes when nobody reads the bar any more.
    pub(crate) fn finish(mut self) -> Result<(), Diagnostic> {
        for _ in 0..100 {
            let status = self.child.try_wait().map_err(|error| failed(&["simulate"], error))?;
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
        // When the step beside it failed, nobody reads the bar any more; after a normal end this does nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
