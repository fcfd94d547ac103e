//! The handlers: each takes what it needs off the request and asks the service.

use std::sync::Arc;

use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::watch;

use super::connections::Peer;
use super::json::{Body, Problem, json};
use super::service::{Act, Catalogue, JobKind, JobRequest, Service, StartRequest};
use super::{downloads, metrics as prometheus, stream as live_stream};
use crate::catalogue::ServiceFinding::{NoJob, NoResultKind, PathNotText, RemarkLength, WorkerLost};
use crate::diagnostic::Diagnostic;

/// The API's description, kept by hand; a test holds it to the routes.
pub const OPENAPI: &str = include_str!("openapi.json");

/// What handlers need.
#[derive(Clone)]
pub(super) struct App {
    pub(super) service: Arc<dyn Service>,
    pub(super) stop: watch::Receiver<bool>,
}

type Answer = Result<Response, Problem>;
/// Parts of a path; what is no text is refused.
type Parts<T> = Result<Path<T>, PathRejection>;

/// Longest remark, characters.
const LONGEST_REMARK: usize = 250;

/// Asks the service on a thread where it may wait.
async fn ask<T: Send + 'static>(
    app: App,
    question: impl FnOnce(&dyn Service) -> Result<T, Diagnostic> + Send + 'static,
) -> Result<T, Problem> {
    Ok(wait(move || question(&*app.service)).await?)
}

/// Does what may wait on a thread for it.
pub(super) async fn wait<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Diagnostic> + Send + 'static,
) -> Result<T, Diagnostic> {
    let done = tokio::task::spawn_blocking(work).await;
    done.unwrap_or_else(|error| Err(WorkerLost { worker: error.to_string() }.into()))
}

fn parts<T>(parts: Parts<T>) -> Result<T, Problem> {
    parts
        .map(|Path(parts)| parts)
        .map_err(|error| Problem::new(StatusCode::BAD_REQUEST, PathNotText { why: error.body_text() }))
}

pub(super) async fn openapi() -> Response {
    ([(CONTENT_TYPE, "application/json")], OPENAPI).into_response()
}

pub(super) async fn status(State(app): State<App>) -> Response {
    json(StatusCode::OK, &*app.service.status().borrow())
}

pub(super) async fn stream(State(app): State<App>, Extension(peer): Extension<Peer>) -> Response {
    live_stream::answer(&*app.service, app.stop, peer.busy())
}

