//! Passes the requests of a cell's pages to the service.

use std::sync::Arc;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;
use tokio::sync::watch;

use super::json::{Problem, json};
use super::service::Service;
use crate::live::ServiceFinding::{NoJob, PathNotText, WorkerLost};
use dbbd_model::diagnostic::Diagnostic;

#[derive(Clone)]
pub(super) struct App {
    pub(super) service: Arc<dyn Service>,
    pub(super) stop: watch::Receiver<bool>,
}

pub(super) type Answer = Result<Response, Problem>;
/// Parameters of a path. They fail to decode where the path is not UTF-8.
pub(super) type Parts<T> = Result<Path<T>, PathRejection>;

/// Calls the service on a thread that may block.
pub(super) async fn ask<T: Send + 'static>(
    app: App,
    question: impl FnOnce(&dyn Service) -> Result<T, Diagnostic> + Send + 'static,
) -> Result<T, Problem> {
    Ok(on_blocking_thread(move || question(&*app.service)).await?)
}

pub(super) async fn on_blocking_thread<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Diagnostic> + Send + 'static,
) -> Result<T, Diagnostic> {
    let done = tokio::task::spawn_blocking(work).await;
    done.unwrap_or_else(|error| Err(WorkerLost { worker: error.to_string() }.into()))
}

/// Answers with what the service returns, as JSON.
pub(super) async fn reply<T: Serialize + Send + 'static>(
    app: App,
    question: impl FnOnce(&dyn Service) -> Result<T, Diagnostic> + Send + 'static,
) -> Answer {
    Ok(json(StatusCode::OK, &ask(app, question).await?))
}

pub(super) fn parts<T>(parts: Parts<T>) -> Result<T, Problem> {
    parts
        .map(|Path(parts)| parts)
        .map_err(|error| Problem::new(StatusCode::BAD_REQUEST, PathNotText { why: error.body_text() }))
}

pub(super) fn job_number(id: Parts<String>) -> Result<u64, Problem> {
    let id = parts(id)?;
    id.parse().map_err(|_| Diagnostic::new(NoJob { job: id }).into())
}
