//! Runs that wait for the archive, in a directory: each as the directory of a run, under the SHA-256 of its capture.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::local::LocalRun;
use crate::base::files::{self, Exclusive, unwritable};
use crate::diagnostic::Diagnostic;

/// What is being written or removed ends with this, and is no run.
const PART: &str = "part";

/// A directory of runs that wait.
pub struct Spool<'a> {
    directory: &'a Path,
    _own: Exclusive,
}

impl<'a> Spool<'a> {
    /// Takes a spool for this process alone, and waits until others are done with it. What a process that was killed left
    /// half written or half removed goes.
    ///
    /// # Errors
    /// The directory cannot be made or read.
    pub fn open(directory: &'a Path) -> Result<Self, Diagnostic> {
        let own = files::exclusive(directory)?;
        let (mut stale, _) = listed(directory)?;
        stale.retain(|path| path.extension().is_some_and(|ending| ending == PART));
        stale.iter().try_for_each(fs::remove_dir_all).map_err(unwritable(directory))?;
        Ok(Self { directory, _own: own })
    }

    /// How many wait in a directory that another process may have open.
    ///
    /// # Errors
    /// The directory is there and cannot be read.
    pub fn count(directory: &Path) -> Result<usize, Diagnostic> {
        Ok(listed(directory)?.1.len())
    }

    /// Those that wait.
    ///
    /// # Errors
    /// The directory cannot be read.
    pub fn waiting(&self) -> Result<Vec<PathBuf>, Diagnostic> {
        Ok(listed(self.directory)?.1)
    }

    /// Puts a run there, whole or not at all. On one file system its files are linked and take no more room.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&self, run: &LocalRun) -> Result<(), Diagnostic> {
        let target = self.directory.join(run.sha256());
        let beside = target.with_extension(PART);
        let copy = || {
            for file in &run.files {
                let path = beside.join(&file.name);
                fs::create_dir_all(path.parent().unwrap_or(&beside))?;
                if fs::hard_link(&file.path, &path).is_err() {
                    fs::copy(&file.path, &path)?;
                }
                File::open(&path)?.sync_all()?;
            }
            // One that waits already is this run with fewer or other results.
            match fs::remove_dir_all(&target) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
                _ => fs::rename(&beside, &target),
            }
        };
        copy().map_err(|error| {
            // What is left of it goes when the spool is opened next.
            let _ = fs::remove_dir_all(&beside);
            unwritable(&target)(error)
        })
    }

    /// Removes one that the archive has confirmed: a kill in the middle leaves no half of a run.
    pub fn remove(&self, run: &Path) -> Result<(), Diagnostic> {
        let part = run.with_extension(PART);
        fs::rename(run, &part).and_then(|()| fs::remove_dir_all(&part)).map_err(unwritable(run))
    }
}

/// What is in a spool: parts and others, and the runs that wait in the order of their names.
fn listed(directory: &Path) -> Result<(Vec<PathBuf>, Vec<PathBuf>), Diagnostic> {
    let unreadable = |error: io::Error| files::unreadable(directory.display())(error);
    let entries = match fs::read_dir(directory) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Default::default()),
        entries => entries.map_err(unreadable)?,
    };
    let paths = entries.map(|entry| entry.map(|entry| entry.path()).map_err(unreadable));
    let mut paths = paths.collect::<Result<Vec<PathBuf>, _>>()?;
    paths.sort();
    let is_run = |path: &PathBuf| path.file_name().is_some_and(|name| name.len() == 64);
    Ok(paths.into_iter().partition(|path| !is_run(path)))
}
