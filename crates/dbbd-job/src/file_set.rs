//! The files of one result, which are replaced together: after an error the files of the earlier result are still
//! there. For every command, this module decides what is done with an earlier result.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::files::{self, DirectoryLock, SetCommit, UnfinishedFile};
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;

/// The treatment of the files of an earlier result in the directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EarlierFiles {
    /// The files move to `previous-1`, `previous-2`, .. in the directory.
    Keep,
    /// The new result is refused.
    Refuse,
    Replace,
}

impl EarlierFiles {
    /// The treatment for results of measurements, which cannot be made again: kept, unless `replace` is set.
    pub fn kept_unless(replace: bool) -> Self {
        if replace { Self::Replace } else { Self::Keep }
    }

    /// The treatment for programs and tables, which a controller or another program may be using: refused, unless
    /// `replace` is set.
    pub fn refused_unless(replace: bool) -> Self {
        if replace { Self::Replace } else { Self::Refuse }
    }

    /// Refuses a file that exists, if it must not be replaced.
    pub fn check(self, path: &Path) -> Result<(), Diagnostic> {
        match self {
            Self::Refuse if path.is_file() => Err(Diagnostic::file(path.display(), FileFinding::Exists)),
            Self::Keep | Self::Refuse | Self::Replace => Ok(()),
        }
    }
}

