//! The work on a robot in nine steps: what the pages ask, and the routes.

use axum::body::Bytes;
use axum::extract::{Extension, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_ENCODING, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use dbbd_job::page::Download;
use dbbd_model::diagnostic::{Diagnostic, FindingRecord};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::asking::{Answer, App, Parts, ask, job_number, parts, reply};
use super::json::{Body, LongBody, json};
use super::server::Peer;
use super::service::EvaluationJob;
use super::{Route, downloads};

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

/// How far a step is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepState {
    /// An earlier step comes first.
    Todo,
    Ready,
    Running,
    Done,
    /// The user must look.
    Attention,
}

/// What a step found, as colour, word and shape show it.
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

/// What a page shows of a step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepReport {
    pub step: WorkStep,
    pub state: StepState,
    pub verdict: StepVerdict,
    /// Key of the sentence in the texts of the page, and its values.
    pub text: &'static str,
    pub values: Value,
    pub findings: Vec<ExplainedFinding>,
    /// `None` where there is nothing to do.
    pub action: Option<StepAction>,
    /// Key of the label of the action.
    pub label: &'static str,
    /// The same on the command line, in the directory of the work.
    pub command: String,
    /// The plan that is measured next.
    pub plan: Option<String>,
    /// What the step made: directory and names.
    pub directory: String,
    pub files: Vec<String>,
    /// The last job of the step.
    pub job: Option<EvaluationJob>,
}

/// A robot with its steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotWork {
    pub name: String,
    /// Name of the robot of the job or of the result.
    pub robot: Option<String>,
    /// Where its files are, as the service was started.
    pub directory: String,
    /// The cell is simulated: its true robot is beside the job.
    pub simulated: bool,
    pub steps: Vec<StepReport>,
}

/// A robot in the list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotSummary {
    pub name: String,
    pub robot: Option<String>,
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

/// How a step is computed, beside its files.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StepOptions {
    /// Of a check: largest position error, mm.
    pub tolerance_mm: Option<f64>,
    /// Of a correction: the program; `None` for the first that is not corrected yet.
    pub program: Option<String>,
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
    /// A simulated cell with its job; returns its name.
    fn demo(&self) -> Result<String, Diagnostic>;
    /// The job as JSON; null if there is none.
    fn job_of(&self, robot: &str) -> Result<Value, Diagnostic>;
    /// Sets keys of the job; all others, and comments, stay.
    fn edit_job(&self, robot: &str, keys: &Value) -> Result<(), Diagnostic>;
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

/// The view in three dimensions, as the renewing script made it, compressed.
const SCENE_SCRIPT: &[u8] = include_bytes!("page/vendor/three.js.gz");

pub(super) fn table() -> Vec<Route<App>> {
    vec![
        ("/api/v1/workbench", "GET, POST", get(robots).merge(post(create))),
        ("/api/v1/workbench/{robot}", "GET", get(work)),
        ("/api/v1/workbench/{robot}/job", "GET, PUT", get(job_of).merge(put(edit_job))),
        ("/api/v1/workbench/{robot}/scene", "GET", get(scene)),
        ("/api/v1/workbench/{robot}/program", "PUT", put(upload)),
        ("/api/v1/workbench/{robot}/steps/{step}", "POST", post(compute)),
        ("/api/v1/workbench/{robot}/files/{directory}/{file}", "GET", get(work_file)),
        ("/api/v1/demo", "POST", post(demo)),
        ("/api/v1/jobs/{id}/answer", "GET", get(job_answer)),
    ]
}

/// `/vendor/three.js`: every browser takes gzip.
pub(super) async fn scene_script() -> Response {
    let headers = [(CONTENT_TYPE, "text/javascript; charset=utf-8"), (CONTENT_ENCODING, "gzip")];
    (headers, Bytes::from_static(SCENE_SCRIPT)).into_response()
}

async fn robots(State(app): State<App>) -> Answer {
    reply(app, |service| Ok(json!({ "robots": service.robots()? }))).await
}

async fn create(State(app): State<App>, Body(new): Body<NewRobot>) -> Answer {
    let name = new.name.clone();
    ask(app, move |service| service.create(new)).await?;
    Ok(json(StatusCode::CREATED, &json!({ "name": name })))
}

async fn demo(State(app): State<App>) -> Answer {
    let name = ask(app, |service| service.demo()).await?;
    Ok(json(StatusCode::CREATED, &json!({ "name": name })))
}

async fn work(State(app): State<App>, robot: Parts<String>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| service.work(&robot)).await
}

async fn job_of(State(app): State<App>, robot: Parts<String>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| Ok(json!({ "job": service.job_of(&robot)? }))).await
}

async fn edit_job(State(app): State<App>, robot: Parts<String>, Body(keys): Body<Value>) -> Answer {
    let robot = parts(robot)?;
    ask(app, move |service| service.edit_job(&robot, &keys)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn scene(State(app): State<App>, robot: Parts<String>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| service.scene(&robot)).await
}

async fn upload(
    State(app): State<App>,
    robot: Parts<String>,
    LongBody(files): LongBody<ProgramUpload>,
) -> Answer {
    let robot = parts(robot)?;
    ask(app, move |service| service.upload(&robot, files)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn compute(
    State(app): State<App>,
    path: Parts<(String, WorkStep)>,
    Body(options): Body<StepOptions>,
) -> Answer {
    let (robot, step) = parts(path)?;
    let job = ask(app, move |service| service.compute(&robot, step, options)).await?;
    Ok(json(StatusCode::ACCEPTED, &job))
}

async fn work_file(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    path: Parts<(String, String, String)>,
) -> Answer {
    let (robot, directory, file) = parts(path)?;
    let download = ask(app, move |service| service.work_file(&robot, &directory, &file)).await?;
    Ok(downloads::answer(download, peer.busy()))
}

async fn job_answer(State(app): State<App>, id: Parts<String>) -> Answer {
    let id = job_number(id)?;
    reply(app, move |service| service.job_answer(id)).await
}
