//! Reads and writes whole files. Every message names the path.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use dbbd_model::base::FileFinding::{
    IsInput, NoDirectory, NoResult, NotAFile, NotUtf8At, OtherContent, StandardOutput, TooLarge, Unwritable,
};
use dbbd_model::base::hash::Sha256;
use dbbd_model::base::serialised;
use dbbd_model::base::text::unreadable;
use dbbd_model::diagnostic::Diagnostic;
use serde::{Deserialize, Serialize};

pub fn unwritable(path: &Path) -> impl Fn(io::Error) -> Diagnostic + use<> {
    let name = path.display().to_string();
    move |error| Diagnostic::file(&name, Unwritable { why: error.to_string() })
}

/// The directory that contains a file.
pub fn directory_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The directory of a file, the one above it, and the directories in these two: where the files lie that belong to it.
pub fn directories_around(file: &Path) -> Vec<PathBuf> {
    let Ok(own) = directory_of(file).canonicalize() else { return Vec::new() };
    let both = [Some(own.as_path()), own.parent()].into_iter().flatten();
    let inside = both.clone().flat_map(|directory| fs::read_dir(directory).into_iter().flatten().flatten());
    let inside = inside.map(|entry| entry.path()).filter(|path| path.is_dir());
    let all: BTreeSet<PathBuf> = both.map(Path::to_owned).chain(inside).collect();
    all.into_iter().collect()
}

/// Creates a directory for results.
pub fn directory(path: &Path) -> Result<(), Diagnostic> {
    fs::create_dir_all(path)
        .map_err(|error| Diagnostic::file(path.display(), NoDirectory { why: error.to_string() }))
}

/// Whether two paths are one existing file.
pub fn same_place(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// The largest text that is read whole, bytes: the largest results and programs are a tenth of it.
pub const MAX_TEXT_BYTES: u64 = 256 << 20;
/// The largest job, robot, protocol or configuration, bytes.
pub const MAX_DEFINITION_BYTES: u64 = 4 << 20;

/// Opens a file to read it. A pipe, a device or a directory is refused without opening it: it may block, or never end.
pub fn open(path: &Path) -> Result<File, Diagnostic> {
    let wrong = unreadable(path.display());
    complete_set_of(path);
    if !fs::metadata(path).map_err(&wrong)?.is_file() {
        return Err(Diagnostic::file(path.display(), NotAFile));
    }
    File::open(path).map_err(wrong)
}

/// Whether there is this file, when the set that it may belong to is complete: for whoever looks for a file before it opens one.
pub fn is_there(path: &Path) -> bool {
    complete_set_of(path);
    path.is_file()
}

/// Completes a set whose process was killed, or waits for it, so that nobody reads a part of a set.
fn complete_set_of(file: &Path) {
    let directory = directory_of(file);
    if directory.join(COMMIT).exists() {
        drop(exclusive(directory));
    }
}

/// The file that says which renames complete a set of files. It is there while they are done, and afterwards only if the process
/// was killed meanwhile.
const COMMIT: &str = ".dbbd-set.json";

/// The renames that give a set of files its names, all in one directory.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct SetCommit {
    /// Temporary and final name of each file.
    pub(super) files: Vec<(String, String)>,
    pub(super) removed: Vec<String>,
    /// The directory to which earlier files go.
    pub(super) kept: Option<String>,
}

impl SetCommit {
    /// From now on the set is the new one, whatever happens to this process.
    pub(super) fn begin(&self, directory: &Path) -> Result<(), Diagnostic> {
        write_file(&directory.join(COMMIT), serialised::json(self)?)
    }

    /// All is renamed.
    pub(super) fn end(directory: &Path) {
        // Fails if there was none.
        let _ = fs::remove_file(directory.join(COMMIT));
    }

    /// Whether all names are of files in the directory: the file may have come from elsewhere.
    fn is_inside(&self) -> bool {
        let names = self
            .files
            .iter()
            .flat_map(|(part, target)| [part, target])
            .chain(&self.removed)
            .chain(&self.kept);
        let is_name = |name: &String| Path::new(name).file_name().is_some_and(|own| own == name.as_str());
        names.into_iter().all(is_name)
    }

    fn complete(&self, directory: &Path) -> io::Result<()> {
        let keep = |name: &str| -> io::Result<()> {
            let (Some(kept), true) = (&self.kept, directory.join(name).is_file()) else { return Ok(()) };
            fs::create_dir_all(directory.join(kept))?;
            let backup = directory.join(kept).join(name);
            if backup.exists() { Ok(()) } else { fs::copy(directory.join(name), backup).map(drop) }
        };
        for (part, target) in self.files.iter().filter(|(part, _)| directory.join(part).is_file()) {
            keep(target)?;
            fs::rename(directory.join(part), directory.join(target))?;
        }
        // The backups of the process that was killed. Where the earlier set is kept there are none.
        for name in self.files.iter().filter_map(|(part, _)| part.strip_suffix(PART)) {
            let _ = fs::remove_file(directory.join(name.to_owned() + OLD_PART));
        }
        for name in self.removed.iter().filter(|name| directory.join(name).is_file()) {
            keep(name)?;
            fs::remove_file(directory.join(name))?;
        }
        Ok(())
    }
}

