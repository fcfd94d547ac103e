//! Other verbs as child processes of this same program, in a directory of their own.

use std::error::Error;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use super::Output;
use crate::clock;

/// Runs commands in a directory.
pub(crate) struct Steps<'a> {
    program: PathBuf,
    dir: &'a Path,
    out: &'a Output,
}

/// A simulator that runs beside the next step.
pub(crate) struct Simulator {
    child: Child,
    port: String,
}

impl<'a> Steps<'a> {
    pub(crate) fn new(dir: &'a Path, out: &'a Output) -> Result<Self, Box<dyn Error>> {
        Ok(Self { program: std::env::current_exe()?, dir, out })
    }

    /// A heading.
    pub(crate) fn say(&self, text: &str) {
        self.out.progress(format!("\n{text}"));
    }

    /// Removes a file of an earlier run, if there is one.
    pub(crate) fn remove(&self, name: &str) -> Result<(), Box<dyn Error>> {
        let path = self.dir.join(name);
        if path.exists() {
            std::fs::remove_file(&path)
                .map_err(|error| format!("{}: cannot be removed: {error}", path.display()))?;
        }
        Ok(())
    }

    fn command(&self, args: &[&str]) -> Command {
        self.out.progress(format!("$ dbbd {}", args.join(" ")));
        let mut command = Command::new(&self.program);
        command.args(args).current_dir(self.dir).stdin(Stdio::null());
        if self.out.is_quiet() {
            command.arg("--quiet");
        }
        command
    }

    /// Runs a command to its end; what it says on stdout goes to our stderr, which holds the progress.
    pub(crate) fn run(&self, args: &[&str]) -> Result<(), Box<dyn Error>> {
        let mut child = self.command(args).stdout(Stdio::piped()).spawn()?;
        if let Some(stdout) = child.stdout.take() {
            for line in BufReader::new(stdout).lines() {
                self.out.progress(line?);
            }
        }
        let status = child.wait()?;
        // 3 is done with a doubt, which the command has told.
        match status.code() {
            Some(0 | 3) => Ok(()),
            _ => Err(format!("the step `dbbd {}` failed ({status})", args.join(" ")).into()),
        }
    }

    /// Starts the simulator and waits for the name of its pty, the first line on stdout.
    pub(crate) fn start(&self, args: &[&str]) -> Result<Simulator, Box<dyn Error>> {
        let mut child = self.command(args).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
        let mut port = String::new();
        if let Some(stdout) = child.stdout.take() {
            BufReader::new(stdout).read_line(&mut port)?;
        }
        let port = port.trim().to_owned();
        if port.is_empty() {
            let status = child.wait()?;
            return Err(format!("the simulator gave no pty ({status}); run it alone to see why").into());
        }
        Ok(Simulator { child, port })
    }
}

impl Simulator {
    /// Name of the virtual bar's pty.
    pub(crate) fn port(&self) -> &str {
        &self.port
    }

    /// Waits for its end, which comes when nobody reads the bar any more.
    pub(crate) fn finish(mut self) -> Result<(), Box<dyn Error>> {
        for _ in 0..100 {
            match self.child.try_wait()?.and_then(|status| status.code()) {
                Some(0 | 3) => return Ok(()),
                Some(code) => return Err(format!("the simulator failed (exit code {code})").into()),
                None => clock::sleep(0.1),
            }
        }
        Err("the simulator goes on although its bar is no longer read".into())
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        // When the step beside it failed, nobody reads the pty any more; after a normal end this does nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
