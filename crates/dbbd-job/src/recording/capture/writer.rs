//! Writes a capture, record by record, to a disk that may fail.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::format;
use super::record::{CaptureRecord, RunEnd, RunEvent};
use crate::files;
use crate::recording::RecordingFinding;
use dbbd_device::sync::lock;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;

pub struct CaptureWriter {
    disk: Box<dyn Disk>,
    path: PathBuf,
    bytes: u64,
    samples: u64,
    /// The number of the next record, modulo 2^32.
    number: u32,
    /// The file up to the first raw record: header and attachments, without which the rest cannot be read.
    opening: Vec<u8>,
    opened: bool,
    /// The bar's bytes that were written.
    raw_bytes: u64,
    /// Present if records wait for [`Self::flush`].
    waiting: Option<WaitingRecords>,
    sync: Option<SyncThread>,
}

/// Encoded records, and what each of them is.
#[derive(Default)]
struct WaitingRecords {
    bytes: Vec<u8>,
    records: Vec<EncodedRecord>,
}

/// The size of a record, the bar's bytes and the samples in it.
struct EncodedRecord {
    bytes: usize,
    raw: u64,
    samples: u64,
}

impl CaptureWriter {
    pub fn create(path: &Path) -> Result<Self, Diagnostic> {
        let wrong = |error: io::Error| {
            let finding = if error.kind() == ErrorKind::AlreadyExists {
                RecordingFinding::CaptureExists
            } else {
                RecordingFinding::CaptureNotMade { why: error.to_string() }
            };
            Diagnostic::file(path.display().to_string(), finding)
        };
        let file = create(path).map_err(wrong)?;
        Self::on(Box::new(file), path).inspect_err(|_| {
            // The file is still empty.
            let _ = fs::remove_file(path);
        })
    }

    /// Starts a capture on an empty disk; `path` names it in messages.
    pub fn on(disk: Box<dyn Disk>, path: &Path) -> Result<Self, Diagnostic> {
        let mut writer = Self {
            disk,
            path: path.into(),
            bytes: 0,
            samples: 0,
            number: 0,
            opening: format::header(),
            opened: false,
            raw_bytes: 0,
            waiting: None,
            sync: None,
        };
        writer.append(&format::header())?;
        Ok(writer)
    }

    /// From now on records wait for [`Self::flush`], so that a slow disk takes many at once.
    pub fn hold_back(&mut self) {
        self.waiting.get_or_insert_default();
    }

    /// Writes the records that wait. If the disk refuses one, the capture ends with the record before.
    pub fn flush(&mut self) -> Result<(), Diagnostic> {
        if let Some(error) = self.sync.as_ref().and_then(SyncThread::failed) {
            return Err(self.refusal(&error));
        }
        let Some(mut waiting) = self.waiting.take() else { return Ok(()) };
        if !waiting.bytes.is_empty() {
            self.append_all(&waiting)?;
            waiting.bytes.clear();
            waiting.records.clear();
            if let Some(sync) = &self.sync {
                sync.written();
            }
        }
        self.waiting = Some(waiting);
        Ok(())
    }

    fn append_all(&mut self, WaitingRecords { bytes, records }: &WaitingRecords) -> Result<(), Diagnostic> {
        if self.append(bytes).is_ok() {
            records.iter().for_each(|record| self.count(record));
            return Ok(());
        }
        // One by one, so that every record is kept for which there is room.
        let mut rest = bytes.as_slice();
        for record in records {
            let (bytes, after) = rest.split_at(record.bytes.min(rest.len()));
            self.append(bytes)?;
            self.count(record);
            rest = after;
        }
        Ok(())
    }

    fn count(&mut self, written: &EncodedRecord) {
        self.raw_bytes += written.raw;
        self.samples += written.samples;
    }

    /// Syncs the capture to the disk in a thread of its own, so long after each sync. A slow disk delays the next sync, not the
    /// recording.
    pub fn sync_every(&mut self, interval: Duration) -> Result<(), Diagnostic> {
        let second = self.disk.second().map_err(|error| self.refusal(&error))?;
        self.sync = second.map(|disk| SyncThread::start(disk, interval));
        Ok(())
    }

