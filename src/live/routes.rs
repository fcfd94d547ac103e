//! Every route in one table, and the guard before all of them.

use std::sync::Arc;

use axum::Router;
use axum::extract::{Extension, Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use axum::http::{HeaderName, Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, delete, get, post, put};
use tokio::sync::watch;

use super::access::{Access, Shown, refusal};
use super::api::App;
use super::connections::Peer;
use super::json::Problem;
use super::service::Service;
use super::{api, page};
use crate::catalogue::ServiceFinding::{NotAllowed, NothingHere, PathTooLong};

/// What the page may do: talk to this service, and nothing else.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// Longest path with query, bytes.
const LONGEST_URI: usize = 2048;

type Route = (&'static str, &'static str, MethodRouter<App>);

/// Paths of the API, their methods and handlers.
fn table() -> Vec<Route> {
    vec![
        ("/api/v1/openapi.json", "GET", get(api::openapi)),
        ("/api/v1/session", "DELETE, POST", post(api::log_in).merge(delete(api::log_out))),
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

/// All routes behind the guard.
pub(super) fn router(service: Arc<dyn Service>, access: Arc<Access>, stop: watch::Receiver<bool>) -> Router {
    let app = App { service, access, stop };
    let refused = |methods: &'static str| {
        move || async move { Problem::new(StatusCode::METHOD_NOT_ALLOWED, NotAllowed { methods }).allow(methods) }
    };
    let mut router = Router::new();
    for (path, methods, handlers) in table() {
        router = router.route(path, handlers.fallback(refused(methods)));
    }
    for (path, kind, content) in page::FILES {
        let handler = get(move || async move { page::answer(kind, content) });
        router = router.route(path, handler.fallback(refused("GET")));
    }
    router
        .fallback(|| async { Problem::new(StatusCode::NOT_FOUND, NothingHere) })
        .layer(from_fn_with_state(app.clone(), guard))
        .with_state(app)
}

/// What every request passes: site, token, and the headers of its answer.
async fn guard(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = match admit(&app, &peer, &request) {
        Ok(()) => {
            let _busy = peer.busy();
            next.run(request).await
        }
        Err(problem) => problem.into_response(),
    };
    let headers = response.headers_mut();
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(HeaderValue::from_static(PAGE_POLICY));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    for name in ["cross-origin-resource-policy", "cross-origin-opener-policy"] {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static("same-origin"));
    }
    response
}

fn admit(app: &App, peer: &Peer, request: &Request) -> Result<(), Problem> {
    let path = request.uri().path();
    if request.uri().to_string().len() > LONGEST_URI {
        return Err(Problem::new(StatusCode::URI_TOO_LONG, PathTooLong));
    }
    let asset = page::FILES.iter().any(|(name, ..)| *name == path);
    app.access.check_site(request.uri(), request.headers(), !asset)?;
    let shown = app.access.shown(request.headers(), peer.address);
    peer.known(shown == Shown::Right);
    // The page itself holds nothing secret, and asks for the token.
    if asset || (path == "/api/v1/session" && request.method() == Method::POST) {
        return Ok(());
    }
    if matches!(shown, Shown::Wrong | Shown::TooOften) {
        api::report_guess(&*app.service, peer);
    }
    refusal(shown).map_or(Ok(()), Err)
}
