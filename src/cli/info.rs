//! `dbbd info`.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Outcome, Output, Verdict};
use crate::capture::{self, Capture, Damage, Event, Record};
use crate::diag::Diagnostic;
use crate::protocol::{Definition, Fault, FaultKind, Sample};

/// Arguments of the verb.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The capture.
    run: PathBuf,
}

/// Reads a capture; damages are in it, not an error.
///
/// # Errors
/// When the file cannot be read, is no capture, or is of a newer version.
pub(crate) fn open(path: &Path) -> Result<Capture, Box<dyn Error>> {
    let name = path.display().to_string();
    let wrong = |message: String| Diagnostic::file(&name, message);
    let bytes = fs::read(path).map_err(|error| wrong(format!("cannot be read: {error}")))?;
    let capture = capture::read(&bytes);
    if capture.is_none() {
        return Err(wrong("is no capture: no whole record is in it".into())
            .help("a capture is what `dbbd acquire --out RUN` writes")
            .into());
    }
    if capture.is_newer() {
        return Err(wrong("was written by a newer dbbd".into()).help("read it with that version").into());
    }
    Ok(capture)
}

/// Says every damage on stderr.
pub(crate) fn warn_of_damages(capture: &Capture, out: &Output) {
    for Damage { offset, bytes, what } in &capture.damages {
        out.warning(format!("byte {offset}: {what}; {bytes} bytes are passed over"));
    }
}

/// What `--json` gives.
#[derive(Default, Serialize)]
struct Info {
    protocol: Option<String>,
    started_unix_ns: Option<u64>,
    dbbd: Option<String>,
    ended: Option<String>,
    duration_s: f64,
    raw_bytes: u64,
    samples: u64,
    invalid: u64,
    rate_hz: Option<f64>,
    reading_mm: Option<[f64; 2]>,
    faults: BTreeMap<String, u64>,
    gaps: u64,
    missing: u64,
    lost: u64,
    controller_events: u64,
    attachments: BTreeMap<String, usize>,
    damages: Vec<DamageInfo>,
}

#[derive(Serialize)]
struct DamageInfo {
    offset: u64,
    bytes: u64,
    what: String,
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    let capture = open(&args.run)?;
    let info = gather(&capture);
    out.document(&info)?;
    show(&args.run, &info, out);
    warn_of_damages(&capture, out);
    if info.ended.is_none() {
        out.warning("the run was cut off: it has no record of its end");
    }
    let whole = capture.damages.is_empty() && info.ended.is_some() && info.lost == 0;
    Ok(if whole { Outcome::Done } else { Outcome::Doubt })
}

fn gather(capture: &Capture) -> Info {
    let mut info = Info::default();
    let mut span = None;
    for stamped in &capture.records {
        match &stamped.record {
            Record::Attachment { name, content } => {
                info.attachments.insert(name.clone(), content.len());
            }
            Record::Raw(raw) => {
                info.raw_bytes += raw.len() as u64;
                span = span.or(Some((stamped.host, stamped.host))).map(|(first, _)| (first, stamped.host));
            }
            Record::Sample(json) => {
                info.samples += 1;
                if let Ok(sample) = serde_json::from_slice::<Sample>(json) {
                    info.invalid += u64::from(!sample.valid);
                    let [low, high] = info.reading_mm.unwrap_or([sample.reading_mm; 2]);
                    info.reading_mm = Some([low.min(sample.reading_mm), high.max(sample.reading_mm)]);
                }
            }
            Record::Fault(json) => {
                let name = serde_json::from_slice::<Fault>(json).map_or("unreadable", |f| word(&f.kind));
                *info.faults.entry(name.to_owned()).or_default() += 1;
            }
            Record::Event(Event::Started { unix_ns, version }) => {
                info.started_unix_ns = Some(*unix_ns);
                info.dbbd = Some(version.clone());
            }
            Record::Event(Event::Gap { missing, .. }) => {
                info.gaps += 1;
                info.missing += missing.unwrap_or(0);
            }
            Record::Event(Event::Controller { .. }) => info.controller_events += 1,
            Record::Event(Event::Ended { reason, lost, .. }) => {
                info.ended = Some(reason.clone());
                info.lost = *lost;
            }
            Record::Event(Event::Opened { .. } | Event::Mark { .. }) => {}
        }
    }
    info.duration_s = span.map_or(0.0, |(first, last)| last.seconds_since(first));
    info.rate_hz = (info.duration_s > 0.0).then(|| info.samples as f64 / info.duration_s);
    info.protocol = capture
        .attachment("protocol.toml")
        .and_then(|text| std::str::from_utf8(text).ok())
        .and_then(|text| Definition::from_toml("protocol.toml", text).ok())
        .map(|definition| definition.id);
    info.damages = capture
        .damages
        .iter()
        .map(|damage| DamageInfo { offset: damage.offset, bytes: damage.bytes, what: damage.what.clone() })
        .collect();
    info
}

/// A fault's kind in a word.
pub(crate) fn word(kind: &FaultKind) -> &'static str {
    match kind {
        FaultKind::Framing => "framing",
        FaultKind::Check => "check",
        FaultKind::TooLong => "too_long",
        FaultKind::Content => "content",
        FaultKind::Reject(_) => "reject",
        FaultKind::Ignored => "ignored",
    }
}

fn show(path: &Path, info: &Info, out: &Output) {
    let line = |name: &str, value: String| out.result(format!("{name:13}{value}"));
    line("capture", path.display().to_string());
    line("protocol", info.protocol.clone().unwrap_or_else(|| "unknown".into()));
    line("ended", info.ended.clone().unwrap_or_else(|| "cut off".into()));
    line("duration", format!("{:.1} s of host time", info.duration_s));
    let invalid = if info.invalid > 0 { format!(", {} not valid", info.invalid) } else { String::new() };
    line("samples", format!("{}{invalid}", info.samples));
    if let Some([low, high]) = info.reading_mm {
        line("readings", format!("{low:.4} .. {high:.4} mm"));
    }
    line("raw bytes", info.raw_bytes.to_string());
    let faults: Vec<String> = info.faults.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    line("faults", if faults.is_empty() { "none".into() } else { faults.join(", ") });
    line("gaps", format!("{}, {} samples missing", info.gaps, info.missing));
    if info.controller_events > 0 {
        line("controller", format!("{} events", info.controller_events));
    }
    let files: Vec<String> =
        info.attachments.iter().map(|(name, len)| format!("{name} ({len} bytes)")).collect();
    line("files", if files.is_empty() { "none".into() } else { files.join(", ") });
    line("damages", if info.damages.is_empty() { "none".into() } else { info.damages.len().to_string() });
}
