//! The guard before every request, and what is behind it: site, token, and the headers of each answer.

use std::fmt::Display;
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
use axum::routing::{MethodRouter, delete, get, post};
use serde::Deserialize;

use super::access::{Access, COOKIE_NAME, Shown, refusal};
use super::connections::Peer;
use super::json::{Body, Problem};
use crate::catalogue::ServiceFinding::{NotAllowed, NothingHere, PathTooLong};

/// What a page may do: talk to its service, and nothing else.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self' data:; base-uri 'none'; frame-ancestors 'none'; form-action ";
/// Longest path with query, bytes.
const LONGEST_URI: usize = 2048;
const SESSION: &str = "/api/v1/session";

/// A path, its methods as `GET` or `GET, POST`, and its handlers.
pub(super) type Route<A> = (&'static str, &'static str, MethodRouter<A>);

/// A file of a page that holds nothing secret: whoever has no token gets it too.
#[derive(Clone, Copy, Debug)]
pub struct PageFile {
    pub path: &'static str,
    /// Its content type.
    pub kind: &'static str,
    pub content: &'static str,
}

/// Where a service writes what a stranger did.
pub trait Journal: Send + Sync + 'static {
    /// Writes a warning; one that comes again and again is counted.
    fn warn(&self, event: &'static str, fields: &[(&str, &dyn Display)]);
}

/// Who may ask, and what everybody gets.
pub(super) struct Gate {
    pub(super) access: Arc<Access>,
    pub(super) journal: Arc<dyn Journal>,
    pub(super) files: &'static [PageFile],
    pub(super) forms: Forms,
    /// The page that asks a browser for the token, where none of the files does.
    pub(super) sign_in: Option<String>,
}

/// Where the forms of the pages may lead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Forms {
    Nowhere,
    /// To the service itself, as a search does.
    #[cfg_attr(not(feature = "archive"), expect(dead_code))]
    Here,
}

/// Pages and API behind their guard.
#[derive(Clone)]
pub struct Site {
    pub(super) router: Router,
    pub(super) journal: Arc<dyn Journal>,
}

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

/// What every request passes: site, token, and the headers of its answer.
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
        && let Ok(policy) = HeaderValue::from_str(&gate.policy())
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
    fn policy(&self) -> String {
        let forms = match self.forms {
            Forms::Nowhere => "'none'",
            Forms::Here => "'self'",
        };
        format!("{PAGE_POLICY}{forms}")
    }

    fn admit(&self, peer: &Peer, request: &Request) -> Result<(), Problem> {
        let path = request.uri().path();
        if request.uri().to_string().len() > LONGEST_URI {
            return Err(Problem::new(StatusCode::URI_TOO_LONG, PathTooLong));
        }
        let is_file = self.files.iter().any(|file| file.path == path);
        // A link from elsewhere may lead to a page; the API is for the service's own pages.
        let own_alone = !(is_file || self.sign_in.is_some() && is_page(request));
        self.access.check_site(request.uri(), request.headers(), own_alone)?;
        let shown = self.access.shown(request.headers(), peer.address);
        peer.known(shown == Shown::Right);
        // The page itself holds nothing secret, and asks for the token.
        if is_file || (path == SESSION && request.method() == Method::POST) {
            return Ok(());
        }
        if matches!(shown, Shown::Wrong | Shown::TooOften) {
            self.report_guess(peer);
        }
        refusal(shown).map_or(Ok(()), Err)
    }

    fn refuse(&self, request: &Request, problem: Problem) -> Response {
        match &self.sign_in {
            Some(page) if problem.status() == StatusCode::UNAUTHORIZED && is_page(request) => {
                (StatusCode::UNAUTHORIZED, page_content(page.clone())).into_response()
            }
            _ => problem.into_response(),
        }
    }

    /// A wrong token is a matter for the log.
    fn report_guess(&self, peer: &Peer) {
        self.journal.warn("wrong_token", &[("address", &peer.address)]);
    }
}

/// Whether a browser asks for something to show.
fn is_page(request: &Request) -> bool {
    let accepted = request.headers().get(ACCEPT).and_then(|accepted| accepted.to_str().ok());
    request.method() == Method::GET && accepted.is_some_and(|accepted| accepted.contains("text/html"))
}

/// A page as an answer.
pub(super) fn page_content(page: String) -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/html; charset=utf-8")], page)
}

/// Where a page shows the token.
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
    Body(shown): Body<LogIn>,
) -> Result<Response, Problem> {
    let logged_in = gate.access.log_in(&shown.token, peer.address);
    let session = logged_in.inspect_err(|_| gate.report_guess(&peer))?;
    peer.known(true);
    let cookie = format!("{COOKIE_NAME}={session}; Path=/; HttpOnly; SameSite=Strict");
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, cookie)]).into_response())
}

async fn log_out(Extension(gate): Extension<Arc<Gate>>, headers: HeaderMap) -> Response {
    gate.access.log_out(&headers);
    let cookie = format!("{COOKIE_NAME}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0");
    (StatusCode::NO_CONTENT, [(SET_COOKIE, cookie)]).into_response()
}
