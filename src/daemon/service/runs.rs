//! The runs in the data directory: captures `NAME/run.dbbd`, and results in `NAME/sync`, `NAME/identify`,
//! `NAME/circle`.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::live::ServiceFinding::{DataUnreadable, LinkedResults, NoFile, NoResult, NoRun};
use crate::live::{Ended, JobKind, ResultFile, RunEntry, RunState};
use dbbd_job::page::Download;
use dbbd_job::recording::capture::{self, RunEnd, RunEvent};
use dbbd_model::diagnostic::Diagnostic;

pub(super) const CAPTURE: &str = "run.dbbd";
/// Bytes at the begin and the end of a capture that are read for its entry.
const GLIMPSE: u64 = 4096;
/// Runs that are listed.
const MAX_LISTED_RUNS: usize = 500;

/// Longest name of a run, a plan or a file, bytes.
const LONGEST_NAME: usize = 64;
/// Device names of Windows. The last two are followed by a digit.
const WINDOWS_DEVICES: [&str; 6] = ["con", "prn", "aux", "nul", "com", "lpt"];

/// Whether a name from a client may be a file name: letters, digits, `.`, `_`, `-` without a leading dot or dash, so
/// that it is no path, no hidden file and no command option. Names that Windows reserves are refused, so that runs can
/// be copied there.
pub(super) fn is_sound(name: &str) -> bool {
    let sound = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    name.len() <= LONGEST_NAME
        && name.bytes().all(sound)
        && name.bytes().next().is_some_and(|first| first.is_ascii_alphanumeric())
        && !name.ends_with('.')
        && !is_windows_device(name)
}

/// `con`, `NUL.txt`, `COM5`.
fn is_windows_device(name: &str) -> bool {
    let stem = name.split('.').next().unwrap_or_default().to_ascii_lowercase();
    let numbered = stem.len() == 4 && stem.ends_with(|last: char| last.is_ascii_digit());
    let kind = if numbered { &stem[..3] } else { &stem[..] };
    WINDOWS_DEVICES.iter().position(|device| *device == kind).is_some_and(|place| numbered == (place >= 4))
}

fn missing(name: &str) -> Diagnostic {
    NoRun { run: name.into() }.into()
}

pub(super) fn directory(data: &Path, name: &str) -> Result<PathBuf, Diagnostic> {
    if !is_sound(name) {
        return Err(missing(name));
    }
    Ok(data.join(name))
}

/// Whether a path is a directory and not a link.
pub(super) fn is_plain_directory(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|data| data.is_dir())
}

pub(super) fn is_plain_file(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|data| data.is_file())
}

/// Opens a regular file: no link, which could lead out of the data directory, and no pipe, which could block.
pub(super) fn open_plain(path: &Path) -> io::Result<File> {
    let no_file = || io::Error::other("is no plain file");
    if !path.parent().is_some_and(is_plain_directory) {
        return Err(no_file());
    }
    let before = fs::symlink_metadata(path)?;
    if !before.is_file() {
        return Err(no_file());
    }
    let file = File::open(path)?;
    // The file may have been replaced in between.
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

/// The directory of a run whose results may be written: neither it nor its results are links.
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

/// All runs, the newest first; `running` is the run in progress.
pub(super) fn list_recorded_runs(data: &Path, running: Option<&str>) -> Result<Vec<RunEntry>, Diagnostic> {
    let entries = match fs::read_dir(data) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(DataUnreadable { why: error.to_string() }.into()),
    };
    let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
    let mut runs: Vec<RunEntry> = names.filter_map(|name| entry(data, &name, running).ok()).collect();
    runs.sort_by(|a, b| b.started_unix_ms.cmp(&a.started_unix_ms).then_with(|| b.name.cmp(&a.name)));
    runs.truncate(MAX_LISTED_RUNS);
    Ok(runs)
}

pub(super) fn entry(data: &Path, name: &str, running: Option<&str>) -> Result<RunEntry, Diagnostic> {
    let directory = directory(data, name)?;
    if !is_plain_directory(&directory) {
        return Err(missing(name));
    }
    entry_of(name, &directory.join(CAPTURE), running, results(&directory))
}

/// The entry of a capture.
pub(super) fn entry_of(
    name: &str,
    path: &Path,
    running: Option<&str>,
    results: Vec<ResultFile>,
) -> Result<RunEntry, Diagnostic> {
    let (first, last, bytes) = glimpse(path).map_err(|_| missing(name))?;
    let started_unix_ms = capture::read_capture(&first).events().find_map(|event| {
        if let RunEvent::Started { unix_ns, .. } = event { Some(unix_ns / 1_000_000) } else { None }
    });
    let ended = capture::read_capture(&last).events().find_map(|event| {
        if let RunEvent::Ended(RunEnd { reason, samples, lost }) = event {
            Some(Ended { reason: reason.clone(), samples: *samples, lost: *lost })
        } else {
            None
        }
    });
    let state = match (&ended, running == Some(name)) {
        (None, true) => RunState::Running,
        (None, false) => RunState::EndedEarly,
        (Some(_), _) => RunState::Ended,
    };
    Ok(RunEntry { name: name.into(), state, started_unix_ms, bytes, ended, is_check: false, results })
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
                && is_sound(&file)
            {
                found.push(ResultFile { kind, file, bytes: data.len() });
            }
        }
    }
    found.sort_by(|a, b| (a.kind.name(), &a.file).cmp(&(b.kind.name(), &b.file)));
    found
}

/// Opens the capture of a run or a file of its results.
pub(super) fn open_download(
    data: &Path,
    run: &str,
    result: Option<(JobKind, &str)>,
) -> Result<Download, Diagnostic> {
    let directory = directory(data, run)?;
    let (path, name) = match result {
        None => (directory.join(CAPTURE), format!("{run}.dbbd")),
        Some((kind, file)) if is_sound(file) => (directory.join(kind.name()).join(file), file.to_owned()),
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

#[cfg(test)]
mod tests {
    use super::is_sound;

    #[test]
    fn unsafe_file_names_are_refused() {
        for name in ["run-1", "2026-11-21_cell.3", "a", "com10", "console", "con-1", "com"] {
            assert!(is_sound(name), "{name}");
        }
        let long = "a".repeat(65);
        for name in [
            "", ".", "..", "../a", "a/b", "a\\b", "/etc", ".hidden", "-rf", "a\0", "é", "a b", "NUL",
            "con.txt", "Com5", "lpt1.a", "a.", &long,
        ] {
            assert!(!is_sound(name), "{name:?}");
        }
    }
}
