//! Files in and out, with the path in every message.

use std::fmt::Display;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use crate::base::hash::Sha256;
use crate::catalogue::FileFinding::{
    IsInput, NoDirectory, NoResult, NotAFile, NotUtf8At, OtherContent, TooLarge, Unreadable, Unwritable,
};
use crate::diagnostic::Diagnostic;

/// What is wrong when a file could not be read.
pub fn unreadable(file: impl Display) -> impl Fn(io::Error) -> Diagnostic {
    move |error| Diagnostic::file(&file.to_string(), Unreadable { why: error.to_string() })
}

/// The directory that a file is in.
pub fn directory_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The text of a file.
pub fn read(path: &Path) -> Result<String, Diagnostic> {
    let bytes = fs::read(path).map_err(unreadable(path.display()))?;
    String::from_utf8(bytes).map_err(|error| {
        let byte = error.utf8_error().valid_up_to();
        Diagnostic::file(&path.display().to_string(), NotUtf8At { byte })
    })
}

/// The text of a file, if there is one of this name or the name ends like that of one.
pub fn if_there(path: &Path, ending: &str) -> Option<Result<String, Diagnostic>> {
    (path.exists() || path.to_string_lossy().ends_with(ending)).then(|| read(path))
}

/// The text of a file, if there is one.
pub fn read_if_file(path: &Path) -> Option<Result<String, Diagnostic>> {
    path.is_file().then(|| read(path))
}

/// The text of a file of at most `most` bytes; what is no file (a pipe, a device) is not opened.
pub fn read_at_most(path: &Path, most: u64) -> Result<String, Diagnostic> {
    match fs::metadata(path) {
        Ok(data) if !data.is_file() => Err(Diagnostic::file(&path.display().to_string(), NotAFile)),
        Ok(data) if data.len() > most => {
            Err(Diagnostic::file(&path.display().to_string(), TooLarge { bytes: data.len(), most }))
        }
        _ => read(path),
    }
}

/// The SHA-256 of a file, which is never whole in memory.
pub fn sha256(path: &Path) -> Result<String, Diagnostic> {
    let wrong = unreadable(path.display());
    let mut file = fs::File::open(path).map_err(&wrong)?;
    let (mut hash, mut piece) = (Sha256::default(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut piece).map_err(&wrong)? {
            0 => return Ok(hash.finish()),
            read => hash.update(piece.get(..read).unwrap_or_default()),
        }
    }
}

/// Writes a file whole or not at all: beside it first, then renamed.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), Diagnostic> {
    write_pieces(path, [content])
}

/// The same in pieces, of which one at a time is in memory.
pub fn write_pieces(
    path: &Path,
    pieces: impl IntoIterator<Item = impl AsRef<[u8]>>,
) -> Result<(), Diagnostic> {
    let Some(Beside { beside, target }) = write_beside(path, pieces)? else { return Ok(()) };
    fs::rename(&beside, &target).map_err(|error| {
        // A part of a file is of no use.
        let _ = fs::remove_file(&beside);
        unwritable(path)(error)
    })
}

/// A file that was written beside the place that it is to have.
#[derive(Debug)]
pub(super) struct Beside {
    pub(super) beside: PathBuf,
    pub(super) target: PathBuf,
}

/// Writes a file whole beside its name; `None` where a device or a pipe took it.
pub(super) fn write_beside(
    path: &Path,
    pieces: impl IntoIterator<Item = impl AsRef<[u8]>>,
) -> Result<Option<Beside>, Diagnostic> {
    let wrong = unwritable(path);
    let fill = |mut file: fs::File| pieces.into_iter().try_for_each(|piece| file.write_all(piece.as_ref()));
    // A link stays one: what it points to is replaced. A device or a pipe takes the text as it is.
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    match fs::metadata(&target) {
        Ok(data) if data.is_dir() => return Err(wrong(io::ErrorKind::IsADirectory.into())),
        Ok(data) if !data.is_file() => {
            return fs::OpenOptions::new()
                .write(true)
                .open(&target)
                .and_then(fill)
                .map(|()| None)
                .map_err(wrong);
        }
        _ => {}
    }
    let beside = beside(&target, "part");
    match fs::File::create(&beside).and_then(fill) {
        Ok(()) => Ok(Some(Beside { beside, target })),
        Err(error) => {
            // A part of a file is of no use.
            let _ = fs::remove_file(&beside);
            Err(wrong(error))
        }
    }
}

/// A name beside that of a file, of this process alone: another may write the same file.
pub(super) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}.{ending}", std::process::id()));
    beside.into()
}

