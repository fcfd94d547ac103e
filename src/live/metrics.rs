//! Metrics in the text format of Prometheus.

use std::fmt::Write;

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

use super::view::{RunCounts, State, Status};

/// Writes a metric family: its values with their labels, as `{state="done"}` or empty.
pub(super) fn family(out: &mut String, name: &str, kind: &str, help: &str, values: &[(&str, f64)]) {
    // Writing to a String cannot fail.
    let _ = writeln!(out, "# HELP dbbd_{name} {help}\n# TYPE dbbd_{name} {kind}");
    for (labels, value) in values {
        let _ = writeln!(out, "dbbd_{name}{labels} {value}");
    }
}

pub(super) fn answer(text: String) -> Response {
    ([(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
}

/// The metrics of a cell. Counts are the counts of the current run, 0 without a run.
pub(super) fn text(status: &Status) -> String {
    let mut out = String::new();
    let mut metric =
        |name: &str, kind: &str, help: &str, value: f64| family(&mut out, name, kind, help, &[("", value)]);
    let run = status.run.as_ref();
    let counts = run.map(|run| &run.counts);
    let on = |value: bool| f64::from(u8::from(value));
    let count = |field: fn(&RunCounts) -> u64| counts.map_or(0.0, |counts| field(counts) as f64);
    metric("device_present", "gauge", "Whether the port is there.", on(status.device.present));
    metric("running", "gauge", "Whether a run is on.", on(run.is_some()));
    metric("failed", "gauge", "Whether the last run failed.", on(status.state == State::Failed));
    metric(
        "device_gone",
        "gauge",
        "Whether the port went away during the run.",
        on(counts.is_some_and(|counts| counts.gone)),
    );
    metric(
        "run_seconds",
        "gauge",
        "Host time since the run began.",
        counts.map_or(0.0, |counts| counts.elapsed_s),
    );
    metric("sample_rate_hertz", "gauge", "Samples per second.", counts.map_or(0.0, |counts| counts.rate_hz));
    metric("bytes_total", "counter", "Bytes received in this run.", count(|counts| counts.bytes));
    metric("samples_total", "counter", "Samples written in this run.", count(|counts| counts.samples));
    metric(
        "missing_samples_total",
        "counter",
        "Samples missing by their numbers.",
        count(|counts| counts.missing),
    );
    metric("gaps_total", "counter", "Gaps recorded in this run.", count(|counts| counts.gaps));
    metric("faults_total", "counter", "Faults of the stream in this run.", count(|counts| counts.faults));
    metric(
        "rejected_total",
        "counter",
        "Refusals of the device in this run.",
        count(|counts| counts.rejected),
    );
    metric("unanswered_total", "counter", "Requests without an answer.", count(|counts| counts.unanswered));
    metric(
        "lost_bytes_total",
        "counter",
        "Bytes lost before the recorder.",
        count(|counts| counts.lost_bytes),
    );
    metric(
        "dwells_total",
        "counter",
        "Dwells that are over in this run.",
        count(|counts| counts.dwells.into()),
    );
    if let Some(archive) = &status.archive {
        metric(
            "archive_waiting",
            "gauge",
            "Runs that the archive has not confirmed.",
            archive.waiting as f64,
        );
    }
    if let Some(mm) = counts.and_then(|counts| counts.reading_mm) {
        metric("reading_millimetres", "gauge", "The last reading of the bar.", mm);
    }
    out
}
