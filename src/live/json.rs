//! JSON bodies, with limits, and the JSON form of every refusal.

use std::time::Duration;

use axum::body::to_bytes;
use axum::extract::{FromRequest, Request};
use axum::http::header::{ALLOW, CONTENT_TYPE, HeaderValue};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::error::Category;

use crate::live::ServiceFinding::{
    self, BodyContent, BodyNotJson, BodySyntax, BodyTooLong, BodyTooSlow, Unwritten,
};
use dbbd_device::port::PortFinding;
use dbbd_device::protocol::ProtocolFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::diagnostic::{Diagnostic, FindingCode};
use dbbd_model::plausibility::PlausibilityFinding;
use dbbd_plant::ArchiveFinding;

/// Longest body, bytes.
const LONGEST_BODY: usize = 64 * 1024;
/// Longest body with files, bytes: the programs of a cell have a few hundred kB.
const LONGEST_UPLOAD: usize = 4 * 1024 * 1024;
/// Timeout for a body.
const BODY_TIME: Duration = Duration::from_secs(10);

/// A refusal: `{"error": .., "code": .., "help": ..}`.
#[derive(Debug)]
pub(super) struct Problem {
    status: StatusCode,
    finding: Box<Diagnostic>,
    allow: Option<&'static str>,
}

impl Problem {
    pub(super) fn new(status: StatusCode, finding: ServiceFinding) -> Self {
        Self { status, finding: Box::new(finding.into()), allow: None }
    }

    pub(super) fn status(&self) -> StatusCode {
        self.status
    }

    pub(super) fn allow(mut self, methods: &'static str) -> Self {
        self.allow = Some(methods);
        self
    }
}

/// The HTTP status of a finding. A finding that is not listed concerns the device, a run or a file: 409.
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "a finding that is not listed is a conflict with the state"
)]
fn http_status(finding: &Diagnostic) -> StatusCode {
    if let Some(finding) = finding.finding::<ServiceFinding>() {
        return finding.http_status();
    }
    if finding.finding::<PlausibilityFinding>().is_some() {
        return StatusCode::UNPROCESSABLE_ENTITY;
    }
    if let Some(finding) = finding.finding::<ArchiveFinding>() {
        return match finding {
            ArchiveFinding::NoRun { .. }
            | ArchiveFinding::ManyRuns { .. }
            | ArchiveFinding::NotDigits { .. }
            | ArchiveFinding::NoSuchRobot { .. }
            | ArchiveFinding::NoSuchBar { .. }
            | ArchiveFinding::NoReport { .. } => StatusCode::NOT_FOUND,
            ArchiveFinding::NotAQuestion { .. }
            | ArchiveFinding::NotACursor { .. }
            | ArchiveFinding::NotADate { .. } => StatusCode::BAD_REQUEST,
            ArchiveFinding::NotReached { .. } => StatusCode::SERVICE_UNAVAILABLE,
            _ => StatusCode::CONFLICT,
        };
    }
    match finding.finding() {
        Some(PortFinding::NoPortList { .. }) => StatusCode::INTERNAL_SERVER_ERROR,
        _ if finding.finding::<InternalFinding>().is_some() => StatusCode::INTERNAL_SERVER_ERROR,
        _ if finding.finding::<ProtocolFinding>().is_some() => StatusCode::UNPROCESSABLE_ENTITY,
        _ => StatusCode::CONFLICT,
    }
}

impl From<Diagnostic> for Problem {
    fn from(finding: Diagnostic) -> Self {
        let status = http_status(&finding);
        Self { status, finding: finding.into(), allow: None }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        #[derive(Serialize)]
        struct Body {
            error: String,
            code: FindingCode,
            #[serde(skip_serializing_if = "Option::is_none")]
            help: Option<String>,
        }
        let finding = &self.finding;
        let body = Body { error: finding.message(), code: finding.code(), help: finding.help_line() };
        let mut response = json(self.status, &body);
        if self.status == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer");
            response.headers_mut().insert(HeaderName::from_static("www-authenticate"), scheme);
        }
        if let Some(methods) = self.allow {
            response.headers_mut().insert(ALLOW, HeaderValue::from_static(methods));
        }
        response
    }
}

pub(super) fn json(status: StatusCode, content: &impl Serialize) -> Response {
    match serde_json::to_string(content) {
        Ok(text) => (status, [(CONTENT_TYPE, "application/json")], text).into_response(),
        Err(error) => Problem::from(Diagnostic::new(Unwritten { why: error.to_string() })).into_response(),
    }
}

/// A JSON body.
pub(super) struct Body<T>(pub(super) T);

/// A JSON body that may hold the files of a program.
pub(super) struct LongBody<T>(pub(super) T);

impl<T: DeserializeOwned, S: Sync> FromRequest<S> for Body<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        read_body(request, LONGEST_BODY).await.map(Self)
    }
}

impl<T: DeserializeOwned, S: Sync> FromRequest<S> for LongBody<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        read_body(request, LONGEST_UPLOAD).await.map(Self)
    }
}

async fn read_body<T: DeserializeOwned>(request: Request, max_bytes: usize) -> Result<T, Problem> {
    let kind = request.headers().get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or("");
    let kind = kind.split(';').next().unwrap_or("").trim();
    if !kind.eq_ignore_ascii_case("application/json") {
        let status = StatusCode::UNSUPPORTED_MEDIA_TYPE;
        return Err(Problem::new(status, BodyNotJson));
    }
    let bytes = tokio::time::timeout(BODY_TIME, to_bytes(request.into_body(), max_bytes))
        .await
        .map_err(|_| Problem::new(StatusCode::REQUEST_TIMEOUT, BodyTooSlow))?
        .map_err(|_| Problem::new(StatusCode::PAYLOAD_TOO_LARGE, BodyTooLong { max_bytes }))?;
    serde_json::from_slice(&bytes).map_err(|error| {
        // Valid JSON with the wrong content has a status of its own.
        let why = error.to_string();
        if matches!(error.classify(), Category::Data) {
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, BodyContent { why })
        } else {
            Problem::new(StatusCode::BAD_REQUEST, BodySyntax { why })
        }
    })
}