/// What is wrong when a file could not be written.
pub fn unwritable(path: &Path) -> impl Fn(io::Error) -> Diagnostic {
    let name = path.display().to_string();
    move |error| Diagnostic::file(&name, Unwritable { why: error.to_string() })
}

/// Who may do what with a file, as Unix has it; of no file, and elsewhere, nobody.
#[cfg(unix)]
pub fn mode(path: &Path) -> u32 {
    use std::os::unix::fs::PermissionsExt;
    fs::metadata(path).map_or(0, |data| data.permissions().mode())
}

#[cfg(not(unix))]
pub fn mode(_: &Path) -> u32 {
    0
}

/// That a result does not take the place of a file that the command reads.
///
/// # Errors
/// Names the file.
pub fn keeps<'a>(out: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<(), Diagnostic> {
    let Ok(out) = fs::canonicalize(out) else { return Ok(()) };
    match inputs.into_iter().find(|input| fs::canonicalize(input).is_ok_and(|input| input == out)) {
        Some(input) => Err(Diagnostic::file(&input.display().to_string(), IsInput)),
        None => Ok(()),
    }
}

/// That what is at `out` is an earlier result of this kind, which begins with `head`, or nothing: it is replaced.
///
/// # Errors
/// It is something else, or cannot be read.
pub fn is_earlier(out: &Path, head: &[u8]) -> Result<(), Diagnostic> {
    if !out.is_file() {
        return Ok(());
    }
    let (name, mut begin) = (out.display().to_string(), Vec::new());
    let file = fs::File::open(out).map_err(unreadable(&name))?;
    file.take(head.len() as u64).read_to_end(&mut begin).map_err(unreadable(&name))?;
    // An export that was cut off is one, too.
    if head.starts_with(&begin) { Ok(()) } else { Err(Diagnostic::file(&name, NoResult)) }
}

/// That nothing is at `out`, or a file with this SHA-256.
///
/// # Errors
/// It has another content, or cannot be read.
pub fn is_same(out: &Path, content_sha256: &str) -> Result<(), Diagnostic> {
    if out.symlink_metadata().is_err() || (out.is_file() && sha256(out)? == content_sha256) {
        return Ok(());
    }
    Err(Diagnostic::file(&out.display().to_string(), OtherContent))
}

/// A directory that no other process of dbbd writes results to while this is held.
#[must_use = "the directory is shared again when this is dropped"]
#[derive(Debug)]
pub struct Exclusive {
    _lock: Option<fs::File>,
}

/// Makes the directory that a set of files goes to, and waits until others have written theirs: no set is mixed.
pub fn exclusive(path: &Path) -> Result<Exclusive, Diagnostic> {
    directory(path)?;
    Ok(Exclusive { _lock: lock(path) })
}

/// Where directories cannot be opened or locked, sets are written as they come.
#[cfg(not(windows))]
fn lock(directory: &Path) -> Option<fs::File> {
    fs::File::open(directory).ok().filter(|directory| directory.lock().is_ok())
}

/// A directory cannot be locked there: a file in it is, which goes with its handle.
#[cfg(windows)]
fn lock(directory: &Path) -> Option<fs::File> {
    use std::os::windows::fs::OpenOptionsExt;
    const DELETE_ON_CLOSE: u32 = 0x0400_0000;
    const SHARING_VIOLATION: i32 = 32;
    const ACCESS_DENIED: i32 = 5;
    let mut options = fs::OpenOptions::new();
    options.write(true).create(true).truncate(true).share_mode(0).custom_flags(DELETE_ON_CLOSE);
    for _ in 0..LOCK_TRIES {
        match options.open(directory.join(".dbbd-lock")) {
            // Another has it, or it is just being deleted.
            Err(error) if matches!(error.raw_os_error(), Some(SHARING_VIOLATION | ACCESS_DENIED)) => {
                super::clock::sleep(0.02);
            }
            opened => return opened.ok(),
        }
    }
    None
}

/// How often a file that another process holds is tried for, 20 ms apart: a directory that cannot be written to is denied
/// for ever.
#[cfg(windows)]
const LOCK_TRIES: usize = 1500;

/// Makes the directory that results go to.
pub fn directory(path: &Path) -> Result<(), Diagnostic> {
    fs::create_dir_all(path).map_err(|error| {
        Diagnostic::file(&path.display().to_string(), NoDirectory { why: error.to_string() })
    })
}

/// Whether two paths are one existing file.
pub fn same_place(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
