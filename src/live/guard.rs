//! The middleware of every request: Host and Origin, token or session cookie, security headers.

use dbbd_job::page::PageFile;
use std::net::IpAddr;
use std::sync::Arc;

use axum::Router;
use axum::extract::{Extension, MatchedPath, Request, State};
use axum::http::header::{
    ACCEPT, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue, REFERRER_POLICY, SET_COOKIE,
    X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, post};
use serde::Deserialize;
use serde_json::json;

use super::access::{COOKIE_NAME, Credentials};
use super::json::{Body, Problem, json};
use super::server::Peer;
use super::users::{Role, User, UserEvent};
use super::{Gate, Route, Site};
use crate::live::ServiceFinding::{NotAllowed, NothingHere, PathTooLong, RoleTooLow};
use dbbd_device::clock;
use dbbd_device::sync::lock;

/// Content security policy of the pages: they reach their own service only. The source of `form-action` follows.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self' data:; base-uri 'none'; frame-ancestors 'none'; form-action ";
/// Longest path with its query, bytes.
const LONGEST_URI: usize = 2048;
/// Path of third-party scripts, which hold no secret either.
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
    mut request: Request,
    next: Next,
) -> Response {
    let mut response = match gate.admit(&peer, &request) {
        Ok(user) => {
            let _busy = peer.busy();
            let change = Change::of(&request);
            request.extensions_mut().insert(Asking(Arc::clone(&user)));
            let response = next.run(request).await;
            if let Some(change) = change.filter(|_| response.status().is_success()) {
                lock(&gate.events).add(change.by(&user));
            }
            response
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

/// The user who sent the request.
#[derive(Clone)]
pub(super) struct Asking(pub(super) Arc<User>);

/// A request that changes something.
struct Change {
    act: String,
    path: String,
}

impl Change {
    fn of(request: &Request) -> Option<Self> {
        let path = request.uri().path();
        // A trial changes nothing.
        let is_change = needed(request.method(), path) > Role::Look && !path.ends_with("/trial");
        let route = request.extensions().get::<MatchedPath>().map_or(path, MatchedPath::as_str);
        is_change.then(|| Self { act: format!("{} {route}", request.method()), path: path.to_owned() })
    }

    fn by(self, user: &User) -> UserEvent {
        UserEvent::new(clock::unix_ns() / 1_000_000, user, self.act, self.path)
    }
}

/// The role that a request needs. A request that changes something needs the highest role, unless its route is listed
/// here.
fn needed(method: &Method, path: &str) -> Role {
    const MEASURE: [&str; 4] = ["/api/v1/run", "/api/v1/reading", "/api/v1/act", "/api/v1/device"];
    let is_below =
        |start: &str| path.strip_prefix(start).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
    if *method == Method::GET || *method == Method::HEAD || path == SESSION {
        Role::Look
    } else if MEASURE.into_iter().any(is_below) {
        Role::Measure
    } else {
        Role::Plan
    }
}

impl Gate {
    fn admit(&self, peer: &Peer, request: &Request) -> Result<Arc<User>, Problem> {
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
        peer.authenticated(matches!(credentials, Credentials::Valid(_)));
        // The files hold no secret, and the page asks for the token.
        if is_file || (path == SESSION && request.method() == Method::POST) {
            return Ok(Arc::new(User { name: None, role: Role::Look }));
        }
        if matches!(credentials, Credentials::Wrong | Credentials::TooManyWrong) {
            self.log_wrong_token(client);
        }
        let user = credentials.user()?;
        let needed = needed(request.method(), path);
        if user.role < needed {
            let finding = RoleTooLow { role: user.role.name(), needed: needed.name() };
            return Err(Problem::new(StatusCode::FORBIDDEN, finding));
        }
        Ok(user)
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

/// Whether a path is the path of `page`, whose last part may be any name.
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

/// The routes to log in with the token, to ask who is signed in, to log out; and what users changed.
pub(super) fn session<A: Clone + Send + Sync + 'static>() -> [Route<A>; 2] {
    [
        (SESSION, "DELETE, GET, POST", get(signed_in).merge(post(log_in)).merge(delete(log_out))),
        ("/api/v1/events", "GET", get(events)),
    ]
}

async fn signed_in(Extension(Asking(user)): Extension<Asking>) -> Response {
    json(StatusCode::OK, &*user)
}

async fn events(Extension(gate): Extension<Arc<Gate>>) -> Response {
    json(StatusCode::OK, &json!({ "events": lock(&gate.events).list() }))
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
