//! The files of one result, replaced together: after an error the files of the earlier result are still there.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::files::{self, DirectoryLock, UnfinishedFile};
use dbbd_model::diagnostic::Diagnostic;

/// Files that are written under temporary names and renamed together at the end.
#[must_use = "the files get their names when it is finished"]
#[derive(Debug)]
pub struct FileSet {
    directory: PathBuf,
    /// The names of the files of the set, in the order in which they were written.
    names: Vec<String>,
    written: Vec<UnfinishedFile>,
    removed: Vec<PathBuf>,
    _lock: DirectoryLock,
}

/// A file of an earlier result and its backup.
struct Backup {
    path: PathBuf,
    backup: PathBuf,
}

impl FileSet {
    /// Creates the directory, and waits until no other process writes a set to it.
    pub fn begin(directory: &Path) -> Result<Self, Diagnostic> {
        let lock = files::exclusive(directory)?;
        Ok(Self {
            directory: directory.into(),
            names: Vec::new(),
            written: Vec::new(),
            removed: Vec::new(),
            _lock: lock,
        })
    }

    pub fn write(&mut self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Diagnostic> {
        self.write_pieces(name, [content]).map(drop)
    }

    /// Writes a file in pieces. Returns its temporary path, which is valid until the set is finished.
    pub fn write_pieces(
        &mut self,
        name: &str,
        pieces: impl IntoIterator<Item = impl AsRef<[u8]>>,
    ) -> Result<PathBuf, Diagnostic> {
        let path = self.directory.join(name);
        self.names.push(name.into());
        let Some(file) = files::write_unfinished(&path, pieces)? else { return Ok(path) };
        let temporary = file.part.clone();
        self.written.push(file);
        Ok(temporary)
    }

    /// Removes a file of an earlier result, if there is one.
    pub fn remove(&mut self, name: &str) {
        self.removed.push(self.directory.join(name));
    }

    /// Gives the files their names, and returns these.
    ///
    /// # Errors
    /// A file cannot be replaced or removed. The earlier files are then restored.
    pub fn finish(self) -> Result<Vec<String>, Diagnostic> {
        let (mut backups, mut placed) = (Vec::new(), 0);
        let done = self.replace(&mut backups, &mut placed);
        if done.is_err() {
            let is_new = |path: &Path| backups.iter().all(|one: &Backup| one.path != path);
            for file in self.written[..placed].iter().filter(|file| is_new(&file.target)) {
                let _ = fs::remove_file(&file.target);
            }
        }
        for Backup { path, backup } in backups {
            // A backup that cannot be renamed back is kept.
            if done.is_ok() || fs::rename(&backup, path).is_ok() {
                // Not there any more after the renaming, unless both are links to one file.
                let _ = fs::remove_file(backup);
            }
        }
        done.map(|()| self.names)
    }

    fn replace(&self, backups: &mut Vec<Backup>, placed: &mut usize) -> Result<(), Diagnostic> {
        for UnfinishedFile { part, target, .. } in &self.written {
            let wrong = files::unwritable(target);
            backups.extend(back_up(target).map_err(&wrong)?);
            fs::rename(part, target).map_err(&wrong)?;
            *placed += 1;
        }
        for path in self.removed.iter().filter(|path| path.is_file()) {
            let backup = files::beside(path, "old.part");
            fs::rename(path, &backup).map_err(files::unwritable(path))?;
            backups.push(Backup { path: path.clone(), backup });
        }
        Ok(())
    }
}

/// Gives an existing file a second name, so that it keeps its own until it is replaced.
fn back_up(path: &Path) -> io::Result<Option<Backup>> {
    if !path.is_file() {
        return Ok(None);
    }
    let backup = files::beside(path, "old.part");
    // Not every file system has hard links.
    if fs::hard_link(path, &backup).is_err() {
        fs::copy(path, &backup)?;
    }
    Ok(Some(Backup { path: path.into(), backup }))
}
