//! Writes a capture, record by record.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::format;
use super::record::{Event, Record};
use crate::units::HostNs;

/// Why a capture cannot be written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// There is already a file.
    #[error("capture `{}` exists already\n  help: a capture is never overwritten; choose another name with --out", .0.display())]
    Exists(PathBuf),
    /// The record would not be read back.
    #[error("a record of {0} bytes is too long for a capture")]
    TooLong(usize),
    /// An event that cannot be written as JSON, such as an angle that is no number.
    #[error("an event cannot be written")]
    Event(#[source] serde_json::Error),
    /// The disk.
    #[error("capture `{}` cannot be written", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// A capture that is being written.
#[derive(Debug)]
pub struct Writer {
    file: File,
    path: PathBuf,
    samples: u64,
}

impl Writer {
    /// Makes a new capture.
    ///
    /// # Errors
    /// When the file exists already or cannot be made.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let made = OpenOptions::new().write(true).create_new(true).open(path);
        let file = made.map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => WriteError::Exists(path.into()),
            _ => WriteError::Io { path: path.into(), source },
        })?;
        let mut writer = Self { file, path: path.into(), samples: 0 };
        writer.append(&format::header())?;
        Ok(writer)
    }

    /// Appends a record, whole.
    ///
    /// # Errors
    /// When the disk refuses it.
    pub fn write(&mut self, host: HostNs, record: &Record) -> Result<(), WriteError> {
        let bytes = format::encode(host, record).map_err(WriteError::Event)?;
        if bytes.len() > format::LONGEST {
            return Err(WriteError::TooLong(bytes.len()));
        }
        self.append(&bytes)?;
        self.samples += u64::from(matches!(record, Record::Sample(_)));
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
        self.file.sync_data().map_err(|source| WriteError::Io { path: self.path.clone(), source })
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.file.write_all(bytes).map_err(|source| WriteError::Io { path: self.path.clone(), source })
    }
}
