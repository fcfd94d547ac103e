//! The live page: files inside the binary.

use super::guard::PageFile;

pub(super) const FILES: &[PageFile] = &[
    file("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    file("/style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    file("/app.js", "text/javascript; charset=utf-8", include_str!("page/app.js")),
    file("/gauge.js", "text/javascript; charset=utf-8", include_str!("page/gauge.js")),
    file("/polar.js", "text/javascript; charset=utf-8", include_str!("page/polar.js")),
    file("/numbers.js", "text/javascript; charset=utf-8", include_str!("page/numbers.js")),
    file("/strip.js", "text/javascript; charset=utf-8", include_str!("page/strip.js")),
    file("/link.js", "text/javascript; charset=utf-8", include_str!("page/link.js")),
    file("/mounting.js", "text/javascript; charset=utf-8", include_str!("page/mounting.js")),
    file("/texts.js", "text/javascript; charset=utf-8", include_str!("page/texts.js")),
    file("/texts.json", "application/json", LANGUAGES),
    file("/runs.js", "text/javascript; charset=utf-8", include_str!("page/runs.js")),
];

/// The texts of the page by language: a further language is a file and its line here.
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
