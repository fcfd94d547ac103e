//! The spool: a directory of runs that wait for the archive, each under the SHA-256 of its capture.

use dbbd_model::base::text::unreadable;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::local::LocalRun;
use dbbd_job::files::{self, DirectoryLock, unwritable};
use dbbd_model::diagnostic::Diagnostic;

/// Ending of a run that is being written or removed.
const PART: &str = "part";

pub struct Spool<'a> {
    directory: &'a Path,
    _lock: DirectoryLock,
}

impl<'a> Spool<'a> {
    /// Locks the spool for this process, and waits until others release it. Partial runs of a killed process are
    /// removed.
    pub fn open(directory: &'a Path) -> Result<Self, Diagnostic> {
        let lock = files::exclusive(directory)?;
        let (mut stale, _) = listed(directory)?;
        stale.retain(|path| path.extension().is_some_and(|ending| ending == PART));
        stale.iter().try_for_each(fs::remove_dir_all).map_err(unwritable(directory))?;
        Ok(Self { directory, _lock: lock })
    }

    /// The number of waiting runs. Needs no lock.
    pub fn count(directory: &Path) -> Result<usize, Diagnostic> {
        Ok(listed(directory)?.1.len())
    }

    /// The waiting runs.
    pub fn waiting(&self) -> Result<Vec<PathBuf>, Diagnostic> {
        Ok(listed(self.directory)?.1)
    }

    /// Adds a run atomically. On the same file system its files are linked, which takes no space.
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
            // A waiting version of this run has fewer or other results.
            match fs::remove_dir_all(&target) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
                _ => fs::rename(&beside, &target),
            }
        };
        copy().map_err(|error| {
            // What is left is removed when the spool is opened next.
            let _ = fs::remove_dir_all(&beside);
            unwritable(&target)(error)
        })
    }

    /// Removes a confirmed run. A kill in the middle leaves no partial run.
    pub fn remove(&self, run: &Path) -> Result<(), Diagnostic> {
        let part = run.with_extension(PART);
        fs::rename(run, &part).and_then(|()| fs::remove_dir_all(&part)).map_err(unwritable(run))
    }
}

/// The entries of a spool that are no waiting runs, and its waiting runs in the order of their names.
fn listed(directory: &Path) -> Result<(Vec<PathBuf>, Vec<PathBuf>), Diagnostic> {
    let unreadable = |error: io::Error| unreadable(directory.display())(error);
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