/// Completes a set of files whose process was killed between two renames. The directory must be locked: whoever writes a
/// set has the lock until it is complete.
fn complete_set(directory: &Path) {
    let text = fs::read(directory.join(COMMIT)).ok();
    let commit = text.and_then(|text| serde_json::from_slice::<SetCommit>(&text).ok());
    // What cannot be completed, for instance in a directory that may only be read, stays as it is.
    if commit.is_some_and(|commit| commit.is_inside() && commit.complete(directory).is_ok()) {
        SetCommit::end(directory);
    }
}

/// Reads a file of at most `most` bytes. The size that the system states is not trusted: that of some is 0.
pub fn read_bytes(path: &Path, most: u64) -> Result<Vec<u8>, Diagnostic> {
    let wrong = unreadable(path.display());
    let file = open(path)?;
    let bytes = file.metadata().map_err(&wrong)?.len();
    let mut content = Vec::new();
    if bytes <= most {
        file.take(most + 1).read_to_end(&mut content).map_err(wrong)?;
    }
    let bytes = bytes.max(content.len() as u64);
    if bytes > most {
        return Err(Diagnostic::file(path.display(), TooLarge { bytes, most }));
    }
    Ok(content)
}

/// Reads a UTF-8 text.
pub fn read_text(path: &Path) -> Result<String, Diagnostic> {
    read_at_most(path, MAX_TEXT_BYTES)
}

/// Reads a UTF-8 text that people write: a job, a robot, a protocol, a configuration.
pub fn read_definition(path: &Path) -> Result<String, Diagnostic> {
    read_at_most(path, MAX_DEFINITION_BYTES)
}

/// Reads a UTF-8 text of at most `most` bytes.
pub fn read_at_most(path: &Path, most: u64) -> Result<String, Diagnostic> {
    String::from_utf8(read_bytes(path, most)?).map_err(|error| {
        let byte = error.utf8_error().valid_up_to();
        Diagnostic::file(path.display(), NotUtf8At { byte })
    })
}

/// Reads a file if it exists. A path with this ending must be a file: if it does not exist, that is an error.
pub fn if_there(path: &Path, ending: &str) -> Option<Result<String, Diagnostic>> {
    (is_there(path) || path.exists() || path.to_string_lossy().ends_with(ending)).then(|| read_text(path))
}

/// Reads a file if it exists.
pub fn read_if_file(path: &Path) -> Option<Result<String, Diagnostic>> {
    is_there(path).then(|| read_text(path))
}

/// The SHA-256 of a file of any size.
pub fn sha256(path: &Path) -> Result<String, Diagnostic> {
    let wrong = unreadable(path.display());
    let mut file = open(path)?;
    let (mut hash, mut piece) = (Sha256::default(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut piece).map_err(&wrong)? {
            0 => return Ok(hash.finish()),
            read => hash.update(piece.get(..read).unwrap_or_default()),
        }
    }
}

/// A file that is written under a temporary name and renamed when it is complete. If it is dropped before that, no part
/// of it remains.
#[derive(Debug)]
#[must_use = "the file gets its name when it is finished"]
pub struct UnfinishedFile {
    /// The temporary name.
    pub(super) part: PathBuf,
    /// The final name, behind a symbolic link if `path` is one.
    pub(super) target: PathBuf,
    path: PathBuf,
}

impl UnfinishedFile {
    pub fn create(path: &Path) -> Result<(Self, File), Diagnostic> {
        if path.as_os_str() == "-" {
            return Err(Diagnostic::file(path.display(), StandardOutput));
        }
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let part = beside(&target, PART);
        let file = File::create(&part).map_err(unwritable(path))?;
        Ok((Self { part, target, path: path.into() }, file))
    }

    /// Renames the file, which must be closed.
    pub fn finish(self) -> Result<(), Diagnostic> {
        fs::rename(&self.part, &self.target).map_err(unwritable(&self.path))
    }
}

impl Drop for UnfinishedFile {
    fn drop(&mut self) {
        // After `finish` there is no such file.
        let _ = fs::remove_file(&self.part);
    }
}

/// Writes a file completely or not at all.
pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<(), Diagnostic> {
    write_unfinished(path, [content])?.map_or(Ok(()), UnfinishedFile::finish)
}

