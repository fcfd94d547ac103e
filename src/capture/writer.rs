//! Writes a capture, record by record.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::disk::Disk;
use super::format;
use super::record::{Event, Record};
use crate::units::HostNs;

/// Why a capture cannot be written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// There is already a file.
    #[error("capture `{}` exists already\n  help: a capture is never overwritten; choose another name with --out", .0.display())]
    Exists(PathBuf),
    /// The file cannot be made.
    #[error("capture `{}` cannot be made\n  help: its directory must exist and let this user write", .path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The record would not be read back.
    #[error("a record of {0} bytes is too long for a capture")]
    TooLong(usize),
    /// An event that cannot be written as JSON, such as an angle that is no number.
    #[error("an event cannot be written")]
    Event(#[source] serde_json::Error),
    /// The disk.
    #[error("capture `{}` cannot be written on: it ends here, and what is in it is kept ({samples} samples, {bytes} bytes)\n  help: {}", .path.display(), remedy(source))]
    Disk {
        /// The file.
        path: PathBuf,
        /// Samples that stand in it.
        samples: u64,
        /// Bytes that stand in it, whole records all of them.
        bytes: u64,
        /// Why.
        source: io::Error,
    },
}

fn remedy(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "make room on its file system and begin a new run"
        }
        io::ErrorKind::FileTooLarge => "raise the limit of a file's size (`ulimit -f`) and begin a new run",
        _ => "check its file system and begin a new run",
    }
}

/// A capture that is being written.
pub struct Writer {
    disk: Box<dyn Disk>,
    path: PathBuf,
    bytes: u64,
    samples: u64,
}

impl Writer {
    /// Makes a new capture.
    ///
    /// # Errors
    /// When the file exists already or cannot be made.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let wrong = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => WriteError::Exists(path.into()),
            _ => WriteError::Create { path: path.into(), source },
        };
        let file = OpenOptions::new().append(true).create_new(true).open(path).map_err(wrong)?;
        let writer = Self::on(Box::new(file), path);
        if writer.is_err() {
            // Nothing stands in it yet.
            let _ = fs::remove_file(path);
        }
        if cfg!(unix) {
            // A new name outlasts a loss of power only when its directory is on the disk as well.
            let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty());
            File::open(directory.unwrap_or(Path::new(".")))
                .and_then(|file| file.sync_all())
                .map_err(wrong)?;
        }
        writer
    }

    /// Begins a capture on an empty disk; `path` is what messages call it.
    ///
    /// # Errors
    /// When the disk refuses the header.
    pub fn on(disk: Box<dyn Disk>, path: &Path) -> Result<Self, WriteError> {
        let mut writer = Self { disk, path: path.into(), bytes: 0, samples: 0 };
        writer.append(&format::header())?;
        Ok(writer)
    }

    /// Appends a record, whole.
    ///
    /// # Errors
    /// When the disk refuses it; the capture then ends with the record before.
    pub fn write(&mut self, host: HostNs, record: &Record) -> Result<(), WriteError> {
        let bytes = format::encode(host, record).map_err(WriteError::Event)?;
        if bytes.len() > format::LONGEST {
            return Err(WriteError::TooLong(bytes.len()));
        }
        self.append(&bytes)?;
        if let Record::Samples(samples) = record {
            self.samples += samples.len() as u64;
        }
        Ok(())
    }

    /// Appends the record that says that the run ended as it should.
    ///
    /// # Errors
    /// When the disk refuses it.
    pub fn finish(mut self, host: HostNs, reason: &str, lost: u64) -> Result<u64, WriteError> {
        let samples = self.samples;
        self.write(host, &Record::Event(Event::Ended { reason: reason.into(), samples, lost }))?;
        self.sync()?;
        Ok(samples)
    }

    /// Samples written so far.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Has the system put on the disk what was written: for a loss of power, not for a kill.
    ///
    /// # Errors
    /// When the disk refuses it.
    pub fn sync(&mut self) -> Result<(), WriteError> {
        self.disk.sync().map_err(|source| self.refusal(source))
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        match self.disk.write_all(bytes) {
            Ok(()) => {
                self.bytes += bytes.len() as u64;
                Ok(())
            }
            Err(source) => {
                // The part that was written goes; where that fails too, the reader names a torn tail.
                let _ = self.disk.cut(self.bytes);
                Err(self.refusal(source))
            }
        }
    }

    fn refusal(&self, source: io::Error) -> WriteError {
        WriteError::Disk { path: self.path.clone(), samples: self.samples, bytes: self.bytes, source }
    }
}
