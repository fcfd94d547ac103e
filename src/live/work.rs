//! The work on a robot as its pages show it: the steps, their results, and the jobs that compute them.

use dbbd_job::page::Download;
use dbbd_model::diagnostic::{Diagnostic, FindingRecord};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A step of the work on a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorkStep {
    Robot,
    Cell,
    Plan,
    Programs,
    Measure,
    Result,
    Correct,
    Check,
    Certificate,
}

impl WorkStep {
    pub fn name(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Cell => "cell",
            Self::Plan => "plan",
            Self::Programs => "programs",
            Self::Measure => "measure",
            Self::Result => "result",
            Self::Correct => "correct",
            Self::Check => "check",
            Self::Certificate => "certificate",
        }
    }
}

/// The progress of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepState {
    /// An earlier step must be done first.
    Todo,
    Ready,
    Running,
    Done,
    /// The user must look.
    Attention,
}

/// The result of a step, which is shown by colour, word and shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepVerdict {
    Pass,
    Fail,
    Undecided,
    None,
}

/// The next action of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepAction {
    /// Opens the form of the job.
    Edit,
    /// Makes the files of the step.
    Compute,
    /// Goes to the recording of a run of `plan`.
    Measure,
    /// Asks for a program of the robot.
    Upload,
}

/// A finding with its cause and its cure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExplainedFinding {
    #[serde(flatten)]
    pub finding: FindingRecord,
    pub cause: &'static str,
    pub cure: &'static str,
}

/// A run from which a step can be computed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunChoice {
    pub name: String,
    /// Whether it reached the end of its program.
    pub complete: bool,
    pub samples: Option<u64>,
}

/// The state of a step as a page shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepReport {
    pub step: WorkStep,
    pub state: StepState,
    pub verdict: StepVerdict,
    /// Key of the sentence in the texts of the page, and its values.
    pub text: &'static str,
    pub values: Value,
    pub findings: Vec<ExplainedFinding>,
    /// The next action; `None` where there is nothing to do.
    pub action: Option<StepAction>,
    /// Key of the label of the action.
    pub label: &'static str,
    /// The same action on the command line, in the directory of the work.
    pub command: String,
    /// The plan that is measured next.
    pub plan: Option<String>,
    /// The runs from which the step can be computed, the preferred one first.
    pub runs: Vec<RunChoice>,
    /// Directory of the files that the step made, and their names.
    pub directory: String,
    pub files: Vec<String>,
    /// When its newest file was written, ms since the Unix epoch.
    pub changed_unix_ms: Option<u64>,
    /// The last job of the step.
    pub job: Option<EvaluationJob>,
}

/// A robot with its steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotWork {
    pub name: String,
    /// Name of the robot of the job or of the result.
    pub robot: Option<String>,
    /// Directory of its files, as the service was started.
    pub directory: String,
    /// Whether the cell is simulated: its true robot is beside the job.
    pub simulated: bool,
    /// Whether the readings of its result are simulated.
    pub simulated_readings: bool,
    pub steps: Vec<StepReport>,
}

/// A robot in the list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotSummary {
    pub name: String,
    pub robot: Option<String>,
    /// Whether the readings of its result are simulated.
    pub simulated_readings: bool,
    /// The step that made the last decision: certificate, check, result, ..
    pub step: WorkStep,
    pub state: StepState,
    pub verdict: StepVerdict,
    pub text: &'static str,
    pub values: Value,
    /// When its newest file was written, ms since the Unix epoch.
    pub changed_unix_ms: Option<u64>,
}

/// A new job.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewRobot {
    /// Name of its directory.
    pub name: String,
    /// The keys of its job.
    pub job: Value,
}

/// The job of a robot, and the hash of its file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JobInForce {
    pub job: Value,
    pub sha256: Option<String>,
}

/// A change of the keys of a job.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobEdit {
    /// The hash of the file that the client read; null where there is none.
    pub sha256: Option<String>,
    pub keys: Value,
}

/// The options of a step, beside its files.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StepOptions {
    /// Option of a check: largest position error, mm.
    pub tolerance_mm: Option<f64>,
    /// Option of a correction: the program; `None` for the first program that is not corrected yet.
    pub program: Option<String>,
    /// Option of an identification: all rows that are left out; `None` for the rows that the last result left out.
    pub exclude: Option<Vec<ExcludedRows>>,
    /// Option of an identification and of a check: the run; `None` for the newest complete one.
    pub run: Option<String>,
    /// The user of the token who asks.
    #[serde(skip)]
    pub by: Option<String>,
}

/// Rows that are left out of a fit.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExcludedRows {
    pub rows: Vec<u32>,
    pub reason: Option<String>,
}

/// Files of a program.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgramUpload {
    pub files: Vec<UploadedFile>,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UploadedFile {
    pub name: String,
    /// One character a byte (U+0000 to U+00FF): a program keeps the bytes of its own code page.
    pub bytes: String,
}

/// The work on robots behind the pages. The methods may block.
pub trait Workbench {
    /// The robots of the working directory.
    fn robots(&self) -> Result<Vec<RobotSummary>, Diagnostic>;
    fn work(&self, robot: &str) -> Result<RobotWork, Diagnostic>;
    fn create(&self, new: NewRobot) -> Result<(), Diagnostic>;
    /// Makes a simulated cell with its job; returns its name.
    fn demo(&self) -> Result<String, Diagnostic>;
    /// The job as JSON, null if there is none.
    fn job_of(&self, robot: &str) -> Result<JobInForce, Diagnostic>;
    /// Sets keys of the job; all others, and comments, stay. Refused if the file is not the one that the client read.
    fn edit_job(&self, robot: &str, edit: &JobEdit) -> Result<(), Diagnostic>;
    /// Plans the job with changed keys and keeps nothing: findings, checks, predictions, and the view in three dimensions.
    fn try_job(&self, robot: &str, keys: &Value) -> Result<Value, Diagnostic>;
    /// Robot, poses, obstacles and residuals for the view in three dimensions.
    fn scene(&self, robot: &str) -> Result<Value, Diagnostic>;
    /// Keeps the files of a program that shall be corrected.
    fn upload(&self, robot: &str, upload: ProgramUpload) -> Result<(), Diagnostic>;
    fn compute(&self, robot: &str, step: WorkStep, options: StepOptions)
    -> Result<EvaluationJob, Diagnostic>;
    fn work_file(&self, robot: &str, directory: &str, file: &str) -> Result<Download, Diagnostic>;
    /// The answer to the request of a job; null if there is none.
    fn job_answer(&self, id: u64) -> Result<Value, Diagnostic>;
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    Waiting,
    Running,
    Done,
    /// Done with warnings (exit code 3).
    Warned,
    Failed,
    Cancelled,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvaluationJob {
    pub id: u64,
    /// The command of the job: `identify`, `plan`, ..
    pub kind: &'static str,
    /// Name of the run; empty if no run is evaluated.
    pub run: String,
    /// Name of the robot, for a job of a step of the workbench.
    pub robot: Option<String>,
    pub step: Option<WorkStep>,
    pub state: JobState,
    pub elapsed_s: f64,
    /// When it ended, ms since the Unix epoch.
    pub ended_unix_ms: Option<u64>,
    /// Progress by the steps of the command, per cent.
    pub percent: u8,
    /// The last lines of its output.
    pub log: Vec<String>,
    /// The findings of the job, and why it was refused.
    pub findings: Vec<ExplainedFinding>,
}