/// Writes a file in pieces under its temporary name. `None` if `path` is a device or a pipe, which took the pieces.
pub(super) fn write_unfinished(
    path: &Path,
    pieces: impl IntoIterator<Item = impl AsRef<[u8]>>,
) -> Result<Option<UnfinishedFile>, Diagnostic> {
    let wrong = unwritable(path);
    let fill = |mut file: File| pieces.into_iter().try_for_each(|piece| file.write_all(piece.as_ref()));
    match fs::metadata(path) {
        Ok(data) if data.is_dir() => Err(wrong(io::ErrorKind::IsADirectory.into())),
        Ok(data) if !data.is_file() => {
            let filled = fs::OpenOptions::new().write(true).open(path).and_then(fill);
            filled.map(|()| None).map_err(wrong)
        }
        _ => {
            let (unfinished, file) = UnfinishedFile::create(path)?;
            fill(file).map_err(wrong)?;
            Ok(Some(unfinished))
        }
    }
}

/// The end of the name of a file that is being written, and of the earlier file that it replaces.
const PART: &str = ".part";
pub(super) const OLD_PART: &str = ".old.part";

/// A name in the same directory that no other process uses.
pub(super) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}{ending}", std::process::id()));
    beside.into()
}

/// The permission bits of a file; 0 if it does not exist, and on systems other than Unix.
#[cfg(unix)]
pub fn mode(path: &Path) -> u32 {
    use std::os::unix::fs::PermissionsExt;
    fs::metadata(path).map_or(0, |data| data.permissions().mode())
}

#[cfg(not(unix))]
pub fn mode(_: &Path) -> u32 {
    0
}

/// Refuses to write a result over a file that the command reads.
pub fn keeps<'a>(out: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<(), Diagnostic> {
    match inputs.into_iter().find(|input| same_place(out, input)) {
        Some(input) => Err(Diagnostic::file(input.display(), IsInput)),
        None => Ok(()),
    }
}

/// Refuses to replace a file that is not an earlier result of the same kind, which begins with `head`.
pub fn is_earlier(out: &Path, head: &[u8]) -> Result<(), Diagnostic> {
    if !out.is_file() {
        return Ok(());
    }
    let mut begin = Vec::new();
    let wrong = unreadable(out.display());
    File::open(out).and_then(|file| file.take(head.len() as u64).read_to_end(&mut begin)).map_err(wrong)?;
    // An earlier export may have been cut off.
    if head.starts_with(&begin) { Ok(()) } else { Err(Diagnostic::file(out.display(), NoResult)) }
}

/// Refuses to replace a file whose content does not have this SHA-256.
pub fn is_same(out: &Path, content_sha256: &str) -> Result<(), Diagnostic> {
    if out.symlink_metadata().is_err() || (out.is_file() && sha256(out)? == content_sha256) {
        return Ok(());
    }
    Err(Diagnostic::file(out.display(), OtherContent))
}

/// A lock on a directory: while it is held, no other dbbd process writes a set of results there.
#[must_use = "dropping it releases the directory"]
#[derive(Debug)]
pub struct DirectoryLock {
    _lock: Option<File>,
}

/// Creates a directory and waits for its lock, so that two sets of results are never mixed, and completes a set whose process
/// was killed.
pub fn exclusive(path: &Path) -> Result<DirectoryLock, Diagnostic> {
    directory(path)?;
    let lock = lock(path);
    complete_set(path);
    Ok(DirectoryLock { _lock: lock })
}

/// Locks a directory. `None` on a file system where directories cannot be locked: sets are then written unprotected.
#[cfg(not(windows))]
fn lock(directory: &Path) -> Option<File> {
    File::open(directory).ok().filter(|directory| directory.lock().is_ok())
}

/// Locks a directory. Windows does not lock directories: a file in it is opened exclusively and deleted with its
/// handle.
#[cfg(windows)]
fn lock(directory: &Path) -> Option<File> {
    use std::os::windows::fs::OpenOptionsExt;
    const DELETE_ON_CLOSE: u32 = 0x0400_0000;
    const SHARING_VIOLATION: i32 = 32;
    const ACCESS_DENIED: i32 = 5;
    /// Number of tries, 20 ms apart. Without a limit this would wait forever in a directory that is not writable.
    const TRIES: usize = 1500;
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true).share_mode(0).custom_flags(DELETE_ON_CLOSE);
    for _ in 0..TRIES {
        match options.open(directory.join(".dbbd-lock")) {
            // Another process has it open, or it is being deleted.
            Err(error) if matches!(error.raw_os_error(), Some(SHARING_VIOLATION | ACCESS_DENIED)) => {
                dbbd_device::clock::sleep(0.02);
            }
            opened => return opened.ok(),
        }
    }
    None
}
