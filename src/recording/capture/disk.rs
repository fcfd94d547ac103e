//! Where a capture goes.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;

use crate::base::files;

/// A file that only grows, or its replacement in a test: a disk that stalls or is full.
pub trait Disk: Write + Send {
    /// Has what was written put where a loss of power does not reach it.
    fn sync(&mut self) -> io::Result<()>;

    /// Drops what was written beyond `bytes`.
    fn cut(&mut self, bytes: u64) -> io::Result<()>;

    /// What others did to the file at `path`, to which `bytes` were written; none while it is there with all of them.
    fn interference(&self, _path: &Path, _bytes: u64) -> Option<Interference> {
        None
    }

    /// Copies what was written, also where no path leads to it any more.
    fn copy(&mut self, _bytes: u64, _to: &mut File) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

/// What others did to a file that is being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interference {
    /// It was removed, renamed or replaced: its path does not lead to it.
    Moved,
    /// It has so many bytes, which are not those that were written.
    Resized(u64),
}

/// Opened to append, a file goes on at its end after a cut.
impl Disk for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn cut(&mut self, bytes: u64) -> io::Result<()> {
        self.set_len(bytes)
    }

    fn interference(&self, path: &Path, bytes: u64) -> Option<Interference> {
        let Ok(own) = self.metadata() else { return Some(Interference::Moved) };
        if own.len() != bytes {
            return Some(Interference::Resized(own.len()));
        }
        let moved = match fs::metadata(path) {
            Ok(there) => identity(&there) != identity(&own),
            // A directory that may not be looked into may still hold it.
            Err(error) => matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory),
        };
        moved.then_some(Interference::Moved)
    }

    fn copy(&mut self, bytes: u64, to: &mut File) -> io::Result<()> {
        self.seek(SeekFrom::Start(0))?;
        match io::copy(&mut self.take(bytes), to)? {
            copied if copied == bytes => Ok(()),
            _ => Err(ErrorKind::UnexpectedEof.into()),
        }
    }
}

/// What distinguishes a file from others at the same path.
#[cfg(unix)]
fn identity(file: &Metadata) -> [u64; 2] {
    use std::os::unix::fs::MetadataExt;
    [file.dev(), file.ino()]
}

/// The standard library gives no number of the file.
#[cfg(not(unix))]
fn identity(file: &Metadata) -> Option<std::time::SystemTime> {
    file.created().ok()
}

/// Makes a file to append to, which others of this machine cannot read.
pub(super) fn create(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).append(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o640);
    let file = options.open(path)?;
    if cfg!(unix) {
        // A new name outlasts a loss of power only when its directory is on the disk as well.
        File::open(files::directory_of(path)).and_then(|file| file.sync_all())?;
    }
    Ok(file)
}
