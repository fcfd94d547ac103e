//! A whole capture in memory, for what is small.

use super::reader::{Damage, Part, Reader};
use super::record::{Event, Record, Stamped};
use crate::base::units::HostNs;
use crate::measurement::sample::Sample;

/// What a capture holds, and what of it could not be read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Capture {
    /// The format's version by the file's header; none when the header is damaged.
    pub version: Option<u32>,
    pub records: Vec<Stamped>,
    /// What is between them.
    pub damages: Vec<Damage>,
}

impl Capture {
    pub fn events(&self) -> impl Iterator<Item = &Event> {
        self.records.iter().filter_map(|stamped| match &stamped.record {
            Record::Event(event) => Some(event),
            _ => None,
        })
    }

    /// The samples with their host times, in order.
    pub fn samples(&self) -> impl Iterator<Item = (HostNs, &Sample)> {
        self.records.iter().flat_map(|stamped| {
            let samples = match &stamped.record {
                Record::Samples(samples) => &samples[..],
                _ => &[],
            };
            samples.iter().map(|sample| (stamped.host, sample))
        })
    }

    /// The content of an attachment, the last of that name.
    pub fn attachment(&self, wanted: &str) -> Option<&[u8]> {
        self.records.iter().rev().find_map(|stamped| match &stamped.record {
            Record::Attachment { name, content } if name == wanted => Some(&content[..]),
            _ => None,
        })
    }

    /// Whether the run ended as it should; one that was cut off has no such record.
    pub fn ended(&self) -> bool {
        self.events().any(|event| matches!(event, Event::Ended(_)))
    }
}

/// Reads the bytes of a capture. Whole records are found again after each damage; no bytes make it fail.
pub fn read(bytes: &[u8]) -> Capture {
    let mut capture = Capture::default();
    // Bytes in memory do not fail.
    let Ok(reader) = Reader::new(bytes) else { return capture };
    capture.version = reader.version();
    for part in reader.flatten() {
        match part {
            Part::Record(stamped) => capture.records.push(stamped),
            Part::Damage(damage) => capture.damages.push(damage),
        }
    }
    capture
}
