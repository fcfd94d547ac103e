//! `dbbd info`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{CommandOutcome, CommandOutput, artefact, output};
use dbbd_device::axes::{AxesFault, AxesProtocol};
use dbbd_device::port::StampAccuracy;
use dbbd_device::protocol::{LineFault, LineFaultKind, ProtocolDefinition};
use dbbd_job::files;
use dbbd_job::recording::RecordingFinding;
use dbbd_job::recording::axes::{AxesRecords, PacketCounts};
use dbbd_job::recording::capture::{CaptureRecord, CaptureSummary, RunEvent, StampedRecord};
use dbbd_job::recording::run;
use dbbd_job::robot_files::standing_of;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::{Diagnostic, Finding, FindingCode};
use dbbd_model::provenance::{ArtefactRole, DataOrigin, Provenance};
use dbbd_model::robot::Robot;

/// Show what a file is and what it was made from.
///
/// Prints the chain of sources back to job and robot file, with names, serial numbers and SHA-256. For a capture, prints also
/// its contents, samples, gaps and faults, the range of its readings, how it ended, and every damage of the file; if it
/// contains a plan, also the share of poses and of their readings that is lost.
#[derive(clap::Args)]
pub(crate) struct InfoArgs {
    /// A capture, robot file, job, plan.csv or plan.json, KRL program or result.
    file: PathBuf,
}

/// The JSON document.
#[derive(Default, Serialize)]
struct CaptureInfo {
    format: Option<u32>,
    protocol: Option<String>,
    /// The transport of the bytes, and how exact their times are.
    stamps: Option<StampAccuracy>,
    started_unix_ns: Option<u64>,
    dbbd: Option<String>,
    /// Where the readings come from; null where it is not stated.
    origin: Option<DataOrigin>,
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
    /// The packets of a controller that publishes its axes.
    axes: Option<AxesInfo>,
    remarks: Vec<String>,
    attachments: BTreeMap<String, usize>,
    sha256: String,
    provenance: Provenance,
    damages: Vec<DamageInfo>,
}

#[derive(Serialize)]
struct AxesInfo {
    protocol: AxesProtocol,
    #[serde(flatten)]
    counts: PacketCounts,
    faults: BTreeMap<AxesFault, u64>,
}

#[derive(Serialize)]
struct DamageInfo {
    offset: u64,
    bytes: u64,
    code: FindingCode,
    text: String,
}

pub(crate) fn run(args: &InfoArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let path = args.file.as_path();
    // A capture with a damaged head is not recognised as one, and neither as another artefact.
    if let Some(traced) = if run::is_capture(path)? { None } else { artefact::read_traced(path, out)? } {
        out.document(&traced)?;
        artefact::show_artefact(&traced, out);
        if traced.artefact.role == ArtefactRole::IdentifiedRobot {
            let robot = Robot::from_toml(&path.display().to_string(), &files::read_text(path)?)?;
            if let Some(standing) = standing_of(path, &robot)? {
                out.field("standing", &standing);
                out.findings_in(path.display(), standing.finding(&robot.name));
            }
        }
        return Ok(CommandOutcome::Done);
    }
    let mut collected = CollectedInfo::default();
    let pass = CaptureSummary::over(path, |stamped| {
        collected.add(stamped);
        Ok(())
    })?;
    let mut info = collected.finish(&pass)?;
    info.sha256 = files::sha256(path)?;
    let name = path.display().to_string();
    out.findings_in(&name, pass.all_findings());
    let planned = ["plan.csv", "plan.json"].iter().all(|file| info.attachments.contains_key(*file));
    let mut outcome = CommandOutcome::Done;
    let losses = match info.samples {
        0 => Err(Diagnostic::file(&name, RecordingFinding::NoSample)),
        _ if planned => run::losses(path),
        _ => Ok(Vec::new()),
    };
    match losses {
        Ok(losses) => out.findings(losses),
        // The contents of the capture are shown even if its plan cannot be used.
        Err(unusable) => {
            out.finding(unusable);
            outcome = CommandOutcome::Warned;
        }
    }
    out.document(&info)?;
    show_capture(path, &info, out);
    Ok(outcome)
}

/// What one pass over the capture collects.
#[derive(Default)]
struct CollectedInfo {
    info: CaptureInfo,
    span: Option<(HostNs, HostNs)>,
    attachments: BTreeMap<String, Vec<u8>>,
    axes: AxesRecords,
}