/// Files that are written under temporary names and renamed together at the end.
#[must_use = "the files get their names when it is finished"]
#[derive(Debug)]
pub struct FileSet {
    directory: PathBuf,
    earlier: EarlierFiles,
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
    pub fn begin(directory: &Path, earlier: EarlierFiles) -> Result<Self, Diagnostic> {
        let lock = files::exclusive(directory)?;
        Ok(Self {
            directory: directory.into(),
            earlier,
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
        self.earlier.check(&path)?;
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

    /// Gives the files their final names, and returns these names.
    ///
    /// # Errors
    /// A file cannot be replaced or removed. The earlier files are then restored.
    pub fn finish(self) -> Result<Vec<String>, Diagnostic> {
        let (mut backups, mut placed) = (Vec::new(), 0);
        let kept = (self.earlier == EarlierFiles::Keep).then(|| self.next_previous());
        self.commit(kept.as_deref()).begin(&self.directory)?;
        let done = self.replace(&mut backups, &mut placed, kept.as_deref());
        if done.is_err() {
            let is_new = |path: &Path| backups.iter().all(|one: &Backup| one.path != path);
            for file in self.written[..placed].iter().filter(|file| is_new(&file.target)) {
                let _ = fs::remove_file(&file.target);
            }
        }
        for Backup { path, backup } in backups {
            if done.is_ok() && kept.is_some() {
                continue;
            }
            // A backup that cannot be renamed back is kept.
            if done.is_ok() || fs::rename(&backup, path).is_ok() {
                // After the renaming the backup is gone, unless both names are links to one file.
                let _ = fs::remove_file(backup);
            }
        }
        if let Some(kept) = kept.filter(|_| done.is_err()) {
            // The directory remains if it holds a file that could not be renamed back.
            let _ = fs::remove_dir(kept);
        }
        SetCommit::end(&self.directory);
        done.map(|()| self.names)
    }

    /// The renames of [`Self::replace`] in the directory; those of a file behind a link are not among them.
    fn commit(&self, kept: Option<&Path>) -> SetCommit {
        let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let is_here = |path: &Path| files::same_place(files::directory_of(path), &self.directory);
        let here = self.written.iter().filter(|file| is_here(&file.target));
        SetCommit {
            files: here.filter_map(|file| name(&file.part).zip(name(&file.target))).collect(),
            removed: self.removed.iter().filter_map(|path| name(path)).collect(),
            kept: kept.and_then(name),
        }
    }

    /// The first directory for an earlier result that does not exist.
    fn next_previous(&self) -> PathBuf {
        let mut number = 1_u32;
        loop {
            let directory = self.directory.join(format!("previous-{number}"));
            if directory.symlink_metadata().is_err() {
                return directory;
            }
            number += 1;
        }
    }

    /// Replaces the earlier files, which go to `kept`, or to names beside them.
    fn replace(
        &self,
        backups: &mut Vec<Backup>,
        placed: &mut usize,
        kept: Option<&Path>,
    ) -> Result<(), Diagnostic> {
        let backup_of = |path: &Path| match (kept, path.file_name()) {
            (Some(kept), Some(name)) => fs::create_dir_all(kept).map(|()| kept.join(name)),
            _ => Ok(files::beside(path, files::OLD_PART)),
        };
        for UnfinishedFile { part, target, .. } in &self.written {
            let wrong = files::unwritable(target);
            if target.is_file() {
                let backup = backup_of(target).map_err(&wrong)?;
                backups.push(back_up(target, backup).map_err(&wrong)?);
            }
            fs::rename(part, target).map_err(&wrong)?;
            *placed += 1;
        }
        for path in self.removed.iter().filter(|path| path.is_file()) {
            let backup = backup_of(path).map_err(files::unwritable(path))?;
            fs::rename(path, &backup).map_err(files::unwritable(path))?;
            backups.push(Backup { path: path.clone(), backup });
        }
        Ok(())
    }
}

/// Gives an existing file a second name, so that its content is kept when the file is replaced.
fn back_up(path: &Path, backup: PathBuf) -> io::Result<Backup> {
    // Not every file system has hard links.
    if fs::hard_link(path, &backup).is_err() {
        fs::copy(path, &backup)?;
    }
    Ok(Backup { path: path.into(), backup })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(
        at: &Path,
        earlier: EarlierFiles,
        files: &[(&str, &str)],
        removed: &[&str],
    ) -> Result<(), Diagnostic> {
        let mut set = FileSet::begin(at, earlier)?;
        files.iter().try_for_each(|(name, text)| set.write(name, text))?;
        removed.iter().for_each(|name| set.remove(name));
        set.finish().map(drop)
    }

    fn read(at: &Path, name: &str) -> Option<String> {
        fs::read_to_string(at.join(name)).ok()
    }

    #[test]
    fn earlier_results_are_kept_in_their_order() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path();
        fs::write(at.join("of the user"), "mine").unwrap();
        for text in ["first", "second", "third"] {
            write(at, EarlierFiles::Keep, &[("a", text), ("b", text)], &[]).unwrap();
        }
        write(at, EarlierFiles::Keep, &[("a", "fourth")], &["b"]).unwrap();
        for (name, text) in [
            ("a", Some("fourth")),
            ("b", None),
            ("previous-1/a", Some("first")),
            ("previous-2/b", Some("second")),
            ("previous-3/a", Some("third")),
            ("previous-3/b", Some("third")),
            ("previous-4/a", None),
            ("of the user", Some("mine")),
        ] {
            assert_eq!(read(at, name).as_deref(), text, "{name}");
        }
        write(at, EarlierFiles::Replace, &[("a", "fifth")], &[]).unwrap();
        assert_eq!(read(at, "a").as_deref(), Some("fifth"));
        assert!(!at.join("previous-4").exists());
    }

    #[test]
    fn refused_set_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path();
        write(at, EarlierFiles::Refuse, &[("a", "first")], &[]).unwrap();
        let refused = write(at, EarlierFiles::Refuse, &[("b", "second"), ("a", "second")], &[]).unwrap_err();
        assert_eq!(refused.code().to_string(), "E0182");
        assert_eq!(read(at, "a").as_deref(), Some("first"));
        assert_eq!(fs::read_dir(at).unwrap().count(), 1);
    }

    /// After a kill at any rename the next reader finds the new set, and before the first one the old set.
    #[test]
    fn a_set_that_was_killed_is_the_old_or_the_new_one() {
        for renamed in 0..=3 {
            for earlier in [EarlierFiles::Keep, EarlierFiles::Replace] {
                let dir = tempfile::tempdir().unwrap();
                let at = dir.path();
                write(at, earlier, &[("a", "first"), ("b", "first"), ("c", "first")], &[]).unwrap();
                let mut set = FileSet::begin(at, earlier).unwrap();
                ["a", "b"].into_iter().try_for_each(|name| set.write(name, "second")).unwrap();
                set.remove("c");
                let kept = (earlier == EarlierFiles::Keep).then(|| set.next_previous());
                if renamed > 0 {
                    set.commit(kept.as_deref()).begin(at).unwrap();
                    for file in &set.written[..renamed - 1] {
                        fs::rename(&file.part, &file.target).unwrap();
                    }
                }
                // The process is gone, and with it its lock.
                let FileSet { written, _lock: lock, .. } = set;
                drop(lock);
                let is_new = renamed > 0;
                let text = files::read_text(&at.join("b")).unwrap();
                assert_eq!(text, if is_new { "second" } else { "first" }, "{renamed}");
                assert_eq!(read(at, "a").unwrap(), text, "{renamed}");
                assert_eq!(read(at, "c").is_some(), !is_new, "{renamed}");
                if let Some(kept) = kept.filter(|_| is_new) {
                    assert_eq!(fs::read_to_string(kept.join("c")).unwrap(), "first");
                }
                std::mem::forget(written);
            }
        }
    }

    /// Also of the first set of a directory, whose files are looked for before they are opened; no backup is left of the one before.
    #[test]
    fn who_looks_for_a_file_completes_the_set() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path();
        for name in ["a.7.part", "a.7.old.part", "b.7.part"] {
            fs::write(at.join(name), "second").unwrap();
        }
        let files = vec![("a.7.part".to_owned(), "a".to_owned()), ("b.7.part".to_owned(), "b".to_owned())];
        SetCommit { files, ..SetCommit::default() }.begin(at).unwrap();
        fs::rename(at.join("a.7.part"), at.join("a")).unwrap();
        assert!(files::is_there(&at.join("b")) && !files::is_there(&at.join("c")));
        assert_eq!(fs::read_dir(at).unwrap().count(), 2);
    }

