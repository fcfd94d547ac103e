//! The pages of a plant: robots, bars and runs of an archive.

use std::sync::{Arc, Mutex};

use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::Uri;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get};
use serde::de::DeserializeOwned;

use super::access::Access;
use super::asking::on_blocking_thread;
use super::downloads;
use super::guard::{page_content, session};
use super::json::Problem;
use super::metrics::{self, family};
use super::server::Peer;
use super::{Gate, Journal, Route, Site};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_plant::ArchiveFinding::NotAQuestion;
use dbbd_plant::{PlantNumbers, PlantPages, Question};

/// The methods of the pages may block: they are called on blocking threads.
type App = Arc<PlantPages>;

pub fn plant_site(
    plant: Arc<PlantPages>,
    access: Arc<Access>,
    journal: Arc<dyn Journal>,
) -> Result<Site, Diagnostic> {
    let sign_in = Some(plant.sign_in()?);
    let gate = Gate {
        access,
        journal,
        files: plant.files(),
        form_action: "'self'",
        sign_in,
        events: Mutex::default(),
    };
    Ok(Site::new(gate, table(), plant))
}

fn table() -> Vec<Route<App>> {
    let pages = vec![
        ("/", "GET", page(Question::Robots)),
        ("/robot", "GET", page(Question::Robot)),
        ("/bars", "GET", page(Question::Bars)),
        ("/bar", "GET", page(Question::Bar)),
        ("/runs", "GET", page(Question::Runs)),
        ("/runs/{run}", "GET", get(run)),
        ("/runs/{run}/report.html", "GET", get(report)),
        ("/metrics", "GET", get(numbers)),
    ];
    session().into_iter().chain(pages).collect()
}

/// A page whose question is in the query of its address.
fn page<T: DeserializeOwned + 'static>(question: fn(T) -> Question) -> MethodRouter<App> {
    get(move |State(plant): State<App>, uri: Uri| {
        let asked = serde_urlencoded::from_str(uri.query().unwrap_or_default());
        let asked = asked.map(question).map_err(|error| NotAQuestion { why: error.to_string() }.into());
        answer(plant, asked)
    })
}

async fn run(State(plant): State<App>, path: Result<Path<String>, PathRejection>) -> Response {
    answer(plant, digits(path).map(Question::Run)).await
}

fn digits(path: Result<Path<String>, PathRejection>) -> Result<String, Diagnostic> {
    path.map(|Path(digits)| digits).map_err(|error| NotAQuestion { why: error.body_text() }.into())
}

async fn answer(plant: App, question: Result<Question, Diagnostic>) -> Response {
    let asked = Arc::clone(&plant);
    let page = match question {
        Ok(question) => on_blocking_thread(move || asked.page(&question)).await,
        Err(wrong) => Err(wrong),
    };
    page.map_or_else(|why| refused(&plant, why), |page| page_content(page).into_response())
}

/// The error page, or the JSON form where that fails.
fn refused(plant: &App, why: Diagnostic) -> Response {
    let page = plant.refusal(&why);
    let problem = Problem::from(why);
    match page {
        Ok(page) => (problem.status(), page_content(page)).into_response(),
        Err(_) => problem.into_response(),
    }
}

async fn report(
    State(plant): State<App>,
    Extension(peer): Extension<Peer>,
    path: Result<Path<String>, PathRejection>,
) -> Response {
    let asked = Arc::clone(&plant);
    let found = match digits(path) {
        Ok(digits) => on_blocking_thread(move || asked.report(&digits)).await,
        Err(wrong) => Err(wrong),
    };
    found.map_or_else(|why| refused(&plant, why), |report| downloads::answer(report, peer.busy()))
}

async fn numbers(State(plant): State<App>) -> Result<Response, Problem> {
    let found = on_blocking_thread(move || plant.numbers()).await?;
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
