//! The records of a capture as CSV tables.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use crate::cli::info;
use dbbd_device::protocol::{LineFault, LineFaultKind};
use dbbd_job::file_set::EarlierFiles;
use dbbd_job::files::{self, UnfinishedFile};
use dbbd_job::recording::axes::AxesRecords;
use dbbd_job::recording::capture::{CaptureRecord, RunEvent, StampedRecord};
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::AXES;

/// One table for each kind of record.
pub(super) struct CaptureTables {
    samples: CaptureTable,
    raw: CaptureTable,
    events: CaptureTable,
    gaps: CaptureTable,
    faults: CaptureTable,
    /// Created with the first record of axes.
    axes: Option<CaptureTable>,
    received: AxesRecords,
    directory: PathBuf,
    earlier: EarlierFiles,
}

struct CaptureTable {
    name: &'static str,
    path: PathBuf,
    file: UnfinishedFile,
    writer: csv::Writer<BufWriter<File>>,
    rows: u64,
}

const AXES_COLUMNS: &str = "host_ns,ticks,place,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,commanded1_deg,commanded2_deg,\
commanded3_deg,commanded4_deg,commanded5_deg,commanded6_deg";

/// A finished table.
pub(super) struct WrittenTable {
    pub(super) name: &'static str,
    pub(super) path: PathBuf,
    pub(super) rows: u64,
}

/// The text of a value; empty for `None`. A float is written as the shortest text that reads back bit for bit.
fn cell<T: ToString>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

impl CaptureTables {
    pub(super) fn create(directory: &Path, earlier: EarlierFiles) -> Result<Self, Diagnostic> {
        let table = |name, columns| CaptureTable::create(directory, earlier, name, columns);
        Ok(Self {
            samples: table(
                "samples.csv",
                "host_ns,sequence,ticks,reading_mm,trigger,valid,temperature_c,status,offset",
            )?,
            raw: table("raw.csv", "host_ns,bytes_hex")?,
            events: table("events.csv", "host_ns,event,detail_json")?,
            gaps: table("gaps.csv", "host_ns,seconds,missing,reason")?,
            faults: table("faults.csv", "host_ns,kind,word,offset,bytes,count")?,
            axes: None,
            received: AxesRecords::default(),
            directory: directory.to_owned(),
            earlier,
        })
    }

    pub(super) fn finish(self) -> Result<Vec<WrittenTable>, Diagnostic> {
        let Self { samples, raw, events, gaps, faults, axes, .. } = self;
        [samples, raw, events, gaps, faults].into_iter().chain(axes).map(CaptureTable::finish).collect()
    }

    pub(super) fn add(&mut self, stamped: &StampedRecord) -> Result<(), Diagnostic> {
        let host = stamped.host.0.to_string();
        match &stamped.record {
            CaptureRecord::Attachment { .. } => Ok(()),
            CaptureRecord::Raw(bytes) => {
                let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
                self.raw.row([host, hex])
            }
            CaptureRecord::Samples(samples) => samples.iter().try_for_each(|sample| {
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
            CaptureRecord::Axes(_) => self.add_axes(stamped),
            CaptureRecord::Fault(json) => {
                let fault: LineFault =
                    serde_json::from_slice(json).map_err(|error| self.faults.wrong(&error))?;
                let word =
                    if let LineFaultKind::Reject(word) = &fault.kind { word.clone() } else { String::new() };
                let kind = info::fault_word(&fault.kind).to_owned();
                let numbers = [fault.offset, fault.bytes, fault.count].map(|number| number.to_string());
                let [offset, bytes, count] = numbers;
                self.faults.row([host, kind, word, offset, bytes, count])
            }
            CaptureRecord::Event(event) => {
                if let RunEvent::Gap { seconds, missing, reason } = event {
                    self.gaps.row([host.clone(), cell(*seconds), cell(*missing), reason.clone()])?;
                }
                if let RunEvent::Withheld { gaps: gaps @ 1.., missing, .. } = event {
                    let reason = format!("{gaps} further gaps within a second");
                    self.gaps.row([host.clone(), String::new(), missing.to_string(), reason])?;
                }
                let mut value = serde_json::to_value(event).map_err(|error| self.events.wrong(&error))?;
                let name = value.as_object_mut().and_then(|object| object.remove("event"));
                let name = name.as_ref().and_then(|name| name.as_str()).unwrap_or_default().to_owned();
                self.received.add(stamped.host, &stamped.record, |_, _, _| {});
                self.events.row([host, name, value.to_string()])
            }
        }
    }

    fn add_axes(&mut self, stamped: &StampedRecord) -> Result<(), Diagnostic> {
        let mut samples = Vec::new();
        self.received.add(stamped.host, &stamped.record, |place, _, sample| samples.push((place, sample)));
        let table = match &mut self.axes {
            Some(table) => table,
            none => {
                none.insert(CaptureTable::create(&self.directory, self.earlier, "axes.csv", AXES_COLUMNS)?)
            }
        };
        samples.into_iter().try_for_each(|(place, sample)| {
            let commanded = sample.commanded_deg.map_or([None; AXES], |axes| axes.map(Some));
            let head = [stamped.host.0.to_string(), sample.ticks.0.to_string(), place.word().to_owned()];
            let measured = sample.measured_deg.map(|deg| deg.to_string());
            table.row(head.into_iter().chain(measured).chain(commanded.map(cell)))
        })
    }
}

impl CaptureTable {
    fn create(
        directory: &Path,
        earlier: EarlierFiles,
        name: &'static str,
        columns: &str,
    ) -> Result<Self, Diagnostic> {
        let path = directory.join(name);
        earlier.check(&path)?;
        files::is_earlier(&path, columns.as_bytes())?;
        let (file, content) = UnfinishedFile::create(&path)?;
        let mut writer = csv::Writer::from_writer(BufWriter::new(content));
        writer.write_record(columns.split(',')).map_err(|error| unwritten(&path, &error))?;
        Ok(Self { name, path, file, writer, rows: 0 })
    }

    fn row(&mut self, cells: impl IntoIterator<Item = String>) -> Result<(), Diagnostic> {
        self.rows += 1;
        self.writer.write_record(cells).map_err(|error| self.wrong(&error))
    }

    fn wrong(&self, error: &dyn std::error::Error) -> Diagnostic {
        unwritten(&self.path, error)
    }

    fn finish(mut self) -> Result<WrittenTable, Diagnostic> {
        self.writer.flush().map_err(|error| unwritten(&self.path, &error))?;
        // Closes the file.
        drop(self.writer);
        self.file.finish()?;
        Ok(WrittenTable { name: self.name, path: self.path, rows: self.rows })
    }
}

fn unwritten(path: &Path, error: &dyn std::error::Error) -> Diagnostic {
    Diagnostic::file(path.display(), FileFinding::Unwritable { why: error.to_string() })
}