    /// Appends a whole record. If the disk refuses it, the capture ends with the record before.
    pub fn write(&mut self, host: HostNs, record: &CaptureRecord) -> Result<(), Diagnostic> {
        let bytes = format::encode(self.number, host, record)
            .map_err(|error| self.wrong(RecordingFinding::EventNotWritten { why: error.to_string() }))?;
        if bytes.len() > format::MAX_PAYLOAD_BYTES {
            return Err(self.wrong(RecordingFinding::RecordTooLong { bytes: bytes.len() }));
        }
        let raw = if let CaptureRecord::Raw(raw) = record { raw.len() as u64 } else { 0 };
        let samples = if let CaptureRecord::Samples(samples) = record { samples.len() as u64 } else { 0 };
        let encoded = EncodedRecord { bytes: bytes.len(), raw, samples };
        match &mut self.waiting {
            Some(waiting) => {
                waiting.bytes.extend(&bytes);
                waiting.records.push(encoded);
            }
            None => {
                self.append(&bytes)?;
                self.count(&encoded);
            }
        }
        self.number = self.number.wrapping_add(1);
        self.opened |= matches!(record, CaptureRecord::Raw(_));
        if !self.opened {
            self.opening.extend(&bytes);
        }
        Ok(())
    }

    /// Appends the record that marks a proper end.
    pub fn finish(&mut self, host: HostNs, reason: &str, lost: u64) -> Result<(), Diagnostic> {
        self.flush()?;
        let samples = self.samples;
        self.write(
            host,
            &CaptureRecord::Event(RunEvent::Ended(RunEnd { reason: reason.into(), samples, lost })),
        )?;
        self.flush()?;
        self.sync = None;
        self.sync()
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that the file is still in place and unchanged. If not, recording continues in a new file with a copy of
    /// all that was written, or with the opening records if the written data are gone.
    pub fn look_after(&mut self) -> Result<Option<Diagnostic>, Diagnostic> {
        self.flush()?;
        let Some(interference) = self.disk.interference(&self.path, self.bytes) else { return Ok(None) };
        let elsewhere = std::env::temp_dir().join(self.path.file_name().unwrap_or_default());
        let made = free_file(&self.path)
            .or_else(|_| free_file(&elsewhere))
            .map_err(|error| self.wrong(RecordingFinding::CaptureNotMade { why: error.to_string() }))?;
        let (mut file, path) = made;
        let bytes = self.bytes;
        let kept = if let Interference::Resized(found) = interference
            && found < bytes
        {
            self.bytes = self.opening.len() as u64;
            file.write_all(&self.opening)
        } else {
            self.disk.copy(bytes, &mut file)
        };
        kept.map_err(|error| {
            // An incomplete copy is no capture.
            let _ = fs::remove_file(&path);
            self.refusal(&error)
        })?;
        let new = path.display().to_string();
        let finding = self.wrong(match interference {
            Interference::Moved => RecordingFinding::TakenAway { new, bytes },
            Interference::Resized(found) => RecordingFinding::Resized { new, bytes, found },
        });
        (self.disk, self.path) = (Box::new(file), path);
        if let Some(before) = self.sync.take() {
            self.sync_every(before.interval)?;
        }
        Ok(Some(finding))
    }

    /// Number of the bar's bytes that were written.
    pub fn raw_bytes(&self) -> u64 {
        self.raw_bytes
    }

    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Syncs to disk against power failure; a killed process loses nothing that was written.
    pub fn sync(&mut self) -> Result<(), Diagnostic> {
        self.disk.sync().map_err(|error| self.refusal(&error))
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), Diagnostic> {
        match self.disk.write_all(bytes) {
            Ok(()) => {
                self.bytes += bytes.len() as u64;
                Ok(())
            }
            Err(error) => {
                // Cut off the partial record. If that fails too, the reader reports a torn tail.
                let _ = self.disk.cut(self.bytes);
                Err(self.refusal(&error))
            }
        }
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the kinds of errors of the system are open")]
    fn refusal(&self, error: &io::Error) -> Diagnostic {
        let (why, samples, bytes) = (error.to_string(), self.samples, self.bytes);
        self.wrong(match error.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
                RecordingFinding::DiskFull { why, samples, bytes }
            }
            ErrorKind::FileTooLarge => RecordingFinding::FileTooLarge { why, samples, bytes },
            _ => RecordingFinding::DiskFailed { why, samples, bytes },
        })
    }

    fn wrong(&self, finding: RecordingFinding) -> Diagnostic {
        Diagnostic::file(self.path.display().to_string(), finding)
    }
}

