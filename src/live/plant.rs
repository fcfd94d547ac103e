//! The page of a plant: robots, bars and runs of an archive, behind the same guard as the page of a cell.

use std::sync::Arc;

use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::Uri;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::access::Access;
use super::api::wait;
use super::connections::Peer;
use super::downloads;
use super::guard::{Forms, Gate, Journal, PageFile, Route, Site, page_content, session};
use super::json::Problem;
use super::metrics::{self, family};
use super::service::Download;
use crate::catalogue::ArchiveFinding::NotAQuestion;
use crate::diagnostic::Diagnostic;

/// What the pages ask of an archive. The methods may wait for database and store: they are called on threads of their own.
pub trait Plant: Send + Sync + 'static {
    /// A page, in HTML.
    fn page(&self, question: &Question) -> Result<String, Diagnostic>;
    /// The page that says why there is none.
    fn refusal(&self, why: &Diagnostic) -> Result<String, Diagnostic>;
    /// The page that asks for the token.
    fn sign_in(&self) -> Result<String, Diagnostic>;
    /// What all pages share.
    fn files(&self) -> &'static [PageFile];
    /// The stored report of a run's newest result.
    fn report(&self, run: &str) -> Result<Download, Diagnostic>;
    fn numbers(&self) -> Result<PlantNumbers, Diagnostic>;
}

/// A page of the plant.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    Robots(Filter),
    Robot(Name),
    Bars(Filter),
    Bar(Name),
    Runs(RunFilter),
    /// The first digits of the SHA-256 of its capture.
    Run(String),
}

/// Which robots or bars, and which page of them.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Filter {
    /// A text that its name or its type contain.
    pub q: String,
    pub decision: Decided,
    pub order: Order,
    /// From 1; 0 is the first too.
    pub page: u32,
}

/// What the last check of a robot decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Decided {
    #[default]
    #[serde(rename = "")]
    Any,
    Pass,
    Fail,
    Undecided,
    /// It was never checked.
    None,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    #[default]
    #[serde(alias = "")]
    Name,
    /// Those first whose last check is the longest ago.
    Check,
}

/// A robot or a bar.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Name {
    pub name: String,
}

/// Which runs, the newest first.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunFilter {
    /// A text that robot, type, bar, cell or operator contain.
    pub q: String,
    pub robot: String,
    pub bar: String,
    pub cell: String,
    /// Dates: from the first on, up to before the second.
    pub since: String,
    pub until: String,
    /// The last run of the page before: date, space, SHA-256.
    pub after: String,
}

/// What `/metrics` states of an archive: names with their counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlantNumbers {
    pub runs: u64,
    pub results: u64,
    pub jobs: Vec<(&'static str, u64)>,
    pub robots: Vec<(&'static str, u64)>,
    /// Age of the job that waits the longest, s; 0 where none waits.
    pub oldest_waiting_s: f64,
}

type Asked = Arc<dyn Plant>;

/// The page of a plant.
///
/// # Errors
/// Only a fault of the template itself.
pub fn plant_site(
    plant: Arc<dyn Plant>,
    access: Arc<Access>,
    journal: Arc<dyn Journal>,
) -> Result<Site, Diagnostic> {
    let sign_in = Some(plant.sign_in()?);
    let gate = Gate { access, journal, files: plant.files(), forms: Forms::Here, sign_in };
    Ok(Site::new(gate, table(), plant))
}

fn table() -> Vec<Route<Asked>> {
    vec![
        session(),
        (
            "/",
            "GET",
            get(async |State(plant): State<Asked>, uri: Uri| ask(plant, &uri, Question::Robots).await),
        ),
        (
            "/robot",
            "GET",
            get(async |State(plant): State<Asked>, uri: Uri| ask(plant, &uri, Question::Robot).await),
        ),
        (
            "/bars",
            "GET",
            get(async |State(plant): State<Asked>, uri: Uri| ask(plant, &uri, Question::Bars).await),
        ),
        (
            "/bar",
            "GET",
            get(async |State(plant): State<Asked>, uri: Uri| ask(plant, &uri, Question::Bar).await),
        ),
        (
            "/runs",
            "GET",
            get(async |State(plant): State<Asked>, uri: Uri| ask(plant, &uri, Question::Runs).await),
        ),
        ("/runs/{run}", "GET", get(run)),
        ("/runs/{run}/report.html", "GET", get(report)),
        ("/metrics", "GET", get(numbers)),
    ]
}

/// A page that is asked for by the query of its address.
async fn ask<T: DeserializeOwned>(plant: Asked, uri: &Uri, question: fn(T) -> Question) -> Response {
    let asked = serde_urlencoded::from_str(uri.query().unwrap_or_default());
    answer(plant, asked.map(question).map_err(|error| NotAQuestion { why: error.to_string() }.into())).await
}

async fn run(State(plant): State<Asked>, path: Result<Path<String>, PathRejection>) -> Response {
    answer(plant, digits(path).map(Question::Run)).await
}

fn digits(path: Result<Path<String>, PathRejection>) -> Result<String, Diagnostic> {
    path.map(|Path(digits)| digits).map_err(|error| NotAQuestion { why: error.body_text() }.into())
}

async fn answer(plant: Asked, question: Result<Question, Diagnostic>) -> Response {
    let asked = Arc::clone(&plant);
    let page = match question {
        Ok(question) => wait(move || asked.page(&question)).await,
        Err(wrong) => Err(wrong),
    };
    page.map_or_else(|why| refused(&plant, why), |page| page_content(page).into_response())
}

/// A refusal for people.
fn refused(plant: &Asked, why: Diagnostic) -> Response {
    let page = plant.refusal(&why);
    let problem = Problem::from(why);
    match page {
        Ok(page) => (problem.status(), page_content(page)).into_response(),
        Err(_) => problem.into_response(),
    }
}

async fn report(
    State(plant): State<Asked>,
    Extension(peer): Extension<Peer>,
    path: Result<Path<String>, PathRejection>,
) -> Response {
    let asked = Arc::clone(&plant);
    let found = match digits(path) {
        Ok(digits) => wait(move || asked.report(&digits)).await,
        Err(wrong) => Err(wrong),
    };
    found.map_or_else(|why| refused(&plant, why), |report| downloads::answer(report, peer.busy()))
}

async fn numbers(State(plant): State<Asked>) -> Result<Response, Problem> {
    let found = wait(move || plant.numbers()).await?;
    Ok(metrics::answer(text(&found)))
}

fn text(found: &PlantNumbers) -> String {
    let mut out = String::new();
    let mut gauge =
        |name: &str, help: &str, values: &[(&str, f64)]| family(&mut out, name, "gauge", help, values);
    gauge("archive_runs", "Runs in the archive.", &[("", found.runs as f64)]);
    gauge("archive_results", "Results in the archive.", &[("", found.results as f64)]);
    for (name, label, help, counts) in [
        ("archive_jobs", "state", "Jobs by state.", &found.jobs),
        ("archive_robots", "decision", "Robots by the decision of their last check.", &found.robots),
    ] {
        let named: Vec<(String, f64)> =
            counts.iter().map(|(value, count)| (format!("{{{label}=\"{value}\"}}"), *count as f64)).collect();
        let values: Vec<(&str, f64)> =
            named.iter().map(|(labels, count)| (labels.as_str(), *count)).collect();
        gauge(name, help, &values);
    }
    let age = found.oldest_waiting_s;
    gauge("archive_oldest_waiting_seconds", "Age of the job that waits the longest.", &[("", age)]);
    out
}
