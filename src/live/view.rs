//! The state of the device and the run as clients see it. `openapi.json` describes the fields.

use std::sync::Arc;

use serde::Serialize;

use dbbd_model::diagnostic::FindingCode;

/// A message of the live stream. The JSON is made once for all clients.
#[derive(Clone, Debug)]
pub struct Message {
    /// `status`, `frame`, `point`, `mounting`, `begin`, `job`, ...
    pub event: &'static str,
    pub data: Arc<str>,
}

impl Message {
    /// The content is `null` if JSON cannot hold it, which happens for no message of this program.
    pub fn new(event: &'static str, content: &impl Serialize) -> Self {
        let data = serde_json::to_string(content).unwrap_or_else(|_| "null".into());
        Self { event, data: data.into() }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// No port is selected, or it is absent.
    #[default]
    NoDevice,
    Idle,
    Running,
    /// The last run failed. The next start clears this state.
    Failed,
}

impl State {
    pub fn name(self) -> &'static str {
        match self {
            State::NoDevice => "no_device",
            State::Idle => "idle",
            State::Running => "running",
            State::Failed => "failed",
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    pub version: &'static str,
    pub state: State,
    pub reason: Option<String>,
    /// Code of the reason.
    pub code: Option<FindingCode>,
    pub device: Device,
    pub run: Option<RunStatus>,
    /// The bar is read without a run. The name is empty.
    pub reading: Option<RunStatus>,
    pub last: Option<LastRun>,
    pub archive: Option<Archiving>,
}

/// State of the archiving of runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Archiving {
    /// Runs confirmed since the service started.
    pub confirmed: u64,
    /// Runs in the spool, and refused runs.
    pub waiting: u64,
    /// Runs that could neither be pushed nor spooled.
    pub refused: u64,
    /// Reason of the last failed attempt.
    pub reason: Option<String>,
}

/// The device that the next run reads.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Device {
    pub port: Option<String>,
    pub present: bool,
    /// Protocol of the device; `None` for the protocol of the plan.
    pub protocol: Option<String>,
}

/// A run in progress.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RunStatus {
    pub name: String,
    /// Who started the run, if users have names.
    pub by: Option<String>,
    pub plan: Option<String>,
    pub robot: Option<String>,
    /// Remaining time of the plan at full override, s.
    pub left_s: Option<f64>,
    pub next: Option<NextPose>,
    pub mounting: MountingState,
    pub can_zero: bool,
    pub started_unix_ms: u64,
    #[serde(flatten)]
    pub counts: RunCounts,
    /// Drift of the device's clock against the host's since the first sample, ms.
    pub clock_ahead_ms: Option<f64>,
    /// Length of the bar at reading zero, mm, from the plan.
    pub bar_length_mm: Option<f64>,
    /// Lowest and highest reading, mm.
    pub stroke_mm: Option<[f64; 2]>,
    /// Share of the half stroke beyond which the alarm is raised.
    pub alarm_share: f64,
    /// Dwells and passes of the plan.
    pub poses: Option<u32>,
}

/// The counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RunCounts {
    /// Host time since the start, s.
    pub elapsed_s: f64,
    /// Device time since the first sample, s, if the device has a clock.
    pub device_s: Option<f64>,
    /// Whether the port is absent at this moment.
    pub gone: bool,
    /// Whether the bar is the virtual one of dbbd.
    pub simulated: bool,
    /// Whether consecutive frames were decoded without a fault.
    pub in_step: bool,
    /// Samples per second over the last second.
    pub rate_hz: f64,
    pub bytes: u64,
    pub samples: u64,
    /// The last reading.
    pub reading_mm: Option<f64>,
    /// Completed dwells, by the strobe or by telegrams.
    pub dwells: u32,
    /// Completed modules, by their end marks.
    pub modules: u32,
    pub gaps: u64,
    /// Number of samples that are missing, by their sequence numbers.
    pub missing: u64,
    pub faults: u64,
    /// Replies of the device without a reading.
    pub rejected: u64,
    pub unanswered: u64,
    /// Bytes lost between port and recorder.
    pub lost_bytes: u64,
}

/// The pose at which the robot dwells next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NextPose {
    /// Row of the plan.
    pub index: u32,
    /// 0: a chosen pose, which is on no circle.
    pub circle: u32,
    pub angle_deg: Option<f64>,
}

/// The state of the mounting of the bar, estimated from its readings.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MountingState {
    /// `off`, `handled`, `settling`, `stable`, `moving`.
    pub state: &'static str,
    /// Standard deviation of means over 50 ms at rest, micrometres.
    pub scatter_um: Option<f64>,
    /// Drift at rest, micrometres per second.
    pub drift_um_s: Option<f64>,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Findings about the mounting, the newest last.
    pub findings: Vec<MountingNote>,
}

/// A finding about the mounting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MountingNote {
    pub code: FindingCode,
    pub text: String,
    /// Size of what was found, micrometres; for a drift, micrometres per second.
    pub size_um: f64,
    pub unix_ms: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LastRun {
    pub name: String,
    /// Why the run ended, or why it failed.
    pub ending: String,
    pub failed: bool,
    pub samples: u64,
}

/// Warning level: how near the reading is to the end of the stroke.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Alarm {
    #[default]
    None,
    /// The reading is beyond the alarm share of the stroke.
    Near,
    /// The reading is beyond the stroke.
    Over,
}

/// The samples since the previous frame: extremes and last values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Frame {
    /// Number of the frame, from 1.
    pub frame: u64,
    /// Time of the last sample since the run's first one, s, by the device's clock if it has one.
    pub t_s: f64,
    /// Arrival of the last sample, ms since the Unix epoch.
    pub unix_ms: f64,
    /// Time between the first and the last sample of the frame, ms.
    pub span_ms: f64,
    pub samples: u32,
    pub min_mm: f64,
    pub max_mm: f64,
    pub last_mm: f64,
    /// The highest alarm of the samples.
    pub alarm: Alarm,
    /// Whether the bar was mounted during the whole frame. Otherwise its reading is meaningless.
    pub mounted: bool,
    /// Strobe of the last sample, if the protocol carries it.
    pub strobe: Option<bool>,
    /// Whether the device flags all readings as valid.
    pub valid: bool,
}

/// The extremes of the readings of a second with the bar mounted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReadingRange {
    /// Time of the last frame, as [`Frame::t_s`].
    pub t_s: f64,
    pub min_mm: f64,
    pub max_mm: f64,
}

/// A completed dwell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Number of the dwell, from 1.
    pub dwell: u32,
    /// Row of the plan by count. The pose matching after the run decides which row it really is.
    pub index: Option<u32>,
    /// 0: a chosen pose, which is on no circle.
    pub circle: Option<u32>,
    pub angle_deg: Option<f64>,
    pub clockwise: bool,
    /// Mean reading during the strobe, mm.
    pub reading_mm: f64,
    /// Measured minus planned length, mm.
    pub deviation_mm: Option<f64>,
}
