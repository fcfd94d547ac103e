//! The runs in the data directory: `NAME/run.dbbd`, and results in `NAME/sync`, `NAME/identify`, `NAME/circle`.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::names;
use crate::catalogue::ServiceFinding::{DataUnreadable, LinkedResults, NoFile, NoResult, NoRun};
use crate::diagnostic::Diagnostic;
use crate::live::{Download, Ended, JobKind, ResultFile, RunEntry, RunState};
use crate::recording::capture::{self, Event, RunEnd};

/// Name of a run's capture.
pub(super) const CAPTURE: &str = "run.dbbd";
/// The begin and the end of a capture tell when it began and how it ended, bytes.
const GLIMPSE: u64 = 4096;
/// Runs that are listed.
const MOST: usize = 500;

fn missing(name: &str) -> Diagnostic {
    NoRun { run: name.into() }.into()
}

/// Where a run lives, or will.
pub(super) fn directory(data: &Path, name: &str) -> Result<PathBuf, Diagnostic> {
    if !names::is_sound(name) {
        return Err(missing(name));
    }
    Ok(data.join(name))
}

/// Whether a path is a directory, and not a link to one.
pub(super) fn is_plain_directory(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|data| data.is_dir())
}

/// Opens what is a file itself: no link leads out of the data directory, no pipe is waited for.
fn open_plain(path: &Path) -> io::Result<File> {
    let no_file = || io::Error::other("is no plain file");
    if !path.parent().is_some_and(is_plain_directory) {
        return Err(no_file());
    }
    let before = fs::symlink_metadata(path)?;
    if !before.is_file() {
        return Err(no_file());
    }
    let file = File::open(path)?;
    // It may have been replaced in between.
    if same_file(&before, &file.metadata()?) { Ok(file) } else { Err(no_file()) }
}

#[cfg(unix)]
fn same_file(one: &fs::Metadata, other: &fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

#[cfg(not(unix))]
fn same_file(_: &fs::Metadata, other: &fs::Metadata) -> bool {
    other.is_file()
}

/// A run that is over and whose results may be written: neither it nor they are links to elsewhere.
pub(super) fn evaluable(data: &Path, name: &str, kind: JobKind) -> Result<PathBuf, Diagnostic> {
    let directory = directory(data, name)?;
    if !is_plain_directory(&directory) || open_plain(&directory.join(CAPTURE)).is_err() {
        return Err(missing(name));
    }
    let results = directory.join(kind.name());
    let plain = match fs::symlink_metadata(&results) {
        Err(error) => error.kind() == io::ErrorKind::NotFound,
        Ok(data) => {
            let mut entries = fs::read_dir(&results).into_iter().flatten().flatten();
            data.is_dir() && entries.all(|entry| entry.file_type().is_ok_and(|kind| !kind.is_symlink()))
        }
    };
    if plain {
        Ok(directory)
    } else {
        Err(LinkedResults { run: name.into(), kind: kind.name().into() }.into())
    }
}

/// All runs, the newest first; `running` is the one that is on.
pub(super) fn list(data: &Path, running: Option<&str>) -> Result<Vec<RunEntry>, Diagnostic> {
    let entries = match fs::read_dir(data) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(DataUnreadable { why: error.to_string() }.into()),
    };
    let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
    let mut runs: Vec<RunEntry> = names.filter_map(|name| entry(data, &name, running).ok()).collect();
    runs.sort_by(|a, b| b.started_unix_ms.cmp(&a.started_unix_ms).then_with(|| b.name.cmp(&a.name)));
    runs.truncate(MOST);
    Ok(runs)
}

/// One run.
pub(super) fn entry(data: &Path, name: &str, running: Option<&str>) -> Result<RunEntry, Diagnostic> {
    let directory = directory(data, name)?;
    if !is_plain_directory(&directory) {
        return Err(missing(name));
    }
    let (first, last, bytes) = glimpse(&directory.join(CAPTURE)).map_err(|_| missing(name))?;
    let started_unix_ms = capture::read(&first).events().find_map(|event| match event {
        Event::Started { unix_ns, .. } => Some(unix_ns / 1_000_000),
        _ => None,
    });
    let ended = capture::read(&last).events().find_map(|event| match event {
        Event::Ended(RunEnd { reason, samples, lost }) => {
            Some(Ended { reason: reason.clone(), samples: *samples, lost: *lost })
        }
        _ => None,
    });
    let state = match (&ended, running == Some(name)) {
        (None, true) => RunState::Running,
        (None, false) => RunState::EndedEarly,
        (Some(_), _) => RunState::Ended,
    };
    Ok(RunEntry { name: name.into(), state, started_unix_ms, bytes, ended, results: results(&directory) })
}

/// The first and the last bytes of a file, and its length.
fn glimpse(path: &Path) -> io::Result<(Vec<u8>, Vec<u8>, u64)> {
    let mut file = open_plain(path)?;
    let length = file.metadata()?.len();
    let (mut first, mut last) = (Vec::new(), Vec::new());
    (&file).take(GLIMPSE).read_to_end(&mut first)?;
    file.seek(SeekFrom::Start(length.saturating_sub(GLIMPSE)))?;
    (&file).take(GLIMPSE).read_to_end(&mut last)?;
    Ok((first, last, length))
}

fn results(directory: &Path) -> Vec<ResultFile> {
    let mut found = Vec::new();
    for kind in JobKind::ALL {
        let results = directory.join(kind.name());
        if !is_plain_directory(&results) {
            continue;
        }
        for entry in fs::read_dir(results).into_iter().flatten().flatten() {
            let Ok(file) = entry.file_name().into_string() else { continue };
            if let Ok(data) = entry.metadata()
                && data.is_file()
                && names::is_sound(&file)
            {
                found.push(ResultFile { kind, file, bytes: data.len() });
            }
        }
    }
    found.sort_by(|a, b| (a.kind.name(), &a.file).cmp(&(b.kind.name(), &b.file)));
    found
}

/// A file of a run, open: its capture or a result.
pub(super) fn open(data: &Path, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Diagnostic> {
    let directory = directory(data, run)?;
    let (path, name) = match result {
        None => (directory.join(CAPTURE), format!("{run}.dbbd")),
        Some((kind, file)) if names::is_sound(file) => {
            (directory.join(kind.name()).join(file), file.to_owned())
        }
        Some((_, file)) => return Err(NoResult { file: file.into() }.into()),
    };
    let gone = || NoFile { run: run.into(), file: name.clone() };
    if !is_plain_directory(&directory) {
        return Err(gone().into());
    }
    let file = open_plain(&path).map_err(|_| gone())?;
    let bytes = file.metadata().map_err(|_| gone())?.len();
    Ok(Download { file, name, bytes })
}
