//! The pages and the HTTP API of a cell: routes and handlers.

use std::sync::{Arc, Mutex};

use axum::extract::{Extension, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, delete, get, post, put};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::watch;

use super::access::Access;
use super::asking::{Answer, App, Parts, ask, job_number, parts, reply};
use super::guard::{Asking, session};
use super::json::{Body, json};
use super::server::Peer;
use super::service::{Act, Catalogue, ConnectRequest, JobKind, JobRequest, Service, StartRequest};
use super::{Gate, Journal, Route, Site};
use super::{downloads, metrics, stream, workbench};
use crate::live::ServiceFinding::{NoResultKind, RemarkLength};
use dbbd_job::page::PageFile;
use dbbd_job::report::page::CODES;
use dbbd_model::base::text::is_control;
use dbbd_model::diagnostic::Diagnostic;

/// The description of the API. A test compares it with the routes.
pub const OPENAPI: &str = include_str!("openapi.json");
/// Longest remark, characters.
const LONGEST_REMARK: usize = 250;

const FILES: &[PageFile] = &[
    file("/", HTML, include_str!("page/home.html")),
    file("/robot/{name}", HTML, include_str!("page/robot.html")),
    file("/live", HTML, include_str!("page/robot.html")),
    file("/style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    file("/vendor/uplot.css", "text/css; charset=utf-8", include_str!("page/vendor/uplot.css")),
    script("/home.js", include_str!("page/home.js")),
    script("/robot.js", include_str!("page/robot.js")),
    script("/sentence.js", include_str!("page/sentence.js")),
    script("/frame.js", include_str!("page/frame.js")),
    script("/job_form.js", include_str!("page/job_form.js")),
    script("/job_changes.js", include_str!("page/job_changes.js")),
    script("/number_field.js", include_str!("page/number_field.js")),
    script("/number_text.js", include_str!("page/number_text.js")),
    script("/correct.js", include_str!("page/correct.js")),
    script("/zip.js", include_str!("page/zip.js")),
    script("/scene.js", include_str!("page/scene.js")),
    script("/measure.js", include_str!("page/measure.js")),
    script("/gauge.js", include_str!("page/gauge.js")),
    script("/plots.js", include_str!("page/plots.js")),
    script("/residuals.js", include_str!("page/residuals.js")),
    script("/polar.js", include_str!("page/polar.js")),
    script("/numbers.js", include_str!("page/numbers.js")),
    script("/moving.js", include_str!("page/moving.js")),
    script("/users.js", include_str!("page/users.js")),
    script("/trace.js", include_str!("page/trace.js")),
    script("/circle.js", include_str!("page/circle.js")),
    script("/link.js", include_str!("page/link.js")),
    script("/mounting.js", include_str!("page/mounting.js")),
    script("/texts.js", include_str!("page/texts.js")),
    file("/texts.json", "application/json", LANGUAGES),
    file("/codes.json", "application/json", CODES),
    script("/findings.js", include_str!("page/findings.js")),
    script("/runs.js", include_str!("page/runs.js")),
];

const HTML: &str = "text/html; charset=utf-8";

/// The texts of the page by language. A new language is a file and a line here.
const LANGUAGES: &str = concat!(
    "{\"en\":",
    include_str!("page/texts/en.json"),
    ",\"de\":",
    include_str!("page/texts/de.json"),
    "}"
);

const fn file(path: &'static str, kind: &'static str, content: &'static str) -> PageFile {
    PageFile { path, kind, content }
}

const fn script(path: &'static str, content: &'static str) -> PageFile {
    file(path, "text/javascript; charset=utf-8", content)
}

fn table() -> Vec<Route<App>> {
    let cell = vec![
        ("/api/v1/openapi.json", "GET", get(openapi)),
        ("/api/v1/status", "GET", get(status)),
        ("/api/v1/stream", "GET", get(live_stream)),
        ("/api/v1/points", "GET", get(points)),
        ("/api/v1/device", "PUT", put(choose)),
        ("/api/v1/ports", "GET", list(Catalogue::Ports)),
        ("/api/v1/protocols", "GET", list(Catalogue::Protocols)),
        ("/api/v1/robots", "GET", list(Catalogue::Robots)),
        ("/api/v1/plans", "GET", list(Catalogue::Plans)),
        ("/api/v1/reading", "DELETE, POST", post(connect).merge(delete(disconnect))),
        ("/api/v1/reading/zero", "POST", post(zero)),
        ("/api/v1/act", "POST", post(act)),
        ("/api/v1/run", "POST", post(start)),
        ("/api/v1/run/stop", "POST", post(stop)),
        ("/api/v1/run/mark", "POST", post(mark)),
        ("/api/v1/runs", "GET", get(runs)),
        ("/api/v1/runs/{name}", "GET", get(run)),
        ("/api/v1/runs/{name}/capture", "GET", get(capture)),
        ("/api/v1/runs/{name}/{kind}/{file}", "GET", get(result)),
        ("/api/v1/jobs", "GET, POST", get(jobs).merge(post(submit))),
        ("/api/v1/jobs/{id}", "GET", get(job)),
        ("/api/v1/jobs/{id}/cancel", "POST", post(cancel)),
        ("/metrics", "GET", get(prometheus)),
    ];
    cell.into_iter().chain(session()).chain(workbench::table()).collect()
}

/// Paths of the API and their methods, as `GET` or `GET, POST`.
pub fn routes() -> Vec<(&'static str, &'static str)> {
    table().into_iter().map(|(path, methods, _)| (path, methods)).collect()
}

/// The pages and the API of a cell.
pub fn cell_site(service: Arc<dyn Service>, access: Arc<Access>, stop: watch::Receiver<bool>) -> Site {
    let journal: Arc<dyn Journal> = service.clone();
    let gate = Gate {
        access,
        journal,
        files: FILES,
        form_action: "'none'",
        sign_in: None,
        events: Mutex::default(),
    };
    let routes = table().into_iter().chain(workbench::vendor_scripts()).collect();
    Site::new(gate, routes, App { service, stop })
}

/// 202 without a body, if the service accepts.
async fn accept(
    app: App,
    command: impl FnOnce(&dyn Service) -> Result<(), Diagnostic> + Send + 'static,
) -> Answer {
    ask(app, command).await?;
    Ok(StatusCode::ACCEPTED.into_response())
}

async fn openapi() -> Response {
    ([(CONTENT_TYPE, "application/json")], OPENAPI).into_response()
}

async fn status(State(app): State<App>) -> Response {
    json(StatusCode::OK, &*app.service.status().borrow())
}

async fn live_stream(State(app): State<App>, Extension(peer): Extension<Peer>) -> Response {
    stream::answer(&*app.service, app.stop, peer.busy())
}

async fn points(State(app): State<App>) -> Answer {
    reply(app, |service| Ok(json!({ "points": service.points() }))).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Choice {
    port: Option<String>,
    protocol: Option<String>,
}

async fn choose(State(app): State<App>, Body(choice): Body<Choice>) -> Answer {
    reply(app, move |service| {
        service.choose(choice.port, choice.protocol)?;
        Ok(service.status().borrow().device.clone())
    })
    .await
}

fn list(which: Catalogue) -> MethodRouter<App> {
    get(move |State(app): State<App>| reply(app, move |service| service.catalogue(which)))
}

async fn connect(State(app): State<App>, Body(request): Body<ConnectRequest>) -> Answer {
    accept(app, move |service| service.connect(request)).await
}

async fn disconnect(State(app): State<App>) -> Answer {
    accept(app, |service| service.disconnect()).await
}

async fn zero(State(app): State<App>) -> Answer {
    accept(app, |service| service.zero()).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ActRequest {
    act: Act,
}

async fn act(State(app): State<App>, Body(ActRequest { act }): Body<ActRequest>) -> Answer {
    accept(app, move |service| {
        service.act(act);
        Ok(())
    })
    .await
}

async fn start(
    State(app): State<App>,
    Extension(Asking(user)): Extension<Asking>,
    Body(mut request): Body<StartRequest>,
) -> Answer {
    request.by.clone_from(&user.name);
    let name = request.name.clone();
    ask(app, move |service| service.start(request)).await?;
    Ok(json(StatusCode::CREATED, &json!({ "name": name })))
}

/// Does not use the pool of blocking threads: *stop* must work while all of them wait.
async fn stop(State(app): State<App>) -> Answer {
    app.service.stop()?;
    Ok(StatusCode::ACCEPTED.into_response())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Remark {
    text: String,
}

async fn mark(State(app): State<App>, Body(Remark { text }): Body<Remark>) -> Answer {
    let trimmed = text.trim();
    let length = trimmed.chars().count();
    if length == 0 || length > LONGEST_REMARK || trimmed.contains(is_control) {
        return Err(Diagnostic::new(RemarkLength { most: LONGEST_REMARK }).into());
    }
    accept(app, move |service| service.mark(text)).await
}

async fn runs(State(app): State<App>) -> Answer {
    reply(app, |service| Ok(json!({ "runs": service.runs()? }))).await
}

async fn run(State(app): State<App>, name: Parts<String>) -> Answer {
    let name = parts(name)?;
    reply(app, move |service| service.run(&name)).await
}

async fn capture(State(app): State<App>, Extension(peer): Extension<Peer>, name: Parts<String>) -> Answer {
    let name = parts(name)?;
    let download = ask(app, move |service| service.file(&name, None)).await?;
    Ok(downloads::answer(download, peer.busy()))
}

async fn result(
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

async fn jobs(State(app): State<App>) -> Answer {
    reply(app, |service| Ok(json!({ "jobs": service.jobs() }))).await
}

async fn submit(State(app): State<App>, Body(request): Body<JobRequest>) -> Answer {
    let job = ask(app, move |service| service.submit(request)).await?;
    Ok(json(StatusCode::ACCEPTED, &job))
}

async fn job(State(app): State<App>, id: Parts<String>) -> Answer {
    let id = job_number(id)?;
    reply(app, move |service| service.job(id)).await
}

async fn cancel(State(app): State<App>, id: Parts<String>) -> Answer {
    let id = job_number(id)?;
    reply(app, move |service| service.cancel(id)).await
}

async fn prometheus(State(app): State<App>) -> Response {
    metrics::answer(metrics::text(&app.service.status().borrow()))
}
