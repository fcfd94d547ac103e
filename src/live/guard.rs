//! The middleware of every request: Host and Origin, token or session cookie, security headers.

use dbbd_job::page::PageFile;
use std::net::IpAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::{Extension, Request, State};
use axum::http::header::{
    ACCEPT, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue, REFERRER_POLICY, SET_COOKIE,
    X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, post};
use serde::Deserialize;

use super::access::{COOKIE_NAME, Credentials};
use super::json::{Body, Problem};
use super::server::Peer;
use super::{Gate, Route, Site};
use crate::live::ServiceFinding::{NotAllowed, NothingHere, PathTooLong};

/// Content security policy of the pages: they reach their own service only. The source of `form-action` follows.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self' data:; base-uri 'none'; frame-ancestors 'none'; form-action ";
/// Longest path with query, bytes.
const LONGEST_URI: usize = 2048;
/// Scripts of others, which hold no secret either.
const VENDOR: &str = "/vendor/";
const SESSION: &str = "/api/v1/session";

impl Site {
    pub(super) fn new<A: Clone + Send + Sync + 'static>(gate: Gate, routes: Vec<Route<A>>, app: A) -> Self {
        let refused = |methods: &'static str| {
            move || async move {
                Problem::new(StatusCode::METHOD_NOT_ALLOWED, NotAllowed { methods }).allow(methods)
            }
        };
        let mut router = Router::new();
        for (path, methods, handlers) in routes {
            router = router.route(path, handlers.fallback(refused(methods)));
        }
        for PageFile { path, kind, content } in gate.files {
            let handler = get(|| async { ([(CONTENT_TYPE, *kind)], *content) });
            router = router.route(path, handler.fallback(refused("GET")));
        }
        let journal = Arc::clone(&gate.journal);
        let gate = Arc::new(gate);
        let router = router
            .fallback(|| async { Problem::new(StatusCode::NOT_FOUND, NothingHere) })
            .layer(Extension(Arc::clone(&gate)))
            .layer(from_fn_with_state(gate, guard))
            .with_state(app);
        Self { router, journal }
    }
}

async fn guard(
    State(gate): State<Arc<Gate>>,
    Extension(peer): Extension<Peer>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = match gate.admit(&peer, &request) {
        Ok(()) => {
            let _busy = peer.busy();
            next.run(request).await
        }
        Err(problem) => gate.refuse(&request, problem),
    };
    let headers = response.headers_mut();
    if !headers.contains_key(CONTENT_SECURITY_POLICY)
        && let Ok(policy) = HeaderValue::from_str(&format!("{PAGE_POLICY}{}", gate.form_action))
    {
        headers.insert(CONTENT_SECURITY_POLICY, policy);
    }
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    for name in ["cross-origin-resource-policy", "cross-origin-opener-policy"] {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static("same-origin"));
    }
    response
}

impl Gate {
    fn admit(&self, peer: &Peer, request: &Request) -> Result<(), Problem> {
        let path = request.uri().path();
        if request.uri().to_string().len() > LONGEST_URI {
            return Err(Problem::new(StatusCode::URI_TOO_LONG, PathTooLong));
        }
        let is_file = self.files.iter().any(|file| is_path_of(file.path, path)) || path.starts_with(VENDOR);
        // Other sites may link to a page. The API is for the service's own pages.
        let own_pages_only = !(is_file || self.sign_in.is_some() && is_page(request));
        self.access.check_site(request.uri(), request.headers(), own_pages_only)?;
        let client = self.access.client(request.headers(), peer.address);
        let credentials = self.access.credentials(request.headers(), client);
        peer.authenticated(credentials.check().is_ok());
        // The files hold no secret, and the page asks for the token.
        if is_file || (path == SESSION && request.method() == Method::POST) {
            return Ok(());
        }
        if matches!(credentials, Credentials::Wrong | Credentials::TooManyWrong) {
            self.log_wrong_token(client);
        }
        credentials.check()
    }

    fn refuse(&self, request: &Request, problem: Problem) -> Response {
        match &self.sign_in {
            Some(page) if problem.status() == StatusCode::UNAUTHORIZED && is_page(request) => {
                (StatusCode::UNAUTHORIZED, page_content(page.clone())).into_response()
            }
            _ => problem.into_response(),
        }
    }

    fn log_wrong_token(&self, client: IpAddr) {
        self.journal.warn("wrong_token", &[("address", &client)]);
    }
}

/// Whether a path is that of a page, whose last part may be any name.
fn is_path_of(page: &str, path: &str) -> bool {
    match page.strip_suffix("{name}") {
        Some(start) => path.strip_prefix(start).is_some_and(|name| !name.is_empty() && !name.contains('/')),
        None => page == path,
    }
}

/// Whether a browser asks for a page.
fn is_page(request: &Request) -> bool {
    let accepted = request.headers().get(ACCEPT).and_then(|accepted| accepted.to_str().ok());
    request.method() == Method::GET && accepted.is_some_and(|accepted| accepted.contains("text/html"))
}

pub(super) fn page_content(page: String) -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/html; charset=utf-8")], page)
}

/// The route to log in with the token and to log out.
pub(super) fn session<A: Clone + Send + Sync + 'static>() -> Route<A> {
    (SESSION, "DELETE, POST", post(log_in).merge(delete(log_out)))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LogIn {
    token: String,
}

async fn log_in(
    Extension(gate): Extension<Arc<Gate>>,
    Extension(peer): Extension<Peer>,
    headers: HeaderMap,
    Body(LogIn { token }): Body<LogIn>,
) -> Result<Response, Problem> {
    let client = gate.access.client(&headers, peer.address);
    let logged_in = gate.access.log_in(&token, client);
    let session = logged_in.inspect_err(|_| gate.log_wrong_token(client))?;
    peer.authenticated(true);
    let cookie = format!("{COOKIE_NAME}={session}; Path=/; HttpOnly; SameSite=Strict");
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, cookie)]).into_response())
}

async fn log_out(Extension(gate): Extension<Arc<Gate>>, headers: HeaderMap) -> Response {
    gate.access.log_out(&headers);
    let cookie = format!("{COOKIE_NAME}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0");
    (StatusCode::NO_CONTENT, [(SET_COOKIE, cookie)]).into_response()
}