impl CollectedInfo {
    fn add(&mut self, stamped: StampedRecord) {
        self.axes.add(stamped.host, &stamped.record, |_, _, _| {});
        let info = &mut self.info;
        if let CaptureRecord::Event(event) = &stamped.record {
            let (gaps, missing) = event.gaps();
            (info.gaps, info.missing) =
                (info.gaps.saturating_add(gaps), info.missing.saturating_add(missing));
        }
        match stamped.record {
            CaptureRecord::Attachment { name, content } => {
                info.attachments.insert(name.clone(), content.len());
                self.attachments.insert(name, content);
            }
            CaptureRecord::Raw(raw) => {
                info.raw_bytes += raw.len() as u64;
                let first = self.span.map_or(stamped.host, |(first, _)| first);
                self.span = Some((first, stamped.host));
            }
            CaptureRecord::Samples(samples) => {
                for sample in &samples {
                    info.invalid += u64::from(!sample.valid);
                    let [low, high] = info.reading_mm.unwrap_or([sample.reading_mm; 2]);
                    info.reading_mm = Some([low.min(sample.reading_mm), high.max(sample.reading_mm)]);
                }
            }
            CaptureRecord::Fault(json) => {
                let fault = serde_json::from_slice::<LineFault>(&json);
                let (name, count) =
                    fault.map_or(("unreadable", 1), |fault| (fault_word(&fault.kind), fault.count));
                let faults = info.faults.entry(name.to_owned()).or_default();
                *faults = faults.saturating_add(count);
            }
            CaptureRecord::Event(RunEvent::Started { unix_ns, version }) => {
                info.started_unix_ns = Some(unix_ns);
                info.dbbd = Some(version);
            }
            CaptureRecord::Event(RunEvent::Withheld { others: others @ 1.., .. }) => {
                info.remarks.push(format!("{others} further remarks within a second were not recorded"));
            }
            CaptureRecord::Event(RunEvent::Controller { .. }) => info.controller_events += 1,
            CaptureRecord::Event(RunEvent::Mark { text }) => info.remarks.push(text),
            CaptureRecord::Event(RunEvent::Opened { stamps, .. }) => info.stamps = info.stamps.or(stamps),
            CaptureRecord::Event(RunEvent::Operator { action, detail, .. }) => {
                info.remarks.push(format!("operator: {action} {detail}").trim_end().to_owned());
            }
            CaptureRecord::Event(RunEvent::Finding { code, text }) => {
                info.remarks.push(format!("{code}: {text}"))
            }
            CaptureRecord::Axes(_)
            | CaptureRecord::Event(
                RunEvent::AxesOpened { .. }
                | RunEvent::Origin { .. }
                | RunEvent::Gap { .. }
                | RunEvent::Withheld { .. }
                | RunEvent::Ended(_),
            ) => {}
        }
    }

    fn finish(self, pass: &CaptureSummary) -> Result<CaptureInfo, Diagnostic> {
        let mut info = self.info;
        info.format = pass.version;
        info.origin = pass.origin;
        info.samples = pass.samples;
        info.ended = pass.end.as_ref().map(|end| end.reason.clone());
        info.lost = pass.end.as_ref().map_or(0, |end| end.lost);
        info.duration_s = self.span.map_or(0.0, |(first, last)| last.seconds_since(first));
        info.rate_hz = (info.duration_s > 0.0).then(|| info.samples as f64 / info.duration_s);
        let (started, dbbd) = (info.started_unix_ns, info.dbbd.clone());
        (_, info.provenance) = run::sources(&self.attachments, started, dbbd)?;
        info.axes = self.axes.receiver().map(|receiver| AxesInfo {
            protocol: receiver.protocol(),
            counts: receiver.counts(),
            faults: receiver.faults().clone(),
        });
        let protocol = self.attachments.get("protocol.toml");
        info.protocol = protocol
            .and_then(|text| std::str::from_utf8(text).ok())
            .and_then(|text| ProtocolDefinition::from_toml("protocol.toml", text).ok())
            .map(|definition| definition.id);
        info.damages = pass
            .damages
            .iter()
            .map(|damage| DamageInfo {
                offset: damage.offset,
                bytes: damage.bytes,
                code: damage.finding.code(),
                text: damage.finding.to_string(),
            })
            .collect();
        Ok(info)
    }
}

pub(crate) fn fault_word(kind: &LineFaultKind) -> &'static str {
    match kind {
        LineFaultKind::Framing => "framing",
        LineFaultKind::Check => "check",
        LineFaultKind::TooLong => "too_long",
        LineFaultKind::Content => "content",
        LineFaultKind::OtherUnit => "other_unit",
        LineFaultKind::Reject(_) => "reject",
        LineFaultKind::Ignored => "ignored",
    }
}

fn show_capture(path: &Path, info: &CaptureInfo, out: &CommandOutput) {
    const MAX_REMARKS: usize = 5;
    let list = |names: Vec<String>| if names.is_empty() { "none".into() } else { names.join(", ") };
    out.field("capture", path.display());
    out.field("protocol", info.protocol.as_deref().unwrap_or("unknown"));
    if let Some(StampAccuracy { transport, held_ms }) = info.stamps {
        let held = held_ms.map_or(String::new(), |ms| format!(", bytes held back for {ms:.1} ms or more"));
        out.field("line", format!("{transport}{held}"));
    }
    out.field("readings are", output::origin(info.origin));
    out.field("ended", info.ended.as_deref().unwrap_or("cut off"));
    out.field("duration", format!("{:.1} s of host time", info.duration_s));
    let invalid = if info.invalid > 0 { format!(", {} not valid", info.invalid) } else { String::new() };
    out.field("samples", format!("{}{invalid}", info.samples));
    if let Some([low, high]) = info.reading_mm {
        out.field("readings", format!("{low:.4} .. {high:.4} mm"));
    }
    out.field("raw bytes", info.raw_bytes);
    out.field("faults", list(info.faults.iter().map(|(kind, count)| format!("{count} {kind}")).collect()));
    out.field("gaps", format!("{}, {} samples missing", info.gaps, info.missing));
    if info.controller_events > 0 {
        out.field("controller", format!("{} events", info.controller_events));
    }
    if let Some(AxesInfo { protocol, counts, .. }) = &info.axes {
        out.field("axes", format!("{}, {}", protocol.name(), output::packets(counts)));
    }
    for remark in info.remarks.iter().take(MAX_REMARKS) {
        out.field("remark", remark);
    }
    if let Some(more @ 1..) = info.remarks.len().checked_sub(MAX_REMARKS) {
        out.field("", format!("and {more} more: `dbbd export` writes all to events.csv"));
    }
    let files = info.attachments.iter().map(|(name, len)| format!("{name} ({len} bytes)"));
    out.field("files", list(files.collect()));
    out.field("SHA-256", &info.sha256);
    artefact::show_chain(&info.provenance, out);
    out.field(
        "damages",
        if info.damages.is_empty() { "none".into() } else { info.damages.len().to_string() },
    );
}
