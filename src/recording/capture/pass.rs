//! One pass over the records of a capture on disk.

use std::fs::File;
use std::path::Path;

use super::reader::{Damage, Part, Reader};
use super::record::{Event, Record, RunEnd, Stamped};
use crate::base::files;
use crate::catalogue::RecordingFinding;
use crate::diagnostic::Diagnostic;

/// Damages that are reported one by one.
const REPORTED: usize = 20;

/// What a pass found besides the records.
pub struct Pass {
    /// The format's version; none when the header is damaged.
    pub version: Option<u32>,
    /// What could not be read.
    pub damages: Vec<Damage>,
    pub records: u64,
    /// Number of samples in them.
    pub samples: u64,
    /// The record of the run's end; none when it was cut off.
    pub end: Option<RunEnd>,
}

impl Pass {
    /// Gives each whole record of the capture at `path` to `each`; damages are no error.
    pub fn over(
        path: &Path,
        mut each: impl FnMut(Stamped) -> Result<(), Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let name = path.display().to_string();
        let unreadable = files::unreadable(&name);
        let reader = Reader::new(File::open(path).map_err(&unreadable)?).map_err(&unreadable)?;
        if let Some(other) = reader.other_format() {
            return Err(Diagnostic::file(&name, other));
        }
        let version = reader.version();
        let mut pass = Self { version, damages: Vec::new(), records: 0, samples: 0, end: None };
        for part in reader {
            match part.map_err(&unreadable)? {
                Part::Record(stamped) => {
                    pass.count(&stamped.record);
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

    fn count(&mut self, record: &Record) {
        self.records += 1;
        match record {
            Record::Samples(samples) => self.samples += samples.len() as u64,
            Record::Event(Event::Ended(end)) => self.end = Some(end.clone()),
            _ => {}
        }
    }

    /// What the file lacks: the damages, those at the end of many as their number, samples, the end.
    pub fn findings(&self) -> Vec<RecordingFinding> {
        let mut findings: Vec<RecordingFinding> =
            self.damages.iter().take(REPORTED).map(|damage| damage.finding.clone()).collect();
        if let damages @ 1.. = self.damages.len().saturating_sub(REPORTED) {
            findings.push(RecordingFinding::MoreDamages { damages });
        }
        findings.extend(match self.end {
            None => Some(RecordingFinding::CutOff),
            Some(RunEnd { samples: ended, .. }) => (ended != self.samples)
                .then_some(RecordingFinding::OtherCount { ended, samples: self.samples }),
        });
        findings
    }

    /// What the file lacks, and what did not reach it.
    pub fn doubts(&self) -> Vec<RecordingFinding> {
        let samples = self.end.as_ref().map_or(0, |end| end.lost);
        let lost = (samples > 0).then_some(RecordingFinding::SamplesLost { samples });
        self.findings().into_iter().chain(lost).collect()
    }

    /// Bytes that could not be read.
    pub fn lost_bytes(&self) -> u64 {
        self.damages.iter().map(|damage| damage.bytes).sum()
    }
}
