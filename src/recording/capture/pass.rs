//! One pass over the records of a capture on disk.

use std::fs::File;
use std::io;
use std::path::Path;

use super::reader::{Damage, Part, Reader};
use super::record::Stamped;
use crate::catalogue::{FileFinding, RecordingFinding};
use crate::diagnostic::Diagnostic;

/// Damages that are reported one by one.
const REPORTED: usize = 20;

/// What a pass found besides the records.
pub struct Pass {
    /// The format's version; none when the header is damaged.
    pub version: Option<u32>,
    /// What could not be read.
    pub damages: Vec<Damage>,
    /// Number of whole records.
    pub records: u64,
}

impl Pass {
    /// Gives each whole record of the capture at `path` to `each`; damages are no error.
    ///
    /// # Errors
    /// When the file cannot be read, holds no whole record, or is of another version; those of `each`.
    pub fn over(
        path: &Path,
        mut each: impl FnMut(Stamped) -> Result<(), Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let name = path.display().to_string();
        let unreadable =
            |error: io::Error| Diagnostic::file(&name, FileFinding::Unreadable { why: error.to_string() });
        let reader = Reader::new(File::open(path).map_err(unreadable)?).map_err(unreadable)?;
        if let Some(other) = reader.other_format() {
            return Err(Diagnostic::file(&name, other));
        }
        let mut pass = Self { version: reader.version(), damages: Vec::new(), records: 0 };
        for part in reader {
            match part.map_err(unreadable)? {
                Part::Record(stamped) => {
                    pass.records += 1;
                    each(stamped)?;
                }
                Part::Damage(damage) => pass.damages.push(damage),
            }
        }
        if pass.records == 0 {
            let is_capture = pass.version.is_some();
            let finding =
                if is_capture { RecordingFinding::NothingLeft } else { RecordingFinding::NoCapture };
            return Err(Diagnostic::file(&name, finding));
        }
        Ok(pass)
    }

    /// The damages, those at the end of many as their number.
    pub fn findings(&self) -> Vec<RecordingFinding> {
        let mut findings: Vec<RecordingFinding> =
            self.damages.iter().take(REPORTED).map(|damage| damage.finding.clone()).collect();
        if let damages @ 1.. = self.damages.len().saturating_sub(REPORTED) {
            findings.push(RecordingFinding::MoreDamages { damages });
        }
        findings
    }

    /// Bytes that could not be read.
    pub fn lost_bytes(&self) -> u64 {
        self.damages.iter().map(|damage| damage.bytes).sum()
    }
}