pub(super) async fn points(State(app): State<App>) -> Answer {
    let points = ask(app, |service| Ok(service.points())).await?;
    Ok(json(StatusCode::OK, &json!({ "points": points })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Choice {
    #[serde(default)]
    port: Option<String>,
    #[serde(default)]
    protocol: Option<String>,
}

pub(super) async fn choose(State(app): State<App>, Body(choice): Body<Choice>) -> Answer {
    let now = app.service.status();
    ask(app, move |service| service.choose(choice.port, choice.protocol)).await?;
    Ok(json(StatusCode::OK, &now.borrow().device))
}

async fn catalogue(app: App, which: Catalogue) -> Answer {
    let found = ask(app, move |service| service.catalogue(which)).await?;
    Ok(json(StatusCode::OK, &found))
}

pub(super) async fn ports(State(app): State<App>) -> Answer {
    catalogue(app, Catalogue::Ports).await
}

pub(super) async fn protocols(State(app): State<App>) -> Answer {
    catalogue(app, Catalogue::Protocols).await
}

pub(super) async fn robots(State(app): State<App>) -> Answer {
    catalogue(app, Catalogue::Robots).await
}

pub(super) async fn plans(State(app): State<App>) -> Answer {
    catalogue(app, Catalogue::Plans).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Connect {
    #[serde(default)]
    plan: Option<String>,
}

pub(super) async fn connect(State(app): State<App>, Body(Connect { plan }): Body<Connect>) -> Answer {
    ask(app, move |service| service.connect(plan)).await?;
    Ok(StatusCode::ACCEPTED.into_response())
}

pub(super) async fn disconnect(State(app): State<App>) -> Answer {
    ask(app, |service| service.disconnect()).await?;
    Ok(StatusCode::ACCEPTED.into_response())
}

pub(super) async fn zero(State(app): State<App>) -> Answer {
    ask(app, |service| service.zero()).await?;
    Ok(StatusCode::ACCEPTED.into_response())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Acted {
    act: Act,
}

pub(super) async fn act(State(app): State<App>, Body(Acted { act }): Body<Acted>) -> Answer {
    ask(app, move |service| {
        service.act(act);
        Ok(())
    })
    .await?;
    Ok(StatusCode::ACCEPTED.into_response())
}

pub(super) async fn start(State(app): State<App>, Body(request): Body<StartRequest>) -> Answer {
    let name = request.name.clone();
    ask(app, move |service| service.start(request)).await?;
    Ok(json(StatusCode::CREATED, &json!({ "name": name })))
}

/// Not on a thread where others wait: it must work whatever they do.
pub(super) async fn stop(State(app): State<App>) -> Answer {
    app.service.stop()?;
    Ok(StatusCode::ACCEPTED.into_response())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Remark {
    text: String,
}

pub(super) async fn mark(State(app): State<App>, Body(remark): Body<Remark>) -> Answer {
    let text = remark.text.trim();
    if text.is_empty() || text.contains(char::is_control) || text.chars().count() > LONGEST_REMARK {
        return Err(Diagnostic::new(RemarkLength { most: LONGEST_REMARK }).into());
    }
    ask(app, move |service| service.mark(remark.text)).await?;
    Ok(StatusCode::ACCEPTED.into_response())
}

pub(super) async fn runs(State(app): State<App>) -> Answer {
    let runs = ask(app, |service| service.runs()).await?;
    Ok(json(StatusCode::OK, &json!({ "runs": runs })))
}

pub(super) async fn run(State(app): State<App>, name: Parts<String>) -> Answer {
    let name = parts(name)?;
    let run = ask(app, move |service| service.run(&name)).await?;
    Ok(json(StatusCode::OK, &run))
}

pub(super) async fn capture(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    name: Parts<String>,
) -> Answer {
    let name = parts(name)?;
    let download = ask(app, move |service| service.file(&name, None)).await?;
    Ok(downloads::answer(download, peer.busy()))
}

pub(super) async fn result(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    path: Parts<(String, String, String)>,
) -> Answer {
    let (name, kind, file) = parts(path)?;
    let Some(kind) = JobKind::ALL.into_iter().find(|known| known.name() == kind) else {
        return Err(Diagnostic::new(NoResultKind { kind }).into());
    };
    let download = ask(app, move |service| service.file(&name, Some((kind, &file)))).await?;
    Ok(downloads::answer(download, peer.busy()))
}

pub(super) async fn jobs(State(app): State<App>) -> Answer {
    let jobs = ask(app, |service| Ok(service.jobs())).await?;
    Ok(json(StatusCode::OK, &json!({ "jobs": jobs })))
}

pub(super) async fn submit(State(app): State<App>, Body(request): Body<JobRequest>) -> Answer {
    let job = ask(app, move |service| service.submit(request)).await?;
    Ok(json(StatusCode::ACCEPTED, &job))
}

fn job_number(id: Parts<String>) -> Result<u64, Problem> {
    let id = parts(id)?;
    id.parse().map_err(|_| Diagnostic::new(NoJob { job: id }).into())
}

pub(super) async fn job(State(app): State<App>, id: Parts<String>) -> Answer {
    let id = job_number(id)?;
    Ok(json(StatusCode::OK, &ask(app, move |service| service.job(id)).await?))
}

pub(super) async fn cancel(State(app): State<App>, id: Parts<String>) -> Answer {
    let id = job_number(id)?;
    Ok(json(StatusCode::OK, &ask(app, move |service| service.cancel(id)).await?))
}

pub(super) async fn metrics(State(app): State<App>) -> Response {
    let text = prometheus::text(&app.service.status().borrow());
    prometheus::answer(text)
}
