//! Reads a whole capture: in one pass over a file, or from memory.

use std::path::Path;

use super::reader::{CaptureDamage, CapturePart, CaptureReader};
use super::record::{CaptureRecord, RunEnd, RunEvent, StampedRecord};
use crate::files;
use crate::recording::RecordingFinding;
use dbbd_model::base::text::unreadable;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;
use dbbd_model::provenance::DataOrigin;

/// Number of damages that are reported individually.
const REPORTED: usize = 20;

/// Summary of one pass over the records of a capture on disk.
pub struct CaptureSummary {
    /// Format version; `None` if the file header is damaged.
    pub version: Option<u32>,
    pub damages: Vec<CaptureDamage>,
    pub records: u64,
    pub samples: u64,
    /// The end of the run; `None` if the run was cut off.
    pub end: Option<RunEnd>,
    /// Where the readings come from; `None` in captures of older versions and of imported traces.
    pub origin: Option<DataOrigin>,
}

impl CaptureSummary {
    /// Calls `each` with every intact record of the capture at `path`. Damage is counted, not an error.
    pub fn over(
        path: &Path,
        mut each: impl FnMut(StampedRecord) -> Result<(), Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let name = path.display().to_string();
        let unreadable = unreadable(&name);
        let reader = CaptureReader::new(files::open(path)?).map_err(&unreadable)?;
        if let Some(other) = reader.other_format() {
            return Err(Diagnostic::file(&name, other));
        }
        let version = reader.version();
        let mut pass = Self { version, damages: Vec::new(), records: 0, samples: 0, end: None, origin: None };
        for part in reader {
            match part.map_err(&unreadable)? {
                CapturePart::Record(stamped) => {
                    pass.count(&stamped.record);
                    each(stamped)?;
                }
                CapturePart::Damage(damage) => pass.damages.push(damage),
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

    fn count(&mut self, record: &CaptureRecord) {
        self.records += 1;
        match record {
            CaptureRecord::Samples(samples) => self.samples += samples.len() as u64,
            CaptureRecord::Event(RunEvent::Ended(end)) => self.end = Some(end.clone()),
            CaptureRecord::Event(RunEvent::Origin { origin })
                if self.origin != Some(DataOrigin::Simulated) =>
            {
                self.origin = Some(*origin);
            }
            CaptureRecord::Attachment { .. }
            | CaptureRecord::Raw(_)
            | CaptureRecord::Fault(_)
            | CaptureRecord::Axes(_)
            | CaptureRecord::Event(_) => {}
        }
    }

    /// Findings about damages (the first ones, then their number), a wrong number of samples, a missing end.
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

    /// The findings of [`Self::findings`], and a finding about samples that were lost before they reached the file.
    pub fn all_findings(&self) -> Vec<RecordingFinding> {
        let samples = self.end.as_ref().map_or(0, |end| end.lost);
        let lost = (samples > 0).then_some(RecordingFinding::SamplesLost { samples });
        self.findings().into_iter().chain(lost).collect()
    }

    /// Number of unreadable bytes.
    pub fn lost_bytes(&self) -> u64 {
        self.damages.iter().map(|damage| damage.bytes).sum()
    }
}

/// A whole capture in memory, and the damages between its records.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Capture {
    pub version: Option<u32>,
    pub records: Vec<StampedRecord>,
    pub damages: Vec<CaptureDamage>,
}

impl Capture {
    pub fn events(&self) -> impl Iterator<Item = &RunEvent> {
        self.records.iter().filter_map(|stamped| {
            if let CaptureRecord::Event(event) = &stamped.record { Some(event) } else { None }
        })
    }

    pub fn samples(&self) -> impl Iterator<Item = (HostNs, &Sample)> {
        self.records.iter().flat_map(|stamped| {
            let samples =
                if let CaptureRecord::Samples(samples) = &stamped.record { &samples[..] } else { &[] };
            samples.iter().map(|sample| (stamped.host, sample))
        })
    }

    /// The last attachment with this name.
    pub fn attachment(&self, wanted: &str) -> Option<&[u8]> {
        self.records.iter().rev().find_map(|stamped| {
            if let CaptureRecord::Attachment { name, content } = &stamped.record
                && name == wanted
            {
                Some(&content[..])
            } else {
                None
            }
        })
    }

    /// Whether the run ended properly; a run that was cut off has no record of its end.
    pub fn ended(&self) -> bool {
        self.events().any(|event| matches!(event, RunEvent::Ended(_)))
    }
}

/// Reads a capture from memory. It never fails: damage is skipped and listed.
pub fn read_capture(bytes: &[u8]) -> Capture {
    let mut capture = Capture::default();
    // Reading from memory does not fail.
    let Ok(reader) = CaptureReader::new(bytes) else { return capture };
    capture.version = reader.version();
    for part in reader.flatten() {
        match part {
            CapturePart::Record(stamped) => capture.records.push(stamped),
            CapturePart::Damage(damage) => capture.damages.push(damage),
        }
    }
    capture
}
