//! File downloads. Files are read in pieces, so that a long capture does not need much memory.

use std::fs::File;
use std::io::Read;

use axum::body::{Body, Bytes};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use futures_util::stream;

use super::server::Busy;
use dbbd_job::page::Download;
use dbbd_job::report::page::REPORT_JS;
use dbbd_model::base::hash::sha256_base64;

/// Size of a piece, bytes.
const PIECE: usize = 64 * 1024;

/// Content security policy of a report: its own style and images, no script except the script of reports, and an opaque
/// origin, so that it cannot reach the service.
fn report_policy() -> String {
    format!(
        "default-src 'none'; script-src 'sha256-{}'; style-src 'unsafe-inline'; img-src data:; sandbox allow-scripts; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'self'",
        sha256_base64(REPORT_JS)
    )
}

/// A browser displays the types that it knows and saves the others.
pub(super) fn answer(download: Download, busy: Busy) -> Response {
    let Download { file, name, bytes } = download;
    let kind = match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("json") => "application/json",
        Some("svg") => "image/svg+xml",
        Some("csv") => "text/csv; charset=utf-8",
        Some("toml") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    };
    let displayed = kind != "application/octet-stream";
    let disposition = if displayed { "inline".into() } else { format!("attachment; filename=\"{name}\"") };
    let headers = [
        (CONTENT_TYPE, kind.to_owned()),
        (CONTENT_LENGTH, bytes.to_string()),
        (CONTENT_DISPOSITION, disposition),
        (CONTENT_SECURITY_POLICY, report_policy()),
    ];
    let pieces = stream::unfold(Some((file, bytes, busy)), |rest| async move {
        let (file, left, busy) = rest?;
        let read = tokio::task::spawn_blocking(move || piece(file, left)).await;
        match read.unwrap_or_else(|error| Err(std::io::Error::other(error))) {
            Ok((_, piece)) if piece.is_empty() => None,
            Ok((file, piece)) => {
                let left = left.saturating_sub(piece.len() as u64);
                Some((Ok(Bytes::from(piece)), Some((file, left, busy))))
            }
            Err(error) => Some((Err(error), None)),
        }
    });
    (headers, Body::from_stream(pieces)).into_response()
}

fn piece(file: File, left: u64) -> std::io::Result<(File, Vec<u8>)> {
    let mut piece = Vec::new();
    (&file).take(left.min(PIECE as u64)).read_to_end(&mut piece)?;
    Ok((file, piece))
}
