//! The interface of the service to its pages.

use dbbd_job::page::Download;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::{broadcast, watch};

use super::Journal;
use super::view::{Message, Point, ReadingRange, Status};
use super::work::{EvaluationJob, Workbench};
use dbbd_model::diagnostic::Diagnostic;

/// The service behind the pages. The methods may block: they are called on blocking threads.
pub trait Service: Journal + Workbench {
    fn status(&self) -> watch::Receiver<Status>;
    /// The live stream. A receiver that reads too slowly loses messages.
    fn messages(&self) -> broadcast::Receiver<Message>;
    /// The dwells of the current run, or of the last one.
    fn points(&self) -> Vec<Point>;
    /// The readings of the current run, or of the last one, by the second.
    fn trace(&self) -> Vec<ReadingRange>;
    fn catalogue(&self, which: Catalogue) -> Result<Value, Diagnostic>;
    /// Selects the device for the next run.
    fn choose(&self, port: Option<String>, protocol: Option<String>) -> Result<(), Diagnostic>;
    /// Reads the bar without a run and shows it against the stroke of a plan.
    fn connect(&self, request: ConnectRequest) -> Result<(), Diagnostic>;
    fn disconnect(&self) -> Result<(), Diagnostic>;
    /// Sets the reading of the connected bar to zero.
    fn zero(&self) -> Result<(), Diagnostic>;
    /// Notes an action of the operator on the page.
    fn act(&self, act: Act);
    fn start(&self, request: StartRequest) -> Result<(), Diagnostic>;
    fn stop(&self) -> Result<(), Diagnostic>;
    /// Writes a remark into the capture.
    fn mark(&self, text: String) -> Result<(), Diagnostic>;
    /// The runs in the data directory, the newest first.
    fn runs(&self) -> Result<Vec<RunEntry>, Diagnostic>;
    fn run(&self, name: &str) -> Result<RunEntry, Diagnostic>;
    /// The capture of a run, or a file of its results.
    fn file(&self, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Diagnostic>;
    fn submit(&self, request: JobRequest) -> Result<EvaluationJob, Diagnostic>;
    /// The jobs of this process, the newest first.
    fn jobs(&self) -> Vec<EvaluationJob>;
    fn job(&self, id: u64) -> Result<EvaluationJob, Diagnostic>;
    fn cancel(&self, id: u64) -> Result<EvaluationJob, Diagnostic>;
}

/// A list from which the user chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Catalogue {
    Ports,
    /// The built-in definitions of protocols.
    Protocols,
    /// The built-in robots.
    Robots,
    /// The plans in the plan directory.
    Plans,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartRequest {
    pub name: String,
    /// The plan that the robot executes.
    pub plan: Option<String>,
    /// The run ends after this time, s.
    pub duration_s: Option<f64>,
    /// Reads a simulated cell in place of the bar, at this speed: device time per host time.
    pub speed: Option<f64>,
    /// The items that the operator checked at the cell.
    #[serde(default)]
    pub checked: Vec<CheckItem>,
    /// Who starts the run: the user of the token.
    #[serde(skip)]
    pub by: Option<String>,
}

/// A reading of the bar without a run.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConnectRequest {
    /// The plan whose stroke is shown.
    pub plan: Option<String>,
    /// Reads a simulated cell in place of the bar, at this speed: device time per host time.
    pub speed: Option<f64>,
}

/// An item of the check list for the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckItem {
    BallClean,
    BarMounted,
    Override,
    Tool,
    T1,
}

impl CheckItem {
    pub fn name(self) -> &'static str {
        match self {
            CheckItem::BallClean => "ball_clean",
            CheckItem::BarMounted => "bar_mounted",
            CheckItem::Override => "override",
            CheckItem::Tool => "tool",
            CheckItem::T1 => "t1",
        }
    }
}

/// An action of the operator on the page that asks nothing of the service. It is only noted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Act {
    AlarmCleared,
    /// The bar was mounted while the program halts.
    BarMounted,
    SoundOn,
    SoundOff,
}

impl Act {
    pub fn name(self) -> &'static str {
        match self {
            Act::AlarmCleared => "alarm_cleared",
            Act::BarMounted => "bar_mounted",
            Act::SoundOn => "sound_on",
            Act::SoundOff => "sound_off",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunState {
    Running,
    Ended,
    /// The capture has no record of the end. What was written can be identified.
    EndedEarly,
}

/// A run in the data directory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunEntry {
    pub name: String,
    pub state: RunState,
    /// Start, ms since the Unix epoch, if the capture has it.
    pub started_unix_ms: Option<u64>,
    /// Size of the capture, bytes.
    pub bytes: u64,
    pub ended: Option<Ended>,
    /// Whether its plan is a plan of a check: the run leads to `dbbd check`, not to `dbbd identify`.
    pub is_check: bool,
    pub results: Vec<ResultFile>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Ended {
    pub reason: String,
    pub samples: u64,
    /// Number of samples that are missing, by their sequence numbers.
    pub lost: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ResultFile {
    pub kind: JobKind,
    pub file: String,
    pub bytes: u64,
}

/// An evaluation of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    Sync,
    Identify,
    Circle,
}

impl JobKind {
    pub const ALL: [JobKind; 3] = [JobKind::Sync, JobKind::Identify, JobKind::Circle];

    /// The name of the command, and of the directory of its results.
    pub fn name(self) -> &'static str {
        match self {
            JobKind::Sync => "sync",
            JobKind::Identify => "identify",
            JobKind::Circle => "circle",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobRequest {
    pub kind: JobKind,
    pub run: String,
    /// Prior of `identify`: `none`, `datasheet` or `posterior`.
    pub prior: Option<String>,
    /// The parameters that `identify` estimates.
    pub estimate: Option<String>,
    /// The parameters that `identify` fixes.
    pub hold: Option<String>,
}
