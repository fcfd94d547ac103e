//! Every route of the live page and its API, in one table.

use std::sync::Arc;

use axum::routing::{delete, get, post, put};
use tokio::sync::watch;

use super::access::Access;
use super::api::App;
use super::guard::{Forms, Gate, Journal, Route, Site, session};
use super::service::Service;
use super::{api, page};

/// Paths of the API, their methods and handlers.
fn table() -> Vec<Route<App>> {
    vec![
        ("/api/v1/openapi.json", "GET", get(api::openapi)),
        session(),
        ("/api/v1/status", "GET", get(api::status)),
        ("/api/v1/stream", "GET", get(api::stream)),
        ("/api/v1/points", "GET", get(api::points)),
        ("/api/v1/device", "PUT", put(api::choose)),
        ("/api/v1/ports", "GET", get(api::ports)),
        ("/api/v1/protocols", "GET", get(api::protocols)),
        ("/api/v1/robots", "GET", get(api::robots)),
        ("/api/v1/plans", "GET", get(api::plans)),
        ("/api/v1/reading", "DELETE, POST", post(api::connect).merge(delete(api::disconnect))),
        ("/api/v1/reading/zero", "POST", post(api::zero)),
        ("/api/v1/act", "POST", post(api::act)),
        ("/api/v1/run", "POST", post(api::start)),
        ("/api/v1/run/stop", "POST", post(api::stop)),
        ("/api/v1/run/mark", "POST", post(api::mark)),
        ("/api/v1/runs", "GET", get(api::runs)),
        ("/api/v1/runs/{name}", "GET", get(api::run)),
        ("/api/v1/runs/{name}/capture", "GET", get(api::capture)),
        ("/api/v1/runs/{name}/{kind}/{file}", "GET", get(api::result)),
        ("/api/v1/jobs", "GET, POST", get(api::jobs).merge(post(api::submit))),
        ("/api/v1/jobs/{id}", "GET", get(api::job)),
        ("/api/v1/jobs/{id}/cancel", "POST", post(api::cancel)),
        ("/metrics", "GET", get(api::metrics)),
    ]
}

/// Paths of the API and their methods, as `GET` or `GET, POST`.
pub fn routes() -> Vec<(&'static str, &'static str)> {
    table().into_iter().map(|(path, methods, _)| (path, methods)).collect()
}

/// The page of a cell with its API.
pub fn cell_site(service: Arc<dyn Service>, access: Arc<Access>, stop: watch::Receiver<bool>) -> Site {
    let journal: Arc<dyn Journal> = service.clone();
    let gate = Gate { access, journal, files: page::FILES, forms: Forms::Nowhere, sign_in: None };
    Site::new(gate, table(), App { service, stop })
}