/// The thread that syncs a capture. It ends when it is dropped, after the sync that it is in.
struct SyncThread {
    interval: Duration,
    shared: Arc<(Mutex<SyncState>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct SyncState {
    /// Whether something was written since the last sync.
    is_written: bool,
    ends: bool,
    failed: Option<io::Error>,
}

impl SyncThread {
    fn start(mut disk: Box<dyn Disk>, interval: Duration) -> Self {
        let shared: Arc<(Mutex<SyncState>, Condvar)> = Arc::default();
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::spawn(move || {
            let (state, changed) = &*of_thread;
            loop {
                let idle = |state: &mut SyncState| !state.ends && !state.is_written;
                let mut now = changed.wait_while(lock(state), idle).unwrap_or_else(PoisonError::into_inner);
                if now.ends {
                    return;
                }
                now.is_written = false;
                drop(now);
                let failed = disk.sync().err();
                let mut now = lock(state);
                if failed.is_some() {
                    now.failed = failed;
                    return;
                }
                drop(changed.wait_timeout_while(now, interval, |state| !state.ends));
            }
        });
        Self { interval, shared, thread: Some(thread) }
    }

    fn written(&self) {
        lock(&self.shared.0).is_written = true;
        self.shared.1.notify_one();
    }

    fn failed(&self) -> Option<io::Error> {
        lock(&self.shared.0).failed.take()
    }
}

impl Drop for SyncThread {
    fn drop(&mut self) {
        lock(&self.shared.0).ends = true;
        self.shared.1.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was already reported on stderr.
            let _ = thread.join();
        }
    }
}

/// Creates the file at `wanted`, or beside it at the first free name with a number. A missing directory is created.
fn free_file(wanted: &Path) -> io::Result<(File, PathBuf)> {
    /// Limit of the search.
    const MAX_NAME_NUMBER: u32 = 10_000;
    if let Some(directory) = wanted.parent() {
        fs::create_dir_all(directory)?;
    }
    let mut path = wanted.to_owned();
    for number in 2..MAX_NAME_NUMBER {
        match create(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            made => return made.map(|file| (file, path)),
        }
        let mut name = wanted.file_stem().unwrap_or_default().to_owned();
        name.push(format!("-{number}"));
        path = wanted.with_file_name(name);
        if let Some(extension) = wanted.extension() {
            path.as_mut_os_string().push(".");
            path.as_mut_os_string().push(extension);
        }
    }
    Err(ErrorKind::AlreadyExists.into())
}

/// An append-only file. Tests replace it with a disk that stalls or is full.
pub trait Disk: Write + Send {
    /// Flushes to stable storage, so that the data survive a power failure.
    fn sync(&mut self) -> io::Result<()>;

    /// A second handle of the file, through which another thread syncs it; `None` if a sync takes no time.
    fn second(&self) -> io::Result<Option<Box<dyn Disk>>> {
        Ok(None)
    }

    /// Truncates to `bytes`.
    fn cut(&mut self, bytes: u64) -> io::Result<()>;

    /// The change by another process of the file at `path`, to which `bytes` were written; `None` if it is unchanged.
    fn interference(&self, _path: &Path, _bytes: u64) -> Option<Interference> {
        None
    }

    /// Copies the written data, even if no path leads to the file any more.
    fn copy(&mut self, _bytes: u64, _to: &mut File) -> io::Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

/// A capture that is not kept.
impl Disk for io::Sink {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn cut(&mut self, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn copy(&mut self, _: u64, _: &mut File) -> io::Result<()> {
        Ok(())
    }
}

/// A change by another process of a file that is being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interference {
    /// Removed, renamed or replaced: the path no longer leads to it.
    Moved,
    /// Its size in bytes, which is not the number of bytes written.
    Resized(u64),
}

/// A file opened in append mode continues at its new end after a cut.
impl Disk for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn second(&self) -> io::Result<Option<Box<dyn Disk>>> {
        Ok(Some(Box::new(self.try_clone()?)))
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
            // Without permission to search the directory, the file may still be there.
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

/// Tells a file from another one at the same path.
#[cfg(unix)]
fn identity(file: &Metadata) -> [u64; 2] {
    use std::os::unix::fs::MetadataExt;
    [file.dev(), file.ino()]
}

/// The standard library has no file number here.
#[cfg(not(unix))]
fn identity(file: &Metadata) -> Option<std::time::SystemTime> {
    file.created().ok()
}

/// Creates a file in append mode that other users of this machine cannot read.
fn create(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).append(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o640);
    let file = options.open(path)?;
    if cfg!(unix) {
        // A new name survives a power failure only if its directory is synced too.
        File::open(files::directory_of(path)).and_then(|file| file.sync_all())?;
    }
    Ok(file)
}
