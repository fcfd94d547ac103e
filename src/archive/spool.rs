//! Runs that wait for the archive, in a directory: each as the directory of a run, under the SHA-256 of its capture.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::local::LocalRun;
use crate::base::files;
use crate::catalogue::FileFinding;
use crate::diagnostic::Diagnostic;

/// A directory of runs that wait.
pub struct Spool<'a>(pub &'a Path);

impl Spool<'_> {
    /// Those that wait. What is being written has another name.
    ///
    /// # Errors
    /// The directory is there and cannot be read.
    pub fn waiting(&self) -> Result<Vec<PathBuf>, Diagnostic> {
        let unreadable = |error: io::Error| files::unreadable(self.0.display())(error);
        let entries = match fs::read_dir(self.0) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(unreadable)?,
        };
        let paths = entries.map(|entry| entry.map(|entry| entry.path()).map_err(unreadable));
        let mut waiting = paths.collect::<Result<Vec<PathBuf>, _>>()?;
        waiting.retain(|path| path.file_name().is_some_and(|name| name.len() == 64));
        waiting.sort();
        Ok(waiting)
    }

    /// Puts a copy of a run there, whole or not at all.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&self, run: &LocalRun) -> Result<(), Diagnostic> {
        let target = self.0.join(run.sha256());
        let beside = self.0.join(format!("{}.{}.part", run.sha256(), std::process::id()));
        let wrong = |error: io::Error| {
            Diagnostic::file(
                &target.display().to_string(),
                FileFinding::Unwritable { why: error.to_string() },
            )
        };
        let copy = || {
            for file in &run.files {
                let path = beside.join(&file.name);
                fs::create_dir_all(path.parent().unwrap_or(&beside))?;
                fs::copy(&file.path, &path)?;
                File::open(&path)?.sync_all()?;
            }
            // One that waits already is this run with fewer or other results.
            let _ = fs::remove_dir_all(&target);
            fs::rename(&beside, &target)
        };
        files::directory(self.0)?;
        copy().map_err(|error| {
            let _ = fs::remove_dir_all(&beside);
            wrong(error)
        })
    }

    /// Removes one that the archive has confirmed.
    pub fn remove(&self, run: &Path) -> Result<(), Diagnostic> {
        fs::remove_dir_all(run).map_err(|error| {
            Diagnostic::file(&run.display().to_string(), FileFinding::Unwritable { why: error.to_string() })
        })
    }
}
