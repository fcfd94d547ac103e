//! Writes a capture, record by record.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use super::disk::Disk;
use super::format;
use super::record::{Event, Record};
use crate::base::units::HostNs;
use crate::catalogue::RecordingFinding;
use crate::diagnostic::Diagnostic;

/// A capture that is being written.
pub struct Writer {
    disk: Box<dyn Disk>,
    path: PathBuf,
    bytes: u64,
    samples: u64,
    /// The number of the next record, modulo 2^32.
    number: u32,
}

impl Writer {
    /// Makes a new capture.
    ///
    /// # Errors
    /// When the file exists already or cannot be made.
    pub fn create(path: &Path) -> Result<Self, Diagnostic> {
        let wrong = |error: io::Error| {
            let finding = match error.kind() {
                io::ErrorKind::AlreadyExists => RecordingFinding::CaptureExists,
                _ => RecordingFinding::CaptureNotMade { why: error.to_string() },
            };
            Diagnostic::file(&path.display().to_string(), finding)
        };
        let file = OpenOptions::new().append(true).create_new(true).open(path).map_err(wrong)?;
        let writer = Self::on(Box::new(file), path);
        if writer.is_err() {
            // Nothing is in it yet.
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

    /// Begins a capture on an empty disk; `path` names it in messages.
    ///
    /// # Errors
    /// When the disk refuses the header.
    pub fn on(disk: Box<dyn Disk>, path: &Path) -> Result<Self, Diagnostic> {
        let mut writer = Self { disk, path: path.into(), bytes: 0, samples: 0, number: 0 };
        writer.append(&format::header())?;
        Ok(writer)
    }

    /// Appends a record, whole.
    ///
    /// # Errors
    /// When the disk refuses it; the capture then ends with the record before.
    pub fn write(&mut self, host: HostNs, record: &Record) -> Result<(), Diagnostic> {
        let bytes = format::encode(self.number, host, record)
            .map_err(|error| self.wrong(RecordingFinding::EventNotWritten { why: error.to_string() }))?;
        if bytes.len() > format::LONGEST {
            return Err(self.wrong(RecordingFinding::RecordTooLong { bytes: bytes.len() }));
        }
        self.append(&bytes)?;
        self.number = self.number.wrapping_add(1);
        if let Record::Samples(samples) = record {
            self.samples += samples.len() as u64;
        }
        Ok(())
    }

    /// Appends the record of the run's proper end.
    ///
    /// # Errors
    /// When the disk refuses it.
    pub fn finish(mut self, host: HostNs, reason: &str, lost: u64) -> Result<u64, Diagnostic> {
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
                // The part that was written goes; where that fails too, the reader names a torn tail.
                let _ = self.disk.cut(self.bytes);
                Err(self.refusal(&error))
            }
        }
    }

    fn refusal(&self, error: &io::Error) -> Diagnostic {
        let (why, samples, bytes) = (error.to_string(), self.samples, self.bytes);
        self.wrong(match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                RecordingFinding::DiskFull { why, samples, bytes }
            }
            io::ErrorKind::FileTooLarge => RecordingFinding::FileTooLarge { why, samples, bytes },
            _ => RecordingFinding::DiskFailed { why, samples, bytes },
        })
    }

    fn wrong(&self, finding: RecordingFinding) -> Diagnostic {
        Diagnostic::file(&self.path.display().to_string(), finding)
    }
}
