//! What the pages ask of the service behind them.

use std::fs::File;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;
use tokio::sync::{broadcast, watch};

use super::view::{Message, Point, Status};

/// The service behind the pages. The methods may wait for disk and device: they are called on threads of
/// their own.
pub trait Service: Send + Sync + 'static {
    /// The state, as it changes.
    fn status(&self) -> watch::Receiver<Status>;
    /// The live stream; who reads too slowly loses messages.
    fn messages(&self) -> broadcast::Receiver<Message>;
    /// The dwells of the run that is on, or of the last one.
    fn points(&self) -> Vec<Point>;
    /// What there is to choose from.
    ///
    /// # Errors
    /// When the system cannot tell.
    fn catalogue(&self, which: Catalogue) -> Result<Value, Refusal>;
    /// Chooses the device for the next run.
    ///
    /// # Errors
    /// When a run is on, or there is no such port or protocol.
    fn choose(&self, port: Option<String>, protocol: Option<String>) -> Result<(), Refusal>;
    /// Starts a run.
    ///
    /// # Errors
    /// When one is on, its name is taken, or the device cannot be opened.
    fn start(&self, request: StartRequest) -> Result<(), Refusal>;
    /// Tells the run to stop.
    ///
    /// # Errors
    /// When none is on.
    fn stop(&self) -> Result<(), Refusal>;
    /// Writes a remark into the run.
    ///
    /// # Errors
    /// When none is on.
    fn mark(&self, text: String) -> Result<(), Refusal>;
    /// The runs in the data directory, the newest first.
    ///
    /// # Errors
    /// When the directory cannot be read.
    fn runs(&self) -> Result<Vec<RunEntry>, Refusal>;
    /// One of them.
    ///
    /// # Errors
    /// When there is no such run.
    fn run(&self, name: &str) -> Result<RunEntry, Refusal>;
    /// A file of a run: its capture, or a result.
    ///
    /// # Errors
    /// When there is no such file.
    fn file(&self, run: &str, result: Option<(JobKind, &str)>) -> Result<Download, Refusal>;
    /// Takes a job.
    ///
    /// # Errors
    /// When there is no such run, its run is on, or too many jobs wait.
    fn submit(&self, request: JobRequest) -> Result<Job, Refusal>;
    /// The jobs of this process, the newest first.
    fn jobs(&self) -> Vec<Job>;
    /// One of them.
    ///
    /// # Errors
    /// When there is no such job.
    fn job(&self, id: u64) -> Result<Job, Refusal>;
    /// Ends a job before its time.
    ///
    /// # Errors
    /// When there is no such job.
    fn cancel(&self, id: u64) -> Result<Job, Refusal>;
}

/// Why something is not done.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// There is no such thing.
    #[error("{0}")]
    Missing(String),
    /// Not now.
    #[error("{0}")]
    Conflict(String),
    /// Not like this.
    #[error("{0}")]
    Invalid(String),
    /// Too many at once.
    #[error("{0}")]
    Busy(String),
    /// The system failed.
    #[error("{0}")]
    Failed(String),
}

/// What there is to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Catalogue {
    /// Serial ports.
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
    /// Its name.
    pub name: String,
    /// The plan that the robot executes.
    #[serde(default)]
    pub plan: Option<String>,
    /// Ends it after so many seconds.
    #[serde(default)]
    pub duration_s: Option<f64>,
}

/// State of a run in the data directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RunState {
    /// It is on.
    Running,
    /// It ended as it should.
    Ended,
    /// It ended early: its capture has no record of its end. What was written can be identified.
    EndedEarly,
}

/// A run in the data directory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunEntry {
    /// Its name.
    pub name: String,
    /// Its state.
    pub state: RunState,
    /// When it began, ms since the Unix epoch, where the capture tells.
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
    /// Why.
    pub reason: String,
    /// Samples that were written.
    pub samples: u64,
    /// Samples that were lost on the way to the disk.
    pub lost: u64,
}

/// A file that was made from a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ResultFile {
    /// By which job.
    pub kind: JobKind,
    /// Its name.
    pub file: String,
    /// Its size.
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
    /// All of them.
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
    /// With which run.
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
    /// At work.
    Running,
    /// Done.
    Done,
    /// Done, with a loss or a doubt that the user must see.
    Doubt,
    /// Failed.
    Failed,
    /// Ended before its time.
    Cancelled,
}

/// A job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Job {
    /// Its number.
    pub id: u64,
    /// What it does.
    pub kind: JobKind,
    /// With which run.
    pub run: String,
    /// Its state.
    pub state: JobState,
    /// For how long it has been at work, s.
    pub elapsed_s: f64,
    /// What it said, line by line; the last ones.
    pub log: Vec<String>,
}

/// A file to be sent.
#[derive(Debug)]
pub struct Download {
    /// It, open.
    pub file: File,
    /// Its name.
    pub name: String,
    /// Its size when it was opened.
    pub bytes: u64,
}
