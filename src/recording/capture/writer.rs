//! Writes a capture, record by record.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::disk::{self, Disk, Interference};
use super::format;
use super::record::{Event, Record, RunEnd};
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
    /// The bytes before the first raw record: the header, and the files without which nothing else is understood.
    opening: Vec<u8>,
    opened: bool,
}

impl Writer {
    /// Makes a new capture.
    pub fn create(path: &Path) -> Result<Self, Diagnostic> {
        let wrong = |error: io::Error| {
            let finding = match error.kind() {
                io::ErrorKind::AlreadyExists => RecordingFinding::CaptureExists,
                _ => RecordingFinding::CaptureNotMade { why: error.to_string() },
            };
            Diagnostic::file(&path.display().to_string(), finding)
        };
        let file = disk::create(path).map_err(wrong)?;
        Self::on(Box::new(file), path).inspect_err(|_| {
            // Nothing is in it yet.
            let _ = fs::remove_file(path);
        })
    }

    /// Begins a capture on an empty disk; `path` names it in messages.
    pub fn on(disk: Box<dyn Disk>, path: &Path) -> Result<Self, Diagnostic> {
        let mut writer = Self {
            disk,
            path: path.into(),
            bytes: 0,
            samples: 0,
            number: 0,
            opening: format::header(),
            opened: false,
        };
        writer.append(&format::header())?;
        Ok(writer)
    }

    /// Appends a record, whole; a capture whose disk refuses it ends with the record before.
    pub fn write(&mut self, host: HostNs, record: &Record) -> Result<(), Diagnostic> {
        let bytes = format::encode(self.number, host, record)
            .map_err(|error| self.wrong(RecordingFinding::EventNotWritten { why: error.to_string() }))?;
        if bytes.len() > format::LONGEST {
            return Err(self.wrong(RecordingFinding::RecordTooLong { bytes: bytes.len() }));
        }
        self.append(&bytes)?;
        self.number = self.number.wrapping_add(1);
        self.opened |= matches!(record, Record::Raw(_));
        if !self.opened {
            self.opening.extend(&bytes);
        }
        if let Record::Samples(samples) = record {
            self.samples += samples.len() as u64;
        }
        Ok(())
    }

    /// Appends the record of the run's proper end.
    pub fn finish(&mut self, host: HostNs, reason: &str, lost: u64) -> Result<(), Diagnostic> {
        let samples = self.samples;
        self.write(host, &Record::Event(Event::Ended(RunEnd { reason: reason.into(), samples, lost })))?;
        self.sync()
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Looks whether the capture is where it was, as it was written. Where others took it away, recording goes on in a
    /// new file: with all that was written, or, where that is gone, with what makes the rest readable.
    pub fn look_after(&mut self) -> Result<Option<Diagnostic>, Diagnostic> {
        let Some(interference) = self.disk.interference(&self.path, self.bytes) else { return Ok(None) };
        let elsewhere = std::env::temp_dir().join(self.path.file_name().unwrap_or_default());
        let made = free_file(&self.path)
            .or_else(|_| free_file(&elsewhere))
            .map_err(|error| self.wrong(RecordingFinding::CaptureNotMade { why: error.to_string() }))?;
        let (mut file, path) = made;
        let bytes = self.bytes;
        let kept = match interference {
            Interference::Resized(found) if found < bytes => {
                self.bytes = self.opening.len() as u64;
                file.write_all(&self.opening)
            }
            _ => self.disk.copy(bytes, &mut file),
        };
        kept.map_err(|error| {
            // What is in it is no capture.
            let _ = fs::remove_file(&path);
            self.refusal(&error)
        })?;
        let new = path.display().to_string();
        let finding = self.wrong(match interference {
            Interference::Moved => RecordingFinding::TakenAway { new, bytes },
            Interference::Resized(found) => RecordingFinding::Resized { new, bytes, found },
        });
        (self.disk, self.path) = (Box::new(file), path);
        Ok(Some(finding))
    }

    /// Samples written so far.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Has the system put on the disk what was written: for a loss of power, not for a kill.
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

/// A file at the path, or beside it with a number behind its name: the first that is free. Its directory is made again.
fn free_file(wanted: &Path) -> io::Result<(File, PathBuf)> {
    /// So many captures are never taken away from one run.
    const MOST: u32 = 10_000;
    if let Some(directory) = wanted.parent() {
        fs::create_dir_all(directory)?;
    }
    let mut path = wanted.to_owned();
    for number in 2..MOST {
        match disk::create(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
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
    Err(io::ErrorKind::AlreadyExists.into())
}
