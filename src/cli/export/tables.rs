//! The records of a capture as CSV tables.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::{Unfinished, unwritten};
use crate::cli::info;
use crate::device::protocol::{Fault, FaultKind};
use crate::diagnostic::Diagnostic;
use crate::recording::capture::{Event, Record, Stamped};

/// One table for each kind of record.
pub(super) struct Tables {
    samples: Table,
    raw: Table,
    events: Table,
    gaps: Table,
    faults: Table,
}

struct Table {
    name: &'static str,
    file: Unfinished,
    writer: csv::Writer<BufWriter<File>>,
    rows: u64,
}

/// A table that is whole.
pub(super) struct Written {
    pub(super) name: &'static str,
    pub(super) path: PathBuf,
    pub(super) rows: u64,
}

/// A float as the shortest text that reads back bit for bit; empty when there is none.
fn cell<T: ToString>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

impl Tables {
    pub(super) fn create(directory: &Path) -> Result<Self, Diagnostic> {
        let table = |name, columns| Table::create(directory, name, columns);
        Ok(Self {
            samples: table(
                "samples.csv",
                "host_ns,sequence,ticks,reading_mm,trigger,valid,temperature_c,status,offset",
            )?,
            raw: table("raw.csv", "host_ns,bytes_hex")?,
            events: table("events.csv", "host_ns,event,detail_json")?,
            gaps: table("gaps.csv", "host_ns,seconds,missing,reason")?,
            faults: table("faults.csv", "host_ns,kind,word,offset,bytes,count")?,
        })
    }

    /// Ends the tables.
    pub(super) fn finish(self) -> Result<Vec<Written>, Diagnostic> {
        let Self { samples, raw, events, gaps, faults } = self;
        [samples, raw, events, gaps, faults].into_iter().map(Table::finish).collect()
    }

    pub(super) fn add(&mut self, stamped: &Stamped) -> Result<(), Diagnostic> {
        let host = stamped.host.0.to_string();
        match &stamped.record {
            Record::Attachment { .. } => Ok(()),
            Record::Raw(bytes) => {
                let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
                self.raw.row([host, hex])
            }
            Record::Samples(samples) => samples.iter().try_for_each(|sample| {
                self.samples.row([
                    host.clone(),
                    cell(sample.sequence),
                    cell(sample.ticks.map(|ticks| ticks.0)),
                    sample.reading_mm.to_string(),
                    cell(sample.trigger.map(u8::from)),
                    u8::from(sample.valid).to_string(),
                    cell(sample.temperature_c),
                    sample.status.to_string(),
                    sample.offset.to_string(),
                ])
            }),
            Record::Fault(json) => {
                let fault: Fault = serde_json::from_slice(json).map_err(|error| self.faults.wrong(&error))?;
                let word = match &fault.kind {
                    FaultKind::Reject(word) => word.clone(),
                    _ => String::new(),
                };
                let kind = info::word(&fault.kind).to_owned();
                let numbers = [fault.offset, fault.bytes, fault.count].map(|number| number.to_string());
                let [offset, bytes, count] = numbers;
                self.faults.row([host, kind, word, offset, bytes, count])
            }
            Record::Event(event) => {
                if let Event::Gap { seconds, missing, reason } = event {
                    self.gaps.row([host.clone(), cell(*seconds), cell(*missing), reason.clone()])?;
                }
                let mut value = serde_json::to_value(event).map_err(|error| self.events.wrong(&error))?;
                let name = value.as_object_mut().and_then(|object| object.remove("event"));
                let name = name.as_ref().and_then(|name| name.as_str()).unwrap_or_default().to_owned();
                self.events.row([host, name, value.to_string()])
            }
        }
    }
}

impl Table {
    fn create(directory: &Path, name: &'static str, columns: &str) -> Result<Self, Diagnostic> {
        let file = Unfinished::of(&directory.join(name));
        let made = File::create(&file.beside).map_err(|error| unwritten(&file.path, &error))?;
        let mut writer = csv::Writer::from_writer(BufWriter::new(made));
        writer.write_record(columns.split(',')).map_err(|error| unwritten(&file.path, &error))?;
        Ok(Self { name, file, writer, rows: 0 })
    }

    fn row<const N: usize>(&mut self, cells: [String; N]) -> Result<(), Diagnostic> {
        self.rows += 1;
        self.writer.write_record(cells).map_err(|error| self.wrong(&error))
    }

    fn wrong(&self, error: &dyn std::error::Error) -> Diagnostic {
        unwritten(&self.file.path, error)
    }

    fn finish(mut self) -> Result<Written, Diagnostic> {
        self.writer.flush().map_err(|error| unwritten(&self.file.path, &error))?;
        self.file.finish()?;
        Ok(Written { name: self.name, path: self.file.path.clone(), rows: self.rows })
    }
}
