//! The live page: files inside the binary.

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

/// Names, kinds and contents.
pub(super) const FILES: &[(&str, &str, &str)] = &[
    ("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("/style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("/app.js", "text/javascript; charset=utf-8", include_str!("page/app.js")),
    ("/gauge.js", "text/javascript; charset=utf-8", include_str!("page/gauge.js")),
    ("/polar.js", "text/javascript; charset=utf-8", include_str!("page/polar.js")),
    ("/numbers.js", "text/javascript; charset=utf-8", include_str!("page/numbers.js")),
    ("/strip.js", "text/javascript; charset=utf-8", include_str!("page/strip.js")),
    ("/link.js", "text/javascript; charset=utf-8", include_str!("page/link.js")),
    ("/mounting.js", "text/javascript; charset=utf-8", include_str!("page/mounting.js")),
    ("/texts.js", "text/javascript; charset=utf-8", include_str!("page/texts.js")),
    ("/texts.json", "application/json", LANGUAGES),
    ("/runs.js", "text/javascript; charset=utf-8", include_str!("page/runs.js")),
];

/// The texts of the page by language: a further language is a file and its line here.
const LANGUAGES: &str = concat!(
    "{\"en\":",
    include_str!("page/texts/en.json"),
    ",\"de\":",
    include_str!("page/texts/de.json"),
    "}"
);

/// Answers with one of the page's files.
pub(super) fn answer(kind: &'static str, content: &'static str) -> Response {
    ([(CONTENT_TYPE, kind)], content).into_response()
}
