//! What the pages ask of the service behind them.

use std::fs::File;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::{broadcast, watch};

use super::guard::Journal;
use super::view::{Message, Point, Status};
use crate::diagnostic::Diagnostic;

/// The service behind the pages. The methods may wait for disk and device: they are called on threads of
/// their own.
pub trait Service: Journal {
    /// The state, as it changes.
    fn status(&self) -> watch::Receiver<Status>;
    /// The live stream; who reads too slowly loses messages.
    fn messages(&self) -> broadcast::Receiver<Message>;
    /// The dwells of the run that is on, or of the last one.
    fn points(&self) -> Vec<Point>;
    /// What there is to choose from.
    fn catalogue(&self, which: Catalogue) -> Result<Value, Diagnostic>;
    /// Chooses the device for the next run.
    fn choose(&self, port: Option<String>, protocol: Option<String>) -> Result<(), Diagnostic>;
    /// Reads the bar without a run, against the stroke of a plan.
    fn connect(&self, plan: Option<String>) -> Result<(), Diagnostic>;
    /// Ends that.
    fn disconnect(&self) -> Result<(), Diagnostic>;
    /// Sets the reading of the bar that is read to zero.
    fn zero(&self) -> Result<(), Diagnostic>;
    /// Notes what the operator did on the page.
    fn act(&self, act: Act);
    /// Starts a run.
    fn start(&self, request: StartRequest) -> Result<(), Diagnostic>;
    /// Stops the run.
    fn stop(&self) -> Result<(), Diagnostic>;
    /// Writes a remark into the run.
    fn mark(&self, text: String) -> Result<(), Diagnostic>;
    /// The runs in the data directory, the newest first.
    fn runs(&self) -> Result<Vec<RunEntry>, Diagnostic>;
    /// One of them.
    fn run(&self, name: &str) -> Result<RunEntry, Diagnostic>;
    /// A file of a run: its capture, or a result.
    fn file(&self, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Diagnostic>;
    /// Takes a job.
    fn submit(&self, request: JobRequest) -> Result<Job, Diagnostic>;
    /// The jobs of this process, the newest first.
    fn jobs(&self) -> Vec<Job>;
    /// One of them.
    fn job(&self, id: u64) -> Result<Job, Diagnostic>;
    /// Ends a job before its time.
    fn cancel(&self, id: u64) -> Result<Job, Diagnostic>;
}

/// What there is to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Catalogue {
    Ports,
    /// Protocols that are built in.
    Protocols,
    /// Robots that are built in.
    Robots,
    /// Plans in the plan directory.
    Plans,
}

/// A run to start.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartRequest {
    pub name: String,
    /// The plan that the robot executes.
    #[serde(default)]
    pub plan: Option<String>,
    /// Ends it after so many seconds.
    #[serde(default)]
    pub duration_s: Option<f64>,
    /// What the operator checked at the cell.
    #[serde(default)]
    pub checked: Vec<CheckItem>,
}

/// An item of the cell check list.
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

/// What the operator does on the page without asking for anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Act {
    AlarmCleared,
    SoundOn,
    SoundOff,
}

impl Act {
    pub fn name(self) -> &'static str {
        match self {
            Act::AlarmCleared => "alarm_cleared",
            Act::SoundOn => "sound_on",
            Act::SoundOff => "sound_off",
        }
    }
}

/// State of a run in the data directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunState {
    Running,
    /// It ended as it should.
    Ended,
    /// It ended early: its capture has no record of its end. What was written can be identified.
    EndedEarly,
}

/// A run in the data directory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunEntry {
    pub name: String,
    pub state: RunState,
    /// When it began, ms since the Unix epoch, where the capture has it.
    pub started_unix_ms: Option<u64>,
    /// Size of the capture, bytes.
    pub bytes: u64,
    /// How it ended, where it did.
    pub ended: Option<Ended>,
    /// What was made from it.
    pub results: Vec<ResultFile>,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Ended {
    pub reason: String,
    /// Samples that were written.
    pub samples: u64,
    /// Samples that were lost on the way to the disk.
    pub lost: u64,
}

/// A file that was made from a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ResultFile {
    pub kind: JobKind,
    pub file: String,
    pub bytes: u64,
}

/// What can be made from a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// Lengths matched to poses.
    Sync,
    /// The robot's parameters.
    Identify,
    /// The circular test.
    Circle,
}

impl JobKind {
    pub const ALL: [JobKind; 3] = [JobKind::Sync, JobKind::Identify, JobKind::Circle];

    /// The verb that does it, which is also the directory of its results.
    pub fn name(self) -> &'static str {
        match self {
            JobKind::Sync => "sync",
            JobKind::Identify => "identify",
            JobKind::Circle => "circle",
        }
    }
}

/// A job to take.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobRequest {
    /// What to do.
    pub kind: JobKind,
    pub run: String,
    /// `identify`: what is known beforehand, `none` or `datasheet`.
    #[serde(default)]
    pub prior: Option<String>,
    /// `identify`: the parameters to estimate.
    #[serde(default)]
    pub estimate: Option<String>,
    /// `identify`: the parameters to hold.
    #[serde(default)]
    pub hold: Option<String>,
}

/// State of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waits for another one.
    Waiting,
    Running,
    Done,
    /// Done, with a loss or a doubt that the user must see.
    Doubt,
    Failed,
    /// Ended before its time.
    Cancelled,
}

/// A job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Job {
    pub id: u64,
    pub kind: JobKind,
    pub run: String,
    pub state: JobState,
    /// For how long it has been running, s.
    pub elapsed_s: f64,
    /// How much of it is done, per cent, by its steps.
    pub percent: u8,
    /// What it said, line by line; the last ones.
    pub log: Vec<String>,
}

/// A file to be sent.
#[derive(Debug)]
pub struct Download {
    pub file: File,
    pub name: String,
    /// Its size when it was opened.
    pub bytes: u64,
}
