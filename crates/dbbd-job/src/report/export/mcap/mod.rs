//! A capture as MCAP, the log format that Foxglove, Python's `mcap` and the tools of ROS read.
//!
//! Channels `raw`, `samples`, `faults`, `events`, `gaps`, `axes`; each message is a JSON object with `host_ns`, the capture's
//! own time. Log times are on the wall clock at the beginning of the run. The attachments of the capture are copied.
//! Chunks are not compressed and have checksums.
//!
//! Channels `tf` and `scene` show the run in 3-D as Foxglove's Protobuf messages: the links of the robot (the attachment robot.urdf),
//! balls and bar, at the dwells and where axes were published.

mod container;
mod scene;

use std::io::{self, Write};

use serde_json::{Map, Value, json};

use container::{Attachment, Container, MessageEncoding};
pub use scene::RunScene;
use scene::{FRAME_TRANSFORMS, SCENE_UPDATE, SceneMessages};

use crate::recording::axes::AxesRecords;
use crate::recording::capture::{CaptureRecord, RunEvent, StampedRecord};
use crate::report::ReportFinding;
use dbbd_model::base::FileFinding;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::AXES;

/// Names of the channels, in the order of their counts.
pub const CHANNELS: [&str; 8] = ["raw", "samples", "faults", "events", "gaps", "axes", "tf", "scene"];

/// An index of [`CHANNELS`].
#[derive(Clone, Copy)]
enum Channel {
    Raw,
    Samples,
    Faults,
    Events,
    Gaps,
    Axes,
    Transforms,
    Scene,
}

/// An MCAP file that is being written.
pub struct McapFile<W> {
    file: Container<W>,
    channels: [u16; CHANNELS.len()],
    counts: [u32; CHANNELS.len()],
    /// Host time and wall clock (ns since the Unix epoch) at the beginning of the run.
    began: Option<(HostNs, u64)>,
    axes: AxesRecords,
    scene: Option<RunScene>,
}

impl<W: Write> McapFile<W> {
    /// Starts a file, with the scene of the run if its poses are known.
    pub fn new(to: W, scene: Option<RunScene>) -> Result<Self, Diagnostic> {
        let library = concat!("dbbd ", env!("CARGO_PKG_VERSION"));
        let mut file = Container::new(to, library).map_err(unwritable)?;
        let channels = CHANNELS.map(|name| match name {
            "tf" => file.add_channel(name, MessageEncoding::Protobuf, FRAME_TRANSFORMS, &scene::schema()),
            "scene" => file.add_channel(name, MessageEncoding::Protobuf, SCENE_UPDATE, &scene::schema()),
            _ => file.add_channel(name, MessageEncoding::Json, &format!("dbbd.{name}"), &schema(name)),
        });
        let axes = AxesRecords::default();
        Ok(Self { file, channels, counts: [0; CHANNELS.len()], began: None, axes, scene })
    }

    /// Appends a record of the capture. An error if a record that must be JSON is not JSON.
    pub fn add(&mut self, stamped: &StampedRecord) -> Result<(), Diagnostic> {
        let host = stamped.host;
        self.show_dwells(host)?;
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
                self.message(Channel::Axes, host, value)?;
                self.show_axes(host, &sample.measured_deg)
            }),
            CaptureRecord::Fault(json) => {
                let value = serde_json::from_slice(json).map_err(|error| not_json("fault", &error))?;
                self.message(Channel::Faults, host, value)
            }
            CaptureRecord::Event(event) => {
                if let RunEvent::Started { unix_ns, .. } = event {
                    self.began = Some((host, *unix_ns));
                    if let Some(urdf) = self.scene.as_ref().map(RunScene::urdf) {
                        self.attach(host, "robot.urdf", urdf.as_bytes())?;
                    }
                }
                let value = serde_json::to_value(event).map_err(|error| not_json("event", &error))?;
                if matches!(event, RunEvent::Gap { .. } | RunEvent::Withheld { gaps: 1.., .. }) {
                    self.message(Channel::Gaps, host, value.clone())?;
                }
                self.message(Channel::Events, host, value)
            }
        }
    }

    /// Ends the file; returns the number of messages in each of [`CHANNELS`].
    pub fn finish(mut self) -> Result<[u32; CHANNELS.len()], Diagnostic> {
        self.show_dwells(HostNs(u64::MAX))?;
        self.file.finish().map_err(unwritable)?;
        Ok(self.counts)
    }

    fn attach(&mut self, host: HostNs, name: &str, content: &[u8]) -> Result<(), Diagnostic> {
        let at_ns = self.wall_clock(host);
        let media_type = match name.rsplit('.').next() {
            Some("csv") => "text/csv",
            Some("json") => "application/json",
            Some("toml") => "application/toml",
            Some("urdf") => "application/xml",
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
        self.put(channel, host, Value::Object(message).to_string().as_bytes())
    }

    fn put(&mut self, channel: Channel, host: HostNs, content: &[u8]) -> Result<(), Diagnostic> {
        let at_ns = self.wall_clock(host);
        let (id, count) = (self.channels[channel as usize], &mut self.counts[channel as usize]);
        let sequence = *count;
        *count = count.wrapping_add(1);
        self.file.message(id, sequence, at_ns, content).map_err(unwritable)
    }

    /// Shows the dwells up to a time.
    fn show_dwells(&mut self, until: HostNs) -> Result<(), Diagnostic> {
        let due = self.scene.as_mut().map(|scene| scene.dwells_until(until)).unwrap_or_default();
        due.into_iter().try_for_each(|(host, axes_deg)| self.show(host, &axes_deg))
    }

    /// Shows axes that were published.
    fn show_axes(&mut self, host: HostNs, axes_deg: &[f64; AXES]) -> Result<(), Diagnostic> {
        if self.scene.as_mut().is_some_and(|scene| scene.draws_axes(host)) {
            self.show(host, axes_deg)?;
        }
        Ok(())
    }

    fn show(&mut self, host: HostNs, axes_deg: &[f64; AXES]) -> Result<(), Diagnostic> {
        let at_ns = self.wall_clock(host);
        let Some(SceneMessages { transforms, update }) =
            self.scene.as_ref().map(|scene| scene.messages(axes_deg, at_ns))
        else {
            return Ok(());
        };
        self.put(Channel::Transforms, host, &transforms)?;
        self.put(Channel::Scene, host, &update)
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
