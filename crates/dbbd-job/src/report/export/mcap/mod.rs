//! A capture as MCAP, the log format that Foxglove, Python's `mcap` and the tools of ROS read.
//!
//! Channels `raw`, `samples`, `faults`, `events`, `gaps`, `axes`; each message is a JSON object with `host_ns`, the capture's
//! own time. Log times are on the wall clock at the beginning of the run. The attachments of the capture are copied.
//! Chunks are not compressed and have checksums.

mod container;

use std::io::{self, Write};

use serde_json::{Map, Value, json};

use container::{Attachment, Container};

use crate::recording::axes::AxesRecords;
use crate::recording::capture::{CaptureRecord, RunEvent, StampedRecord};
use crate::report::ReportFinding;
use dbbd_model::base::FileFinding;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;

/// Names of the channels, in the order of their counts.
pub const CHANNELS: [&str; 6] = ["raw", "samples", "faults", "events", "gaps", "axes"];

/// An index of [`CHANNELS`].
#[derive(Clone, Copy)]
enum Channel {
    Raw,
    Samples,
    Faults,
    Events,
    Gaps,
    Axes,
}

/// An MCAP file that is being written.
pub struct McapFile<W> {
    file: Container<W>,
    channels: [u16; CHANNELS.len()],
    counts: [u32; CHANNELS.len()],
    /// Host time and wall clock (ns since the Unix epoch) at the beginning of the run.
    began: Option<(HostNs, u64)>,
    axes: AxesRecords,
}

impl<W: Write> McapFile<W> {
    pub fn new(to: W) -> Result<Self, Diagnostic> {
        let library = concat!("dbbd ", env!("CARGO_PKG_VERSION"));
        let mut file = Container::new(to, library).map_err(unwritable)?;
        let channels = CHANNELS.map(|name| file.add_channel(name, &format!("dbbd.{name}"), &schema(name)));
        Ok(Self { file, channels, counts: [0; CHANNELS.len()], began: None, axes: AxesRecords::default() })
    }

    /// Appends a record of the capture; an error also if a record that must be JSON is not.
    pub fn add(&mut self, stamped: &StampedRecord) -> Result<(), Diagnostic> {
        let host = stamped.host;
        let mut axes = Vec::new();
        self.axes.add(host, &stamped.record, |place, _, sample| axes.push((place, sample)));
        match &stamped.record {
            CaptureRecord::Attachment { name, content } => self.attach(host, name, content),
            CaptureRecord::Raw(bytes) => {
                let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
                self.message(Channel::Raw, host, json!({ "bytes_hex": hex }))
            }
            CaptureRecord::Samples(samples) => samples.iter().try_for_each(|sample| {
                let value = serde_json::to_value(sample).map_err(|error| not_json("samples", &error))?;
                self.message(Channel::Samples, host, value)
            }),
            CaptureRecord::Axes(_) => axes.into_iter().try_for_each(|(place, sample)| {
                let value = json!({
                    "ticks": sample.ticks, "place": place.word(), "measured_deg": sample.measured_deg,
                    "commanded_deg": sample.commanded_deg,
                });
                self.message(Channel::Axes, host, value)
            }),
            CaptureRecord::Fault(json) => {
                let value = serde_json::from_slice(json).map_err(|error| not_json("fault", &error))?;
                self.message(Channel::Faults, host, value)
            }
            CaptureRecord::Event(event) => {
                if let RunEvent::Started { unix_ns, .. } = event {
                    self.began = Some((host, *unix_ns));
                }
                let value = serde_json::to_value(event).map_err(|error| not_json("event", &error))?;
                if matches!(event, RunEvent::Gap { .. } | RunEvent::Withheld { gaps: 1.., .. }) {
                    self.message(Channel::Gaps, host, value.clone())?;
                }
                self.message(Channel::Events, host, value)
            }
        }
    }

    /// Ends the file; the number of messages in each of [`CHANNELS`].
    pub fn finish(self) -> Result<[u32; CHANNELS.len()], Diagnostic> {
        self.file.finish().map_err(unwritable)?;
        Ok(self.counts)
    }

    fn attach(&mut self, host: HostNs, name: &str, content: &[u8]) -> Result<(), Diagnostic> {
        let at_ns = self.wall_clock(host);
        let media_type = match name.rsplit('.').next() {
            Some("csv") => "text/csv",
            Some("json") => "application/json",
            Some("toml") => "application/toml",
            _ => "application/octet-stream",
        };
        self.file.attach(&Attachment { at_ns, name, media_type, data: content }).map_err(unwritable)
    }

    fn wall_clock(&self, host: HostNs) -> u64 {
        let (began, unix_ns) = self.began.unwrap_or_default();
        unix_ns.saturating_add(host.0.saturating_sub(began.0))
    }

    fn message(&mut self, channel: Channel, host: HostNs, content: Value) -> Result<(), Diagnostic> {
        let mut message = Map::from_iter([("host_ns".to_owned(), json!(host.0))]);
        if let Value::Object(content) = content {
            message.extend(content);
        }
        let at_ns = self.wall_clock(host);
        let (id, count) = (self.channels[channel as usize], &mut self.counts[channel as usize]);
        let sequence = *count;
        *count = count.wrapping_add(1);
        let message = Value::Object(message).to_string();
        self.file.message(id, sequence, at_ns, message.as_bytes()).map_err(unwritable)
    }
}

fn unwritable(error: io::Error) -> Diagnostic {
    FileFinding::Unwritable { why: error.to_string() }.into()
}

fn not_json(record: &str, error: &serde_json::Error) -> Diagnostic {
    ReportFinding::NotJson { record: record.into(), why: error.to_string() }.into()
}

/// The JSON Schema of a channel's messages.
fn schema(channel: &str) -> Vec<u8> {
    let fields: &[(&str, &str)] = match channel {
        "raw" => &[("bytes_hex", "string")],
        "samples" => &[
            ("reading_mm", "number"),
            ("sequence", "integer"),
            ("ticks", "integer"),
            ("trigger", "boolean"),
            ("temperature_c", "number"),
            ("valid", "boolean"),
            ("status", "integer"),
            ("offset", "integer"),
        ],
        "faults" => &[("offset", "integer"), ("bytes", "integer")],
        "gaps" => &[("seconds", "number"), ("missing", "integer"), ("reason", "string")],
        "axes" => &[
            ("ticks", "integer"),
            ("place", "string"),
            ("measured_deg", "array"),
            ("commanded_deg", "array"),
        ],
        _ => &[("event", "string")],
    };
    let host = [("host_ns", "integer")];
    let properties: Map<String, Value> = host
        .iter()
        .chain(fields)
        .map(|(name, kind)| ((*name).to_owned(), json!({ "type": [kind, "null"] })))
        .collect();
    json!({ "type": "object", "properties": properties }).to_string().into_bytes()
}
