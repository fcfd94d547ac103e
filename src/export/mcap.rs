//! A capture as MCAP, the log format that Foxglove, Python's `mcap` and the tools of ROS read.
//!
//! Channels `raw`, `samples`, `faults`, `events`, `gaps`, each message a JSON object with `host_ns`, the
//! capture's own time; a message's log time is that on the wall clock at which the run began. The
//! capture's attachments are the file's. Chunks are not compressed and carry checksums.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use ::mcap::records::MessageHeader;
use ::mcap::{Attachment, McapError, WriteOptions};
use serde_json::{Map, Value, json};
use thiserror::Error;

use crate::capture::{Event, Record, Stamped};
use crate::units::HostNs;

/// Names of the channels, in the order of their counts.
pub const CHANNELS: [&str; 5] = ["raw", "samples", "faults", "events", "gaps"];
const RAW: usize = 0;
const SAMPLES: usize = 1;
const FAULTS: usize = 2;
const EVENTS: usize = 3;
const GAPS: usize = 4;

/// Why a file cannot be written.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The file.
    #[error("the MCAP file cannot be written")]
    Mcap(#[from] McapError),
    /// A record whose content is no JSON.
    #[error("a record cannot be written as JSON")]
    Json(#[from] serde_json::Error),
}

/// An MCAP file that is being written.
pub struct McapFile<W: Write + Seek> {
    writer: ::mcap::Writer<W>,
    channels: Vec<u16>,
    counts: [u32; CHANNELS.len()],
    /// Host time and wall clock (ns since the Unix epoch) of the run's beginning.
    began: Option<(HostNs, u64)>,
}

impl<W: Write + Seek> McapFile<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new(to: W) -> Result<Self, ExportError> {
        let options =
            WriteOptions::new().compression(None).library(concat!("dbbd ", env!("CARGO_PKG_VERSION")));
        let mut writer = ::mcap::Writer::with_options(to, options)?;
        let mut channels = Vec::new();
        for name in CHANNELS {
            let schema = writer.add_schema(&format!("dbbd.{name}"), "jsonschema", &schema(name)?)?;
            channels.push(writer.add_channel(schema, name, "json", &BTreeMap::new())?);
        }
        Ok(Self { writer, channels, counts: [0; CHANNELS.len()], began: None })
    }

    /// Appends a record of the capture.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn add(&mut self, stamped: &Stamped) -> Result<(), ExportError> {
        let host = stamped.host;
        match &stamped.record {
            Record::Attachment { name, content } => {
                let at = self.wall_clock(host);
                let media_type = match name.rsplit('.').next() {
                    Some("csv") => "text/csv",
                    Some("json") => "application/json",
                    Some("toml") => "application/toml",
                    _ => "application/octet-stream",
                };
                let (name, media_type) = (name.clone(), media_type.to_owned());
                self.writer.attach(&Attachment {
                    log_time: at,
                    create_time: at,
                    name,
                    media_type,
                    data: content.into(),
                })?;
            }
            Record::Raw(bytes) => {
                let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
                self.message(RAW, host, json!({ "bytes_hex": hex }))?;
            }
            Record::Samples(samples) => {
                for sample in samples {
                    self.message(SAMPLES, host, serde_json::to_value(sample)?)?;
                }
            }
            Record::Fault(json) => self.message(FAULTS, host, serde_json::from_slice(json)?)?,
            Record::Event(event) => {
                if let Event::Started { unix_ns, .. } = event {
                    self.began = Some((host, *unix_ns));
                }
                let value = serde_json::to_value(event)?;
                if matches!(event, Event::Gap { .. }) {
                    self.message(GAPS, host, value.clone())?;
                }
                self.message(EVENTS, host, value)?;
            }
        }
        Ok(())
    }

    /// Ends the file; how many messages each of [`CHANNELS`] has.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self) -> Result<[u32; CHANNELS.len()], ExportError> {
        self.writer.finish()?;
        self.writer.into_inner().flush().map_err(McapError::from)?;
        Ok(self.counts)
    }

    fn wall_clock(&self, host: HostNs) -> u64 {
        let (began, unix_ns) = self.began.unwrap_or_default();
        unix_ns.saturating_add(host.0.saturating_sub(began.0))
    }

    fn message(&mut self, channel: usize, host: HostNs, content: Value) -> Result<(), ExportError> {
        let mut message = Map::from_iter([("host_ns".to_owned(), json!(host.0))]);
        if let Value::Object(content) = content {
            message.extend(content);
        }
        let at = self.wall_clock(host);
        let header = MessageHeader {
            channel_id: self.channels[channel],
            sequence: self.counts[channel],
            log_time: at,
            publish_time: at,
        };
        self.counts[channel] = self.counts[channel].wrapping_add(1);
        let message = serde_json::to_vec(&Value::Object(message))?;
        Ok(self.writer.write_to_known_channel(&header, &message)?)
    }
}

/// The JSON Schema of a channel's messages.
fn schema(channel: &str) -> Result<Vec<u8>, serde_json::Error> {
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
        _ => &[("event", "string")],
    };
    let host = [("host_ns", "integer")];
    let properties: Map<String, Value> = host
        .iter()
        .chain(fields)
        .map(|(name, kind)| ((*name).to_owned(), json!({ "type": [kind, "null"] })))
        .collect();
    serde_json::to_vec(&json!({ "type": "object", "properties": properties }))
}
