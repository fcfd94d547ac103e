//! What a client sees of the device and the run.

use std::sync::Arc;

use serde::Serialize;

use crate::diagnostic::Code;

/// One message of the live stream: its name and its JSON, made once for all clients.
#[derive(Clone, Debug)]
pub struct Message {
    /// Name of the event: `status`, `frame`, `point`, `mounting`, `begin`, `job`.
    pub event: &'static str,
    /// Its content, one JSON document.
    pub data: Arc<str>,
}

impl Message {
    /// A message with a content that JSON can hold; what it cannot (there is no such) becomes `null`.
    pub fn new(event: &'static str, content: &impl Serialize) -> Self {
        let data = serde_json::to_string(content).unwrap_or_else(|_| "null".into());
        Self { event, data: data.into() }
    }
}

/// State of the service.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// No port was chosen, or it is not there.
    #[default]
    NoDevice,
    /// The port is there and nobody reads it.
    Idle,
    /// A run is on.
    Running,
    /// The last run failed; the next start clears this.
    Failed,
}

impl State {
    /// As it is written in JSON.
    pub fn name(self) -> &'static str {
        match self {
            State::NoDevice => "no_device",
            State::Idle => "idle",
            State::Running => "running",
            State::Failed => "failed",
        }
    }
}

/// The service at a moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    pub version: &'static str,
    pub state: State,
    /// Why, where the state needs a word.
    pub reason: Option<String>,
    /// The code of the finding that is the reason.
    pub code: Option<Code>,
    pub device: Device,
    /// The run that is on.
    pub run: Option<RunStatus>,
    /// The bar that is read without a run: a run without name.
    pub reading: Option<RunStatus>,
    /// How the last run of this process ended.
    pub last: Option<LastRun>,
    /// What waits for the archive, where there is one.
    pub archive: Option<Archiving>,
}

/// Runs on their way to the archive.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Archiving {
    /// Runs that the archive confirmed since the start of the service.
    pub confirmed: u64,
    /// Runs that it has not confirmed: in the spool, and refused ones.
    pub waiting: u64,
    /// Runs that could neither be pushed nor spooled.
    pub refused: u64,
    /// Why, of the last attempt.
    pub reason: Option<String>,
}

/// The device that a run would read.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Device {
    /// Its port, as it was named.
    pub port: Option<String>,
    /// Whether the port is there.
    pub present: bool,
    /// The name of its protocol; none: that of the plan.
    pub protocol: Option<String>,
}

/// A run that is on.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RunStatus {
    pub name: String,
    /// The plan that the robot executes.
    pub plan: Option<String>,
    /// The robot that the plan was made for.
    pub robot: Option<String>,
    /// Time that the rest of the plan takes at full override, s.
    pub left_s: Option<f64>,
    /// The pose of the next dwell.
    pub next: Option<NextPose>,
    pub mounting: Mounting,
    /// Whether the bar can be set to zero.
    pub can_zero: bool,
    /// When it began, ms since the Unix epoch.
    pub started_unix_ms: u64,
    /// Host time since, s.
    pub elapsed_s: f64,
    /// Device time since the first sample, s, where the device has a clock.
    pub device_s: Option<f64>,
    /// By how much the device's clock is ahead of the host's since the first sample, ms.
    pub clock_ahead_ms: Option<f64>,
    /// Whether the port is away at this moment.
    pub gone: bool,
    /// Whether the frames were ever understood one after the other.
    pub in_step: bool,
    /// Samples per second over the last second.
    pub rate_hz: f64,
    /// Bytes that came.
    pub bytes: u64,
    /// Samples that were written.
    pub samples: u64,
    /// The last reading, mm.
    pub reading_mm: Option<f64>,
    /// Length of the bar at reading zero, mm, by the plan.
    pub bar_length_mm: Option<f64>,
    /// Lowest and highest reading that the bar allows, mm.
    pub stroke_mm: Option<[f64; 2]>,
    /// Share of the stroke from its middle beyond which the alarm is raised.
    pub alarm_share: f64,
    /// Dwells that are over.
    pub dwells: u32,
    /// Dwells of the plan.
    pub poses: Option<u32>,
    /// Modules that are over.
    pub modules: u32,
    /// Gaps that were recorded.
    pub gaps: u64,
    /// Samples missing by their sequence numbers.
    pub missing: u64,
    /// Faults of the stream.
    pub faults: u64,
    /// Times that the device said that it has no reading.
    pub rejected: u64,
    /// Requests that were not answered in time.
    pub unanswered: u64,
    /// Bytes lost between port and recorder.
    pub lost_bytes: u64,
}

/// The pose at which the robot dwells next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NextPose {
    /// Its row in the plan.
    pub index: u32,
    pub circle: u32,
    /// Its angle on the circle, degrees.
    pub angle_deg: Option<f64>,
}

/// How the bar is mounted, by its readings.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Mounting {
    /// `off`, `handled`, `settling`, `stable`, `moving`.
    pub state: &'static str,
    /// Standard deviation of means over 50 ms at rest, micrometres.
    pub scatter_um: Option<f64>,
    /// Drift at rest, micrometres a second.
    pub drift_um_s: Option<f64>,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// What was found, the newest last.
    pub findings: Vec<MountingNote>,
}

/// A finding about the mounting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MountingNote {
    pub code: Code,
    pub text: String,
    /// Its size, micrometres; of a creep micrometres a second.
    pub size_um: f64,
    /// When, ms since the Unix epoch.
    pub unix_ms: u64,
}

/// How a run ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LastRun {
    pub name: String,
    /// What ended it, or why it failed.
    pub ending: String,
    /// Whether it failed.
    pub failed: bool,
    /// Samples that were written.
    pub samples: u64,
}

/// How near the reading is to the end of the stroke.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Alarm {
    /// Well inside.
    #[default]
    None,
    /// Beyond the set share of the stroke.
    Near,
    /// Beyond the stroke.
    Over,
}

/// What came between two frames: the extremes are kept.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Frame {
    /// Number of the frame in its run, from 1.
    pub frame: u64,
    /// Time of the last sample since the first one, s, by the device's clock where it has one.
    pub t_s: f64,
    /// When the last sample came, ms since the Unix epoch.
    pub unix_ms: f64,
    /// How much earlier the first sample of the frame came, ms.
    pub span_ms: f64,
    pub samples: u32,
    /// Least reading, mm.
    pub min_mm: f64,
    /// Greatest reading, mm.
    pub max_mm: f64,
    /// Last reading, mm.
    pub last_mm: f64,
    /// The worst of its samples.
    pub alarm: Alarm,
    /// Whether the bar is between its balls all the time; before and after, its reading means nothing.
    pub mounted: bool,
    /// Whether the strobe was high at its end, where the protocol carries it.
    pub strobe: Option<bool>,
    /// Whether the device vouches for all of its readings.
    pub valid: bool,
}

/// A dwell that is over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Number of the dwell in its run, from 1.
    pub dwell: u32,
    /// The row of the plan that it is by count; which it really is, the alignment decides afterwards.
    pub index: Option<u32>,
    pub circle: Option<u32>,
    /// Its angle on the circle, degrees.
    pub angle_deg: Option<f64>,
    /// Whether the pass goes against growing angles.
    pub clockwise: bool,
    /// Mean reading during the strobe, mm.
    pub reading_mm: f64,
    /// Distance of the balls less the planned one, mm.
    pub deviation_mm: Option<f64>,
}