    /// The next writer of the directory completes the set under its own lock, and reads with the lock in its hands.
    #[test]
    fn the_next_set_completes_a_killed_one() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path();
        write(at, EarlierFiles::Replace, &[("a", "first")], &[]).unwrap();
        fs::write(at.join("a.part"), "second").unwrap();
        let files = vec![("a.part".to_owned(), "a".to_owned())];
        SetCommit { files, ..SetCommit::default() }.begin(at).unwrap();
        let set = FileSet::begin(at, EarlierFiles::Replace).unwrap();
        assert_eq!(files::read_text(&at.join("a")).unwrap(), "second");
        drop(set);
    }

    /// What names a file elsewhere was not written here, and moves nothing.
    #[test]
    fn a_set_reaches_nothing_outside_of_its_directory() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path().join("in");
        fs::create_dir(&at).unwrap();
        for (name, text) in [("secret", "secret"), ("in/part", "new"), ("in/a", "old")] {
            fs::write(dir.path().join(name), text).unwrap();
        }
        for name in ["../secret", "/etc/hostname", "..", "x/y"] {
            let commit = SetCommit { files: vec![("part".into(), name.into())], ..SetCommit::default() };
            commit.begin(&at).unwrap();
            assert_eq!(files::read_text(&at.join("a")).unwrap(), "old");
            assert_eq!(fs::read_to_string(dir.path().join("secret")).unwrap(), "secret");
            assert!(at.join("part").is_file());
        }
    }

    /// A file of the set cannot be placed, because its name has become the name of a directory.
    #[test]
    fn failed_set_leaves_the_earlier_one() {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path();
        write(at, EarlierFiles::Keep, &[("a", "first")], &[]).unwrap();
        let mut set = FileSet::begin(at, EarlierFiles::Keep).unwrap();
        set.write("a", "second").unwrap();
        set.write("b", "second").unwrap();
        fs::create_dir_all(at.join("b/full")).unwrap();
        assert!(set.finish().is_err());
        assert_eq!(read(at, "a").as_deref(), Some("first"));
        assert!(!at.join("previous-1").exists());
    }
}
